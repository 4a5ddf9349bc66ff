"""Random search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.excitation.trajectory_search import TrajectorySearch


@dataclass(frozen=True)
class RandomSearch:
    """Independent draws of standard normal numbers.

    Attributes:
        feasible: ends when so many candidates kept all limits; ``None`` for any.
    """

    feasible: int | None = None

    def run(self, search: TrajectorySearch, rng: np.random.Generator) -> None:
        """Draw until the budget is spent, or enough candidates kept all limits."""
        most = np.inf if self.feasible is None else self.feasible
        while not search.spent and search.feasible < most:
            search.score(search.parametrisation.draw(rng))
