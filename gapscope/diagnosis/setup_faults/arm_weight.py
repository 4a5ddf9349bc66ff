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
from gapscope.diagnosis.thresholds import (
    LEAST_WEIGHT,
    ORDINARY_GAP_DEVIATION,
    ORDINARY_WEIGHT,
)


def weight_penalty(eq: FoldEquations, torque: ReadTorque, spread: float) -> float:
    """Half the squared error of the arm's weight, ln b, in deviations of its prior [nats].

    0 for an arm that is as heavy as its model or more: a load may add any weight.

    Args:
        eq: normal equations under a reading.
        torque: the torque as the reading reads it.
        spread: factor on the deviation of the prior.
    """
    share, std = weight_share(eq, torque)
    # the logarithm of nothing, or of a weight that pulls upwards, is that of the least weight
    share = max(share, LEAST_WEIGHT)
    lacking = max(-np.log(share), 0.0)
    return 0.5 * lacking**2 / ((spread * ORDINARY_WEIGHT) ** 2 + (std / share) ** 2)


def weight_share(eq: FoldEquations, torque: ReadTorque) -> tuple[float, float]:
    """b [1] and its standard deviation, which is infinite if no joint carries a weight that changes."""
    joints = np.arange(len(torque.deviation))
    gravity = len(joints) + joints
    # z = (p - g, sgn dq, dq, 1), p the nominal arm's torque
    columns = eq.shared + np.array([0, COULOMB, VISCOUS, OFFSET])
    square = eq.products.sum(axis=0)[gravity, gravity]
    # products of z with g, with itself, and with the torque
    by_gravity = eq.cross.sum(axis=0)[joints, :, gravity][:, columns]
    own = eq.gram.sum(axis=0)[:, columns[:, None], columns]
    own[:, 0] -= by_gravity
    own[:, :, 0] = own[:, 0]
    own[:, 0, 0] += square - by_gravity[:, 0]
    with_pull = by_gravity.copy()
    with_pull[:, 0] -= square
    with_torque = torque.cross.sum(axis=0)[:, columns]
    pull = torque.pull.sum(axis=0)
    with_torque[:, 0] -= pull

    inverse = np.linalg.pinv(own, hermitian=True)
    explained = np.einsum("jab,jb->ja", inverse, with_pull)
    carried = pull - (explained * with_torque).sum(axis=1)
    heavy = np.maximum(square - (explained * with_pull).sum(axis=1), 0.0)
    precision = 1.0 / torque.deviation**2
    total = float(precision @ heavy)
    if total <= 0.0:
        return 1.0, np.inf
    std = ORDINARY_GAP_DEVIATION / np.sqrt(eq.weight * total)
    return float(precision @ carried) / total, float(std)
