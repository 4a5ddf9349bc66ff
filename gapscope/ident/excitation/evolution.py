"""CMA-ES: evolution with an adapted covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.ident.excitation.optimiser import random_starts
from gapscope.ident.excitation.trajectory_search import TrajectorySearch


@dataclass(frozen=True)
class Evolution:
    """CMA-ES [hansen2016] by the package ``cma``, from the best of random candidates; started anew if it stalls.

    Attributes:
        spread: initial standard deviation, in that of random draws [1].
        population: candidates per generation; by default 4 + 3 log d.
    """

    spread: float = 0.3
    population: int | None = None

    def run(self, search: TrajectorySearch, rng: np.random.Generator) -> None:
        """Evolve until the budget is spent."""
        import cma

        options: dict[str, Any] = {
            "verbose": -9,
            "seed": np.nan,  # the generator that is passed in draws, not numpy's global one
            "randn": lambda *shape: rng.standard_normal(shape),
            "maxfevals": np.inf,
        }
        if self.population is not None:
            options["popsize"] = self.population
        # a run that has converged is begun anew elsewhere
        while not search.spent:
            start = random_starts(search, rng, 0.05, 1)[0]
            evolution = cma.CMAEvolutionStrategy(start, self.spread, options)
            while not search.spent and not evolution.stop():
                candidates = evolution.ask()
                scores = []
                for x in candidates:
                    scores.append(search.score(np.asarray(x)))
                    if search.spent:
                        return
                evolution.tell(candidates, scores)
