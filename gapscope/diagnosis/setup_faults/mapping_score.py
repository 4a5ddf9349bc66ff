"""Mappings of a case compared: how well each lets an ordinary arm explain torque that was not used to fit.

The gain of a mapping is the sum over joints of log(R without / R with), R = sqrt(gap^2 + ORDINARY_GAP^2) with the
held-out gap over the torque's deviation, and of log(P without / P with), P = penalty + ORDINARY_PENALTY with the
prior's penalty on the values that the arm would have to have. The floors keep small effects from counting: a setup
fault is gross.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.fault_samples import FaultSamples
from gapscope.diagnosis.setup_faults.gravity_direction import (
    gravity_by_torque,
    turn_of_base,
)
from gapscope.diagnosis.setup_faults.nuisance import (
    FoldEquations,
    fold_equations,
    torque_deviation,
)
from gapscope.diagnosis.setup_faults.nuisance_fit import fitted_gap, held_out_gap
from gapscope.diagnosis.setup_faults.shifted_inertials import shifted_body
from gapscope.diagnosis.thresholds import (
    ORDINARY_GAP,
    ORDINARY_PENALTY,
    WORST_GAP,
)
from gapscope.effects.environment import tilt

KEPT_EQUATIONS = 8
"""Motions beyond the present one of which equations are kept."""


@dataclass(frozen=True)
class MappingScore:
    """How a mapping did.

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

    def joint_gain(self, before: MappingScore) -> np.ndarray:
        """Gain of each joint over another mapping, (n,)."""
        return np.log(before.joint_rms / self.joint_rms)

    def fold_gain(self, before: MappingScore) -> np.ndarray:
        """Gain of each fold, summed over joints, (K,)."""
        return np.log(before.residual / self.residual).sum(axis=1)

    def penalty_gain(self, before: MappingScore) -> float:
        """Gain by a smaller penalty."""
        return float(np.log(before.penalty / self.penalty))

    def gain(self, before: MappingScore) -> float:
        """Gain in all."""
        return float(self.joint_gain(before).sum()) + self.penalty_gain(before)


@dataclass
class MappingScorer:
    """Scores mappings of one case on its samples; equations of the last few motions are kept.

    Attributes:
        arm, body: the nominal arm and its dynamics.
        samples: what is looked at.
    """

    arm: NominalArm
    body: RigidBody
    samples: FaultSamples
    _equations: dict[tuple[object, ...], FoldEquations] = field(default_factory=dict)
    _bodies: dict[tuple[object, ...], RigidBody | None] = field(default_factory=dict)

    def score(self, mapping: ChannelMapping, spread: float = 1.0) -> MappingScore:
        """Score of a mapping; the worst possible for an arm that cannot be.

        Args:
            mapping: how to read the recordings.
            spread: factor on what the arm may ordinarily have beyond its data sheet.
        """
        eq = self.equations_of(mapping)
        if eq is None:
            return self._worst()
        return _scored(*held_out_gap(eq, mapping, spread))

    def best_score(self, mapping: ChannelMapping) -> MappingScore:
        """What a mapping scores at most: as if no fold had been held out. A quarter of the cost of ``score``."""
        eq = self.equations_of(mapping)
        if eq is None:
            return self._worst()
        return _scored(*fitted_gap(eq, mapping))

    def _worst(self) -> MappingScore:
        """Score of an arm that cannot be."""
        shape = (len(self.samples.folds), self.arm.n_joints)
        return MappingScore(np.full(shape, WORST_GAP), WORST_GAP)

    def gravity_turn(self, mapping: ChannelMapping) -> tuple[float, float] | None:
        """Roll and pitch [rad] of the base that the torque shows under a mapping which does not turn it yet."""
        body = self._body(mapping)
        if body is None or not body.gravity.any() or mapping.without_gravity:
            return None
        q, dq, ddq = mapping.motion(self.samples.q, self.samples.dq, self.samples.ddq)
        tau = mapping.torque(self.samples.torque(mapping.torque_delay))
        regressor = body.gravity_regressor(q)
        needed = body.inverse_dynamics(q, dq, ddq) + self.arm.armature * ddq
        without_gravity = tau - needed + regressor @ body.gravity
        found = gravity_by_torque(without_gravity, regressor, dq, torque_deviation(tau))
        return turn_of_base(body.gravity, found)

    def equations_of(self, mapping: ChannelMapping) -> FoldEquations | None:
        """Equations under a mapping; ``None`` if its inertials leave no arm."""
        key = mapping.equation_key
        if key not in self._equations:
            body = self._body(mapping)
            if body is None:
                return None
            if len(self._equations) > KEPT_EQUATIONS:
                oldest = next(iter(self._equations))
                del self._equations[oldest]
            self._equations[key] = fold_equations(self.arm, body, self.samples, mapping)
        return self._equations[key]

    def _body(self, mapping: ChannelMapping) -> RigidBody | None:
        """Dynamics with the inertials moved and the base turned; ``None`` if a joint is then without a body."""
        key = (mapping.link_shift, mapping.moved_only, mapping.turn)
        if key not in self._bodies:
            try:
                shifted = shifted_body(self.arm, mapping.link_shift, mapping.moved_only)
                body = self.body if shifted is None else shifted
                if any(mapping.turn):
                    gravity = tilt(*mapping.turn).T @ body.gravity
                    body = body.changed(np.zeros((self.arm.n_joints, 10)), gravity)
                self._bodies[key] = body
            except InputError:
                self._bodies[key] = None
        return self._bodies[key]


def _scored(gap: np.ndarray, penalty: float) -> MappingScore:
    """Score of a gap over the torque's deviation, (K, n), and a penalty, kept finite."""
    finite_gap = np.nan_to_num(gap, nan=WORST_GAP, posinf=WORST_GAP)
    finite_penalty = float(np.nan_to_num(penalty, nan=WORST_GAP, posinf=WORST_GAP))
    return MappingScore(
        np.hypot(np.minimum(finite_gap, WORST_GAP), ORDINARY_GAP),
        ORDINARY_PENALTY + finite_penalty,
    )
