"""How much of the nominal arm's weight a torque carries, all joints together: an arm weighs about what its model says.

Errors of single links are ordinary, but not that nothing has weight, or that the whole arm has a tenth of it. With what
inertia, friction and an offset explain taken out of both, tau_j = b g_j, with one b for the arm [1].
"""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.setup_faults.nuisance import (
    COULOMB,
    OFFSET,
    VISCOUS,
    FoldEquations,
    ReadTorque,
)
from gapscope.diagnosis.thresholds import ORDINARY_GAP_DEVIATION, ORDINARY_WEIGHT


def weight_penalty(eq: FoldEquations, torque: ReadTorque, spread: float) -> float:
    """Half the squared error of the arm's weight, in deviations of its prior; 0 for an arm that is as heavy or more.

    Args:
        eq: normal equations under a mapping.
        torque: the torque as the mapping reads it.
        spread: factor on the deviation of the prior.
    """
    share, std = weight_share(eq, torque)
    lacking = max(1.0 - share, 0.0)
    return 0.5 * lacking**2 / ((spread * ORDINARY_WEIGHT) ** 2 + std**2)


def weight_share(eq: FoldEquations, torque: ReadTorque) -> tuple[float, float]:
    """b [1] and its standard deviation, which is infinite if no joint carries a weight that changes."""
    gram, cross = eq.gram.sum(axis=0), torque.cross.sum(axis=0)
    pull, products = eq.cross.sum(axis=0), eq.products.sum(axis=0)
    torque_pull = torque.pull.sum(axis=0)
    n = len(cross)
    # the nominal arm's torque, of which gravity is taken away below, and what else a joint has
    others = eq.shared + np.array([0, COULOMB, VISCOUS, OFFSET])
    carried = heavy = 0.0
    for j in range(n):
        gravity = n + j
        rest = _Rest(
            gram[j][np.ix_(others, others)],
            pull[j, others, gravity],
            float(products[gravity, gravity]),
        )
        precision = 1.0 / torque.deviation[j] ** 2
        carried += precision * rest.of_torque(cross[j, others], float(torque_pull[j]))
        heavy += precision * rest.of_gravity()
    if heavy <= 0.0:
        return 1.0, np.inf
    std = ORDINARY_GAP_DEVIATION / np.sqrt(eq.weight * heavy)
    return float(carried / heavy), float(std)


class _Rest:
    """A joint's gravity torque g less what its inertia, friction and offset, z = (p - g, sgn dq, dq, 1), explain.

    Args:
        gram: products of (p, sgn dq, dq, 1), p the nominal arm's torque, (4, 4).
        pull: their products with g, (4,).
        square: of g.
    """

    def __init__(self, gram: np.ndarray, pull: np.ndarray, square: float) -> None:
        self._square = square
        self._pull = pull.copy()
        self._pull[0] -= square
        own = gram.copy()
        own[0] -= pull
        own[:, 0] = own[0]
        own[0, 0] -= self._pull[0]
        self._explained = np.linalg.pinv(own, hermitian=True) @ self._pull

    def of_gravity(self) -> float:
        """Square of what is left of g."""
        return max(self._square - float(self._explained @ self._pull), 0.0)

    def of_torque(self, cross: np.ndarray, pull: float) -> float:
        """Product of what is left of g with a torque, given that with (p, sgn dq, dq, 1), (4,), and with g."""
        with_rest = cross.copy()
        with_rest[0] -= pull
        return pull - float(self._explained @ with_rest)
