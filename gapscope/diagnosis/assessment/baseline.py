"""What the arm of a case was when the reference was recorded, beyond bodies, rotors and plain friction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.torque_gap import TorqueGap, torque_scale
from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.model.terms import Term, Terms
from gapscope.diagnosis.selection.evidence import evidences
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import (
    BASELINE_LINEARISATIONS,
    LINK_OVER_PAYLOAD,
    REFERENCE_GAP_GROWTH,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.signals.conditioning import condition, position_cutoff

LEAST_SAMPLES = 8
"""Samples that a recording has at least to be interpolated."""


@dataclass(frozen=True)
class Baseline:
    """What a diagnosis against a reference takes as given, n joints.

    Attributes:
        effects: of the arm on the reference already; no news in the case.
        rest: RMS that the identified arm leaves on stretches of the reference it was not fitted to [N m], (n,).
        scale: normalisation of the torque gap on the reference [N m], (n,).
        skew: by which the recorded torque is ahead of the motion [s].
        open: effects with their joint, 0 for any, that the reference leaves open: they are not named.
    """

    effects: tuple[AppliedEffect, ...]
    rest: np.ndarray
    scale: np.ndarray
    skew: float = 0.0
    open: frozenset[tuple[str, int]] = frozenset()

    def kept(self, selection: Selection) -> Selection:
        """A search less what the reference leaves open; a load where it explains as much as a changed link."""
        terms = frozenset(
            t
            for t in selection.fit.terms
            if not {(t.effect, t.joint), (t.effect, 0)} & self.open
        )
        fit = (
            selection.fit
            if terms == selection.fit.terms
            else selection.evidence.fit(terms)
        )
        selection = replace(selection, fit=fit)
        links = frozenset(t for t in terms if t.effect == "link_inertia")
        if not links:
            return selection
        load = _searched(
            selection, terms - links | frozenset(selection.evidence.terms.of("payload"))
        )
        return load if load.fit.score > fit.score - LINK_OVER_PAYLOAD else selection

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
        body, cutoff = (
            RigidBody(case.arm),
            position_cutoff((*case.recordings, *case.judged)),
        )
        with_effects = CorrectedArm(case.arm, self.effects)

        def changed(recording: Recording) -> Recording:
            if recording.tau is None:
                return recording
            tau = recording.tau.copy()
            for segment in condition(recording, cutoff):
                motion, laden = segment.motion, segment.bodies(body)
                does = with_effects.predict(laden, motion) - CorrectedArm(
                    case.arm
                ).predict(laden, motion)
                rows = (recording.t >= motion.t[0]) & (recording.t <= motion.t[-1])
                tau[rows] -= np.stack(
                    [np.interp(recording.t[rows], motion.t, x) for x in does.T], axis=1
                )
            return replace(recording, tau=tau)

        return replace(
            case,
            recordings=tuple(map(changed, case.recordings)),
            judged=tuple(map(changed, case.judged)),
        )

    def floor(self, gap: TorqueGap) -> np.ndarray:
        """RMS that the identified arm may leave on recordings of another day [N m], (n,)."""
        return self.rest * np.clip(
            torque_scale(gap.measured) / self.scale, 1.0, REFERENCE_GAP_GROWTH
        )


def back_in_time(case: Case, skew: float) -> Case:
    """A case whose torque, ahead of the motion by ``skew`` [s], is put back on the motion's time."""

    def changed(recording: Recording) -> Recording:
        t, first = np.unique(recording.t, return_index=True)
        if recording.tau is None or len(t) < LEAST_SAMPLES:
            return recording
        spline = make_interp_spline(t, recording.tau[first], k=3)
        return replace(recording, tau=spline(np.clip(recording.t - skew, t[0], t[-1])))

    return replace(
        case,
        recordings=tuple(map(changed, case.recordings)),
        judged=tuple(map(changed, case.judged)),
    )


def _without_sensors(case: Case) -> Case:
    recordings, judged = (
        tuple(replace(r, tau_sensor=None) for r in part)
        for part in (case.recordings, case.judged)
    )
    return replace(case, recordings=recordings, judged=judged)


def _searched(selection: Selection, terms: frozenset[Term]) -> Selection:
    """The search with other terms, linearised around their values."""
    linear = selection.evidence.linear
    shapes = {
        t: selection.evidence.terms.shapes[t]
        for t in terms
        if t in selection.evidence.terms.shapes
    }
    theta, scored_mse = (
        np.zeros(selection.evidence.terms.size),
        selection.fit.scored_mse,
    )
    for _ in range(BASELINE_LINEARISATIONS):
        linear = Linearisation(linear.data, theta, Terms(linear.arm.n_joints, shapes))
        evidence = evidences(linear, scored_mse, terms)[0]
        fit = evidence.fit(terms)
        theta, scored_mse = fit.theta, fit.scored_mse
    return replace(selection, fit=fit, evidence=evidence)
