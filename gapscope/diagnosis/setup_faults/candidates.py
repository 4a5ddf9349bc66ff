"""What a case shows under a reading, from which faults tell where they may be; and bases turned, which look like them.

A torque's factor is looked for from where the nominal arm has it: with what friction and an offset explain taken out of
both, torque and nominal torque of a joint have variances whose ratio is the square of the factor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.diagnosis.setup_faults.fault_samples import FaultSamples
from gapscope.diagnosis.setup_faults.nuisance import (
    COULOMB,
    OFFSET,
    VISCOUS,
    FoldEquations,
)
from gapscope.diagnosis.thresholds import KNOWN_FACTOR_R2
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.setup_faults.fault import Fault, Look

TURN = 2 * np.pi


@dataclass(frozen=True)
class TurnedBase(Fault):
    """A base turned by roll and pitch [rad].

    No fault: it is an effect, which the search finds. Here it competes with the faults that look like it: all torques
    turned are gravity turned, but for friction and inertia.
    """

    name = of_quantity("gravity")[0].name
    roll: float
    pitch: float

    def reading(self, n: int) -> Reading:
        """With the base turned."""
        return Reading.identity(n, turn=(self.roll, self.pitch))


HALF, QUARTER = np.pi, np.pi / 2
TURNED_BASES = (
    TurnedBase(HALF, 0.0),
    TurnedBase(QUARTER, 0.0),
    TurnedBase(-QUARTER, 0.0),
    TurnedBase(0.0, QUARTER),
    TurnedBase(0.0, -QUARTER),
)
"""Arms that hang, or are mounted sideways."""


def look_at(
    arm: NominalArm,
    samples: FaultSamples,
    equations: FoldEquations,
    reading: Reading,
    rate_is_known: bool,
) -> Look:
    """What samples of a case show under a reading, given the equations under it."""
    factor, known = factor_starts(equations, reading)
    n = arm.n_joints
    return Look(
        reading,
        tuple(np.flatnonzero(~np.array(arm.sliding)).tolist()),
        joints_beyond_range(arm, samples, reading),
        factor,
        known,
        bool(np.diag(equations.products.sum(axis=0))[n:].any()),
        rate_is_known or reading.differs("time_factor"),
    )


def joints_beyond_range(
    arm: NominalArm, samples: FaultSamples, reading: Reading
) -> tuple[int, ...]:
    """Joints, from 0, that travel more than a turn, or farther than their limits in the URDF are apart."""
    q, _, _ = reading.true_motion(samples.q, samples.dq, samples.ddq)
    travel = np.ptp(q, axis=0)
    lower, upper = RigidBody(arm).position_limits()
    # a slide may travel as far as its limits allow
    most = np.where(arm.sliding, np.inf, 1.05 * TURN)
    allowed = np.minimum(upper - lower, most)
    return tuple(int(j) for j in np.flatnonzero(travel > allowed))


def factor_starts(eq: FoldEquations, reading: Reading) -> tuple[np.ndarray, np.ndarray]:
    """Nominal over read torque of each joint [1], (n,), and of which joints it is known, (n,)."""
    torque = eq.read(reading)
    cross, square = torque.cross.sum(axis=0), torque.square.sum(axis=0)
    gram, n, shared = eq.gram.sum(axis=0), len(square), eq.shared
    nuisances = shared + np.array([COULOMB, VISCOUS, OFFSET])
    factors, explained = np.ones(n), np.zeros(n)
    for j in range(n):
        signals = np.empty((2, 2))
        signals[0] = square[j], cross[j, shared]
        signals[1] = cross[j, shared], gram[j, shared, shared]
        by_nuisance = np.stack([cross[j, nuisances], gram[j, nuisances, shared]])
        own = gram[j][np.ix_(nuisances, nuisances)]
        left = signals - by_nuisance @ np.linalg.pinv(own) @ by_nuisance.T
        recorded, nominal = np.maximum(np.diag(left), 0.0)
        if recorded > 0 and nominal > 0:
            factors[j] = np.sqrt(nominal / recorded)
            explained[j] = left[0, 1] ** 2 / (recorded * nominal)
    return factors, explained > KNOWN_FACTOR_R2
