"""The arm of a case when the reference was recorded, beyond bodies, rotors, Coulomb and viscous friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.model.nuisance_prior import ReferenceErrors
from gapscope.diagnosis.thresholds import REFERENCE_GAP_GROWTH
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.signals.conditioning import condition, position_cutoff
from gapscope.model.torque_gap import TorqueGap, torque_scale

LEAST_SAMPLES = 8
"""Samples that a recording has at least to be interpolated."""


@dataclass(frozen=True)
class Baseline:
    """What a diagnosis against a reference takes as given, n joints.

    Attributes:
        effects: of the arm on the reference already; they are not reported in the case.
        rest: RMS that the identified arm leaves on stretches of the reference it was not fitted to [N m], (n,).
        scale: normalisation of the torque gap on the reference [N m], (n,).
        skew: by which the recorded torque is ahead of the motion [s].
        errors: what the reference leaves open of the arm, if that counts.
        faults: name and variant of those that show in the reference's recordings as well: they are no change.
        declared: the arm that the case declares, of which its controller knows; ``None`` if it is the identified one.
    """

    effects: tuple[AppliedEffect, ...]
    rest: np.ndarray
    scale: np.ndarray
    skew: float = 0.0
    errors: ReferenceErrors | None = None
    faults: frozenset[tuple[str, str]] = frozenset()
    declared: NominalArm | None = None

    def adjusted(self, case: Case) -> Case:
        """The case with the skew, and what the baseline's effects do, taken out of the recorded torque.

        Joint torque sensors are left out: the arm was identified by the recorded torque, whose errors its bodies hold.

        tau - (tau_nominal+effects - tau_nominal): exact for what adds to the torque, first order for the others.
        """
        case = _without_sensors(case)
        if self.skew:
            case = back_in_time(case, self.skew)
        if not self.effects:
            return case

        body = RigidBody(case.arm)
        cutoff = position_cutoff((*case.recordings, *case.judged))
        corrected = CorrectedArm(case.arm, self.effects)

        def changed(recording: Recording) -> Recording:
            return _without_effects(recording, corrected, body, cutoff)

        return _each_recording(case, changed)

    def floor(self, gap: TorqueGap) -> np.ndarray:
        """RMS that the identified arm may leave on recordings of another day [N m], (n,)."""
        growth = torque_scale(gap.measured) / self.scale
        return self.rest * np.clip(growth, 1.0, REFERENCE_GAP_GROWTH)


def back_in_time(case: Case, skew: float) -> Case:
    """A case whose torque, ahead of the motion by ``skew`` [s], is put back on the motion's time."""

    def changed(recording: Recording) -> Recording:
        t, first = np.unique(recording.t, return_index=True)
        if recording.tau is None or len(t) < LEAST_SAMPLES:
            return recording

        spline = make_interp_spline(t, recording.tau[first], k=3)
        # A cubic leaves its range fast: the ends keep their values.
        earlier = np.clip(recording.t - skew, t[0], t[-1])
        return replace(recording, tau=spline(earlier))

    return _each_recording(case, changed)


def _without_sensors(case: Case) -> Case:
    return _each_recording(case, lambda r: replace(r, tau_sensor=None))


def _without_effects(
    recording: Recording, corrected: CorrectedArm, body: RigidBody, cutoff: float
) -> Recording:
    """A recording with what the effects of an arm do taken out of its torque."""
    if recording.tau is None:
        return recording
    nominal = CorrectedArm(corrected.arm)
    tau = recording.tau.copy()
    for segment in condition(recording, cutoff):
        motion, laden = segment.motion, segment.bodies(body)
        added = corrected.predict(laden, motion) - nominal.predict(laden, motion)

        # The effects are known on the segment's uniform grid; the recording has its own time stamps.
        inside = (recording.t >= motion.t[0]) & (recording.t <= motion.t[-1])
        t = recording.t[inside]
        interpolated = [np.interp(t, motion.t, column) for column in added.T]
        tau[inside] -= np.stack(interpolated, axis=1)
    return replace(recording, tau=tau)


def _each_recording(case: Case, changed: Callable[[Recording], Recording]) -> Case:
    """The case with each of its recordings changed."""
    return replace(
        case,
        recordings=tuple(map(changed, case.recordings)),
        judged=tuple(map(changed, case.judged)),
    )
