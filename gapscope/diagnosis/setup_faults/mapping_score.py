"""Readings of a case compared: how well each lets an ordinary arm explain torque that was not used to fit.

The gain of a reading is the sum over joints of log(R without / R with), R = sqrt(gap^2 + ORDINARY_GAP^2) with the
held-out gap over the torque's deviation, and of log(S without / S with), S = surprise + ORDINARY_SURPRISE with the
surprise at the values that the arm would have to have. The floors keep small effects from counting: a setup fault is
gross.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.fault_samples import Samples
from gapscope.diagnosis.setup_faults.nuisance import Equations, equations, unseen
from gapscope.diagnosis.setup_faults.shifted_inertials import shifted_arm
from gapscope.diagnosis.thresholds import ORDINARY_GAP, ORDINARY_SURPRISE, WORST_GAP


@dataclass(frozen=True)
class Score:
    """How a reading did.

    Attributes:
        residual: sqrt(gap^2 + ORDINARY_GAP^2) of each fold and joint, (K, n).
        surprise: at the values fitted to all folds, plus ``ORDINARY_SURPRISE``.
    """

    residual: np.ndarray
    surprise: float

    def joints(self, before: Score) -> np.ndarray:
        """Gain of each joint over another reading, (n,)."""
        rms = [np.sqrt((s.residual**2).mean(axis=0)) for s in (before, self)]
        return np.log(rms[0] / rms[1])

    def folds(self, before: Score) -> np.ndarray:
        """Gain of each fold, summed over joints, (K,)."""
        return np.log(before.residual / self.residual).sum(axis=1)

    def values(self, before: Score) -> float:
        """Gain in surprise."""
        return float(np.log(before.surprise / self.surprise))

    def gain(self, before: Score) -> float:
        """Gain in all."""
        return float(self.joints(before).sum()) + self.values(before)


@dataclass
class MappingScorer:
    """Readings of one case on its samples; equations of the last few motions are kept.

    Attributes:
        arm, body: the nominal arm and its dynamics.
        samples: what is looked at.
    """

    arm: NominalArm
    body: RigidBody
    samples: Samples
    _kept: dict[tuple[object, ...], Equations] = field(default_factory=dict)
    _bodies: dict[tuple[int, bool], RigidBody | None] = field(default_factory=dict)

    def score(self, reading: ChannelMapping, spread: float = 1.0) -> Score:
        """Score of a reading; the worst possible for an arm that cannot be.

        Args:
            reading: how to read the recordings.
            spread: factor on what the arm may ordinarily have beyond its data sheet.
        """
        key = reading.motion_key
        if key not in self._kept:
            body = self._body(reading.shift, reading.moved_only)
            if body is None:
                return Score(
                    np.full((len(self.samples.folds), self.arm.n_joints), WORST_GAP),
                    WORST_GAP,
                )
            if len(self._kept) > 8:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = equations(self.arm, body, self.samples, reading)
        gap, surprise = unseen(self._kept[key], reading, spread)
        bounded = np.minimum(
            np.nan_to_num(gap, nan=WORST_GAP, posinf=WORST_GAP), WORST_GAP
        )
        return Score(
            np.hypot(bounded, ORDINARY_GAP),
            ORDINARY_SURPRISE
            + float(np.nan_to_num(surprise, nan=WORST_GAP, posinf=WORST_GAP)),
        )

    def _body(self, shift: int, moved_only: bool) -> RigidBody | None:
        if (shift, moved_only) not in self._bodies:
            try:
                changed = shifted_arm(self.arm, shift, moved_only)
                self._bodies[shift, moved_only] = (
                    self.body if changed is self.arm else RigidBody(changed)
                )
            except InputError:
                self._bodies[shift, moved_only] = None
        return self._bodies[shift, moved_only]
