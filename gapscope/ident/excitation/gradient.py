"""Gradient refinement: quasi-Newton steps with analytic derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from gapscope.arm.errors import InputError
from gapscope.ident.excitation.optimiser import random_starts
from gapscope.ident.excitation.trajectory_search import TrajectorySearch

WORTH = 0.01
"""Least gain for which a descent that has stalled is begun anew at its end."""


class _SpentError(Exception):
    """The budget is spent."""


@dataclass(frozen=True)
class GradientRefinement:
    """L-BFGS from the best of random candidates; from new ones if it can go no further.

    A criterion has edges where eigenvalues or broken limits swap places. There the descent stalls, and is begun anew
    without its memory of curvature as long as that helps.

    Attributes:
        starts: share of the budget for the random candidates of each start [1].
    """

    starts: float = 0.05

    def run(self, search: TrajectorySearch, rng: np.random.Generator) -> None:
        """Refine until the budget is spent.

        Raises:
            InputError: the criterion has no gradient.
        """
        if not search.has_gradient:
            raise InputError(
                "separation has no analytic gradient",
                "use cma, swarm or random",
                where="optimiser",
            )

        def objective(x: np.ndarray) -> tuple[float, np.ndarray]:
            if search.spent:
                raise _SpentError
            return search.score_and_gradient(x)

        while not search.spent:
            x, before = random_starts(search, rng, self.starts, 1)[0], np.inf
            try:
                while True:
                    done = minimize(
                        objective,
                        x,
                        jac=True,
                        method="L-BFGS-B",
                        options={"maxcor": 30},
                    )
                    if before - done.fun < WORTH:
                        break
                    x, before = done.x, float(done.fun)
            except _SpentError:
                return
