"""The troubleshooting table: symptom, cause, check, remedy, filled in from the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gapscope.ident.checks import symptoms
from gapscope.ident.checks.fit_evidence import (
    FitEvidence,
    NominalSimilarity,
    nominal_similarity,
)
from gapscope.ident.checks.plausible_samples import UNIT_FACTOR, resting, unit_factor
from gapscope.ident.checks.table_row import CLEAR, FOUND, Entry, Row, make_row
from gapscope.ident.checks.torque_gain import GAIN, torque_gain
from gapscope.ident.model.physical_parameters import inconsistent


def fill_in(evidence: FitEvidence) -> tuple[Row, ...]:
    """The table for one identification."""
    similarity = nominal_similarity(evidence.samples)
    return tuple(check(evidence, similarity) for check in CHECKS)


def _unit(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    factor = unit_factor(similarity)
    entry = Entry(
        key="torque_unit",
        symptom="masses and friction off by the same factor",
        cause="torque in mN m, a raw current, or on the motor's side",
        check="RMS of recorded over nominal torque, or its inverse, median joint",
        remedy="state unit, scale and transmission in the case's import section",
    )
    return make_row(entry, max(factor, 1 / max(factor, 1e-300)), UNIT_FACTOR)


def _gain(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    found = torque_gain(similarity)
    entry = Entry(
        key="torque_gain",
        symptom="masses and friction of all joints off by about the same factor",
        cause="torque in another unit, or a wrong torque constant or gear ratio",
        check="gain of the nominal bodies' torque, or its inverse, median joint, if most joints agree",
        remedy="state unit, scale and transmission in the case's import section, or correct the URDF",
    )
    return Row(
        entry=entry,
        measured=found.size,
        threshold=GAIN,
        unit="1",
        verdict=FOUND if found.found else CLEAR,
        joints=found.joints if found.found else (),
    )


def _sign(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="torque_sign",
        symptom="negative friction or inertia on one joint",
        cause="torque or position of the joint counted the other way round",
        check="gain of the nominal bodies' torque if they show; else power that friction takes over power",
        remedy="set import: {signs: [...]} for the joint",
    )
    clear = similarity.weight > 0.05
    value = np.where(clear, similarity.gain, similarity.loss)
    return make_row(entry, value, -0.25, below=True)


def _swapped(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    won, joints = symptoms.exchanged(similarity.explained)
    entry = Entry(
        key="swapped_joints",
        symptom="two joints whose torque fits neither's motion",
        cause="columns of two joints exchanged",
        check="share of the torque's variance that another order of the joints explains in addition, per joint moved",
        remedy="set joints: or the columns in the case's import section in the order of the arm",
    )
    found = won > 0.2
    return Row(
        entry=entry,
        measured=won,
        threshold=0.2,
        unit="1",
        verdict=FOUND if found else CLEAR,
        joints=joints if found else (),
    )


def _zero(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    zeros = evidence.zeros
    asked = zeros.asked
    entry = Entry(
        key="joint_zero",
        symptom="negative masses, inertias that no body has",
        cause="zero of an encoder off",
        check="offset estimated together with the parameters, if it is certain and lowers the cost",
        remedy="calibrate the zero, or set import: {offsets: [...]}",
    )
    known = np.where(zeros.known, np.abs(zeros.offset), 0.0)
    # an offset that nobody is asked about stays below the threshold
    worst = min(known.max(), np.deg2rad(0.999))
    if len(asked):
        worst = known[asked].max()
    return Row(
        entry=entry,
        measured=float(np.rad2deg(worst)),
        threshold=1.0,
        unit="deg",
        verdict=FOUND if len(asked) else CLEAR,
        joints=tuple(int(j) + 1 for j in asked),
    )


def _bodies(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="unphysical",
        symptom="the torque fits, the bodies cannot exist",
        cause="model error taken up by parameters: wrong zero, friction, geometry; or too little excitation",
        check="mean square distance of consistent from estimated base parameters, in standard deviations",
        remedy="look at the rows beside this one; keep the consistent parameters for simulation",
    )
    change = evidence.base.of(evidence.physical.value) - evidence.beta
    deviations = change / np.maximum(evidence.deviation, 1e-300)
    row = make_row(entry, float((deviations**2).mean()), 10.0)
    if row.verdict == CLEAR:
        return row
    wrong = inconsistent(evidence.physical.before)
    return replace(row, joints=tuple(check.link for check in wrong))


def _low_speed(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="low_speed_friction",
        symptom="residual peaks where a joint reverses",
        cause="low-speed friction other than Coulomb plus viscous: falls as the joint moves off, "
        "or rises less than linearly",
        check="share by which a Stribeck term lowers the error on held-out stretches",
        remedy="none needed, the term is part of the model then; record slow reversals to determine it",
    )
    return make_row(entry, symptoms.near_rest(evidence), 0.05)


def _condition(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="condition",
        symptom="large intervals, parameters that change from fit to fit",
        cause="motion that does not excite all parameters",
        check="condition number of the base columns with unit norm",
        remedy="record an exciting trajectory (`gapscope excite`); without one, stay near the nominal arm: "
        "--estimator ridge, truncated_svd or partial_update, or --keep what it knows",
    )
    return make_row(entry, symptoms.condition(evidence), 1000.0)


def _rest(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="resting_joint",
        symptom="parameters of a joint missing among the base parameters",
        cause="the joint does not move",
        check="number of joints that rest",
        remedy="record a motion of every joint",
    )
    still = resting([r for r in evidence.recordings if r.tau is not None])
    return Row(
        entry=entry,
        measured=float(len(still)),
        threshold=0.0,
        unit="1",
        verdict=FOUND if len(still) else CLEAR,
        joints=tuple(int(j) + 1 for j in still),
    )


def _noise(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="derivative_noise",
        symptom="rotor and link inertias too small, noisy acceleration",
        cause="noise of the encoder differentiated twice: cut-off too high, or encoder too coarse",
        check="RMS of the noise in the acceleration over RMS of the acceleration",
        remedy="lower --cutoff, move faster, or record a finer encoder",
    )
    return make_row(
        entry,
        symptoms.acceleration_noise(evidence.recordings, evidence.samples.band.cutoff),
        0.3,
    )


def _cutoff(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="cutoff_too_low",
        symptom="fast parts of the motion badly predicted",
        cause="cut-off below what the motion holds",
        check="share of the speed's power beyond the cut-off",
        remedy="raise --cutoff, or move more slowly",
    )
    return make_row(
        entry,
        symptoms.speed_lost(evidence.recordings, evidence.samples.band.cutoff),
        0.05,
    )


def _late(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="time_offset",
        symptom="viscous friction too large, small or negative, residual that follows the torque's rate",
        cause="torque recorded late or early against position, or a delayed drive",
        check="lag of the torque estimated together with the parameters, if it exceeds five standard deviations",
        remedy="put both on one clock: import: {join: interpolate}, or shift one; then `gapscope diagnose` for a delay",
    )
    lag, deviation = symptoms.time_offset(evidence)
    certain = np.where(np.abs(lag) > 5 * deviation, np.abs(lag), 0.0)
    return make_row(entry, 1e3 * certain, 3.0, "ms")


def _saturated(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        key="saturated_torque",
        symptom="inertia and friction too small, flat tops",
        cause="torque at the drive's limit",
        check="share of samples at the limit, or held exactly at the extreme",
        remedy="move more slowly, or leave these stretches out",
    )
    recordings = [r for r in evidence.recordings if r.tau is not None]
    return make_row(
        entry,
        symptoms.clipped(recordings, evidence.samples.columns.arm.torque_limit),
        0.005,
    )


CHECKS: tuple[Callable[[FitEvidence, NominalSimilarity], Row], ...] = (
    *(_unit, _gain, _sign, _swapped, _zero, _bodies, _low_speed),
    *(_condition, _rest, _noise, _cutoff, _late, _saturated),
)
"""The rows, in the order in which to look at them."""
