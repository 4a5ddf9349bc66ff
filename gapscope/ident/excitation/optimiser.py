"""What an optimiser of trajectories is."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from gapscope.ident.excitation.trajectory_search import TrajectorySearch


class Optimiser(Protocol):
    """Spends the budget of a search; what it found lies in ``search.found``."""

    def run(self, search: TrajectorySearch, rng: np.random.Generator) -> None:
        """Judge candidates until the budget is spent."""


def random_starts(
    search: TrajectorySearch, rng: np.random.Generator, share: float, count: int
) -> np.ndarray:
    """The best of random candidates, best first, shape (count, d), for a share of the whole budget."""
    candidates: list[np.ndarray] = []
    scores: list[float] = []
    end = search.share + share
    while len(candidates) < count or (search.share < end and not search.spent):
        x = search.parametrisation.draw(rng)
        candidates.append(x)
        scores.append(search.score(x))
    best = np.argsort(scores, kind="stable")[:count]
    return np.array(candidates)[best]
