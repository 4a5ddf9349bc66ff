"""Readings of a case compared: how well each lets an ordinary arm explain torque that was not used to fit.

The gain of a reading is the sum over joints of log(R without / R with), R = sqrt(gap^2 + ORDINARY_GAP^2) with the
held-out gap over the torque's deviation, and of log(P without / P with), P = penalty + ORDINARY_PENALTY with the
prior's penalty on the values that the arm would have to have. The floors keep small effects from counting: a setup
fault is gross.

That is the evidence of the columns as they were recorded. Of a column x read as k x, N samples have the density
p(x) = |k|^N p(k x), Jacobian included: its logarithm is N log |k| - N log RMS(k x - prediction), up to a constant. The
deviation of the torque read is |k| times that of x, so that a gap over it holds the Jacobian, and a torque divided by a
thousand is not explained any better. Motions, on which the prediction rests, are given: none is due to them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.shifted_inertials import shifted_body
from gapscope.diagnosis.setup_faults.fault_samples import FaultSamples
from gapscope.diagnosis.setup_faults.nuisance import (
    FoldEquations,
    fold_equations,
    torque_deviation,
)
from gapscope.diagnosis.setup_faults.nuisance_fit import fitted_gap, held_out_gap
from gapscope.diagnosis.thresholds import (
    ORDINARY_GAP,
    ORDINARY_PENALTY,
    WORST_GAP,
)
from gapscope.effects.environment import tilt
from gapscope.model.gravity_direction import (
    gravity_by_torque,
    turn_of_base,
)

KEPT_EQUATIONS = 8
"""Motions beyond the present one of which equations are kept."""


@dataclass(frozen=True)
class ReadingScore:
    """How a reading did.

    Attributes:
        residual: sqrt(gap^2 + ORDINARY_GAP^2) of each fold and joint, (K, n).
        penalty: of the prior on the values fitted to all folds, plus ``ORDINARY_PENALTY``.
    """

    residual: np.ndarray
    penalty: float

    @property
    def joint_rms(self) -> np.ndarray:
        """Root mean square of the residual over the folds, (n,)."""
        return np.sqrt((self.residual**2).mean(axis=0))

    def joint_gain(self, before: ReadingScore) -> np.ndarray:
        """Gain of each joint over another reading, (n,)."""
        return np.log(before.joint_rms / self.joint_rms)

    def fold_gain(self, before: ReadingScore) -> np.ndarray:
        """Gain of each fold, summed over joints, (K,)."""
        return np.log(before.residual / self.residual).sum(axis=1)

    def penalty_gain(self, before: ReadingScore) -> float:
        """Gain by a smaller penalty."""
        return float(np.log(before.penalty / self.penalty))

    def gain(self, before: ReadingScore) -> float:
        """Gain in all."""
        return float(self.joint_gain(before).sum()) + self.penalty_gain(before)


@dataclass
class ReadingScorer:
    """Scores readings of one case on its samples; equations of the last few motions are kept.

    Attributes:
        arm, body: the nominal arm and its dynamics.
        samples: what is looked at.
    """

    arm: NominalArm
    body: RigidBody
    samples: FaultSamples
    _equations: dict[tuple[object, ...], FoldEquations] = field(default_factory=dict)
    _bodies: dict[tuple[object, ...], RigidBody | None] = field(default_factory=dict)

    def score(self, reading: Reading, spread: float = 1.0) -> ReadingScore:
        """Score of a reading; the worst possible for an arm that cannot be.

        Args:
            reading: how to read the recordings.
            spread: factor on what the arm may ordinarily have beyond its data sheet.
        """
        eq = self.equations_of(reading)
        if eq is None:
            return self._worst()
        return _scored(*held_out_gap(eq, reading, spread))

    def best_score(self, reading: Reading) -> ReadingScore:
        """What a reading scores at most: as if no fold had been held out. A quarter of the cost of ``score``."""
        eq = self.equations_of(reading)
        if eq is None:
            return self._worst()
        return _scored(*fitted_gap(eq, reading))

    def _worst(self) -> ReadingScore:
        """Score of an arm that cannot be."""
        shape = (len(self.samples.folds), self.arm.n_joints)
        return ReadingScore(np.full(shape, WORST_GAP), WORST_GAP)

    def gravity_turn(self, reading: Reading) -> tuple[float, float] | None:
        """Roll and pitch [rad] of the base that the torque shows under a reading which does not turn it yet."""
        body = self._body(reading)
        if body is None or not body.gravity.any() or reading.gravity:
            return None
        q, dq, ddq = reading.true_motion(
            self.samples.q, self.samples.dq, self.samples.ddq
        )
        tau = reading.torque(self.samples.torque(reading.recorded_delay))
        regressor = body.gravity_regressor(q)
        needed = body.inverse_dynamics(q, dq, ddq) + self.arm.armature * ddq
        without_gravity = tau - needed + regressor @ body.gravity
        found = gravity_by_torque(without_gravity, regressor, dq, torque_deviation(tau))
        return turn_of_base(body.gravity, found)

    def equations_of(self, reading: Reading) -> FoldEquations | None:
        """Equations under a reading; ``None`` if its inertials leave no arm."""
        key = reading.equation_key
        if key not in self._equations:
            body = self._body(reading)
            if body is None:
                return None
            if len(self._equations) > KEPT_EQUATIONS:
                oldest = next(iter(self._equations))
                del self._equations[oldest]
            self._equations[key] = fold_equations(self.arm, body, self.samples, reading)
        return self._equations[key]

    def _body(self, reading: Reading) -> RigidBody | None:
        """Dynamics with the inertials moved and the base turned; ``None`` if a joint is then without a body."""
        key = (reading.link_shift, reading.moved_only, reading.turn)
        if key not in self._bodies:
            try:
                shifted = shifted_body(self.arm, reading.link_shift, reading.moved_only)
                body = self.body if shifted is None else shifted
                if any(reading.turn):
                    gravity = tilt(*reading.turn).T @ body.gravity
                    body = body.changed(np.zeros((self.arm.n_joints, 10)), gravity)
                self._bodies[key] = body
            except InputError:
                self._bodies[key] = None
        return self._bodies[key]


def _scored(gap: np.ndarray, penalty: float) -> ReadingScore:
    """Score of a gap over the torque's deviation, (K, n), and a penalty, kept finite."""
    finite_gap = np.nan_to_num(gap, nan=WORST_GAP, posinf=WORST_GAP)
    finite_penalty = float(np.nan_to_num(penalty, nan=WORST_GAP, posinf=WORST_GAP))
    return ReadingScore(
        np.hypot(np.minimum(finite_gap, WORST_GAP), ORDINARY_GAP),
        ORDINARY_PENALTY + finite_penalty,
    )
