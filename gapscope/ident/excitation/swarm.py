"""Particle swarm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.excitation.optimiser import random_starts
from gapscope.ident.excitation.trajectory_search import TrajectorySearch

REACH = 3.0
"""Particles stay within this many standard deviations of a random draw."""


@dataclass(frozen=True)
class ParticleSwarm:
    """A particle swarm with the constriction of [clerc2002].

    v <- w v + c r1 (own best - x) + c r2 (best of all - x), x <- x + v, with r1, r2 uniform per coordinate.

    Attributes:
        particles: how many.
        inertia: w [1].
        pull: c [1].
    """

    particles: int = 40
    inertia: float = 0.7298
    pull: float = 1.4962

    def run(self, search: TrajectorySearch, rng: np.random.Generator) -> None:
        """Move the swarm until the budget is spent."""
        x = random_starts(search, rng, 0.05, self.particles)
        best = x.copy()
        scores = np.array([search.score(particle) for particle in x])
        v = 0.1 * rng.standard_normal(x.shape)
        while not search.spent:
            for i in range(self.particles):
                leader = best[int(scores.argmin())]
                own, common = rng.uniform(0.0, self.pull, (2, x.shape[1]))
                to_own, to_leader = best[i] - x[i], leader - x[i]
                v[i] = self.inertia * v[i] + own * to_own + common * to_leader
                # far out all candidates map to the edge of the limits
                x[i] = np.clip(x[i] + v[i], -REACH, REACH)
                score = search.score(x[i])
                if score < scores[i]:
                    best[i] = x[i]
                    scores[i] = score
                if search.spent:
                    break
