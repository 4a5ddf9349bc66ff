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
    tried: list[tuple[float, np.ndarray]] = []
    begun = search.share
    while len(tried) < count or search.share < begun + share:
        if search.spent and len(tried) >= count:
            break
        x = search.parametrisation.draw(rng)
        tried.append((search.score(x), x))
    tried.sort(key=lambda item: item[0])
    return np.array([x for _, x in tried[:count]])
