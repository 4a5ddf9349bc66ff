"""The troubleshooting table: symptom, cause, check, remedy, filled in from the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gapscope.ident.checks import symptoms
from gapscope.ident.checks.fit_evidence import (
    FitEvidence,
    NominalSimilarity,
    nominal_similarity,
)
from gapscope.ident.checks.plausible_samples import UNIT_FACTOR, resting, unit_factor
from gapscope.ident.checks.torque_gain import GAIN, torque_gain
from gapscope.ident.model.physical_parameters import inconsistent

FOUND, CLEAR = "found", "clear"


@dataclass(frozen=True)
class Entry:
    """The text of a row of the table, whatever the data.

    Attributes:
        key: name of the row.
        symptom: what one sees.
        cause: what is behind it.
        check: how the data show it.
        remedy: what to do.
    """

    key: str
    symptom: str
    cause: str
    check: str
    remedy: str


@dataclass(frozen=True)
class Row:
    """A row of the table, filled in.

    Attributes:
        entry: its text.
        measured: the number that the check gave; the worst joint's.
        threshold: beyond which the row is found.
        unit: of both.
        verdict: ``found`` or ``clear``.
        joints: where, from 1.
    """

    entry: Entry
    measured: float
    threshold: float
    unit: str
    verdict: str
    joints: tuple[int, ...] = ()


def fill_in(evidence: FitEvidence) -> tuple[Row, ...]:
    """The table for one identification."""
    similarity = nominal_similarity(evidence.samples)
    return tuple(check(evidence, similarity) for check in CHECKS)


def _row(
    entry: Entry,
    value: np.ndarray | float,
    threshold: float,
    unit: str = "1",
    *,
    below: bool = False,
) -> Row:
    """A row that is found if a value per joint exceeds the threshold, or falls below it if ``below``."""
    per_joint = np.ndim(value) > 0
    values = np.atleast_1d(np.asarray(value, dtype=float))
    if below:
        found, worst = values < threshold, values.min()
    else:
        found, worst = values > threshold, values.max()
    joints: tuple[int, ...] = ()
    if per_joint:
        joints = tuple(int(j) + 1 for j in np.flatnonzero(found))
    status = FOUND if found.any() else CLEAR
    return Row(entry, float(worst), threshold, unit, status, joints)


def _unit(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    factor = unit_factor(similarity)
    entry = Entry(
        "torque_unit",
        "masses and friction off by the same factor",
        "torque in mN m, a raw current, or on the motor's side",
        "RMS of recorded over nominal torque, or its inverse, median joint",
        "state unit, scale and transmission in the case's import section",
    )
    return _row(entry, max(factor, 1 / max(factor, 1e-300)), UNIT_FACTOR)


def _gain(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    found = torque_gain(similarity)
    entry = Entry(
        "torque_gain",
        "masses and friction of all joints off by about the same factor",
        "torque in another unit, or a wrong torque constant or gear ratio",
        "gain of the nominal bodies' torque, or its inverse, median joint, if most joints agree",
        "state unit, scale and transmission in the case's import section, or correct the URDF",
    )
    return Row(
        entry,
        found.size,
        GAIN,
        "1",
        FOUND if found.found else CLEAR,
        found.joints if found.found else (),
    )


def _sign(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "torque_sign",
        "negative friction or inertia on one joint",
        "torque or position of the joint counted the other way round",
        "gain of the nominal bodies' torque if they show; else power that friction takes over power",
        "set import: {signs: [...]} for the joint",
    )
    clear = similarity.weight > 0.05
    value = np.where(clear, similarity.gain, similarity.loss)
    return _row(entry, value, -0.25, below=True)


def _swapped(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    won, joints = symptoms.exchanged(similarity.explained)
    entry = Entry(
        "swapped_joints",
        "two joints whose torque fits neither's motion",
        "columns of two joints exchanged",
        "share of the torque's variance that another order of the joints explains in addition, per joint moved",
        "set joints: or the columns in the case's import section in the order of the arm",
    )
    found = won > 0.2
    return Row(entry, won, 0.2, "1", FOUND if found else CLEAR, joints if found else ())


def _zero(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    zeros = evidence.zeros
    asked = zeros.asked
    entry = Entry(
        "joint_zero",
        "negative masses, inertias that no body has",
        "zero of an encoder off",
        "offset estimated together with the parameters, if it is certain and lowers the cost",
        "calibrate the zero, or set import: {offsets: [...]}",
    )
    known = np.where(zeros.known, np.abs(zeros.offset), 0.0)
    worst = float(
        np.rad2deg(
            known[asked].max() if len(asked) else min(known.max(), np.deg2rad(0.999))
        )
    )
    return Row(
        entry,
        worst,
        1.0,
        "deg",
        FOUND if len(asked) else CLEAR,
        tuple(int(j) + 1 for j in asked),
    )


def _bodies(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "unphysical",
        "the torque fits, the bodies cannot exist",
        "model error taken up by parameters: wrong zero, friction, geometry; or too little excitation",
        "mean square distance of consistent from estimated base parameters, in standard deviations",
        "look at the rows beside this one; keep the consistent parameters for simulation",
    )
    wrong = inconsistent(evidence.physical.before)
    gap = (evidence.base.of(evidence.physical.value) - evidence.beta) / np.maximum(
        evidence.deviation, 1e-300
    )
    row = _row(entry, float((gap**2).mean()), 10.0)
    return Row(
        entry,
        row.measured,
        10.0,
        "1",
        row.verdict,
        tuple(c.link for c in wrong) if row.verdict == FOUND else (),
    )


def _low_speed(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "low_speed_friction",
        "residual peaks where a joint reverses",
        "low-speed friction other than Coulomb plus viscous: falls as the joint moves off, or rises less than linearly",
        "share by which a Stribeck term lowers the error on held-out stretches",
        "none needed, the term is part of the model then; record slow reversals to determine it",
    )
    return _row(entry, symptoms.near_rest(evidence), 0.05)


def _condition(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "condition",
        "large intervals, parameters that change from fit to fit",
        "motion that does not excite all parameters",
        "condition number of the base columns with unit norm",
        "record an exciting trajectory (`gapscope excite`)",
    )
    return _row(entry, symptoms.condition(evidence), 1000.0)


def _rest(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "resting_joint",
        "parameters of a joint missing among the base parameters",
        "the joint does not move",
        "number of joints that rest",
        "record a motion of every joint",
    )
    still = resting([r for r in evidence.recordings if r.tau is not None])
    return Row(
        entry,
        float(len(still)),
        0.0,
        "1",
        FOUND if len(still) else CLEAR,
        tuple(int(j) + 1 for j in still),
    )


def _noise(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "derivative_noise",
        "rotor and link inertias too small, noisy acceleration",
        "noise of the encoder differentiated twice: cut-off too high, or encoder too coarse",
        "RMS of the noise in the acceleration over RMS of the acceleration",
        "lower --cutoff, move faster, or record a finer encoder",
    )
    return _row(
        entry,
        symptoms.acceleration_noise(evidence.recordings, evidence.samples.band.cutoff),
        0.3,
    )


def _cutoff(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "cutoff_too_low",
        "fast parts of the motion badly predicted",
        "cut-off below what the motion holds",
        "share of the speed's power beyond the cut-off",
        "raise --cutoff, or move more slowly",
    )
    return _row(
        entry,
        symptoms.speed_lost(evidence.recordings, evidence.samples.band.cutoff),
        0.05,
    )


def _late(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "time_offset",
        "viscous friction too large, small or negative, residual that follows the torque's rate",
        "torque recorded late or early against position, or a delayed drive",
        "lag of the torque estimated together with the parameters, if it exceeds five standard deviations",
        "put both on one clock: import: {join: interpolate}, or shift one; then `gapscope diagnose` for a delay",
    )
    lag, deviation = symptoms.time_offset(evidence)
    certain = np.where(np.abs(lag) > 5 * deviation, np.abs(lag), 0.0)
    return _row(entry, 1e3 * certain, 3.0, "ms")


def _saturated(evidence: FitEvidence, similarity: NominalSimilarity) -> Row:
    entry = Entry(
        "saturated_torque",
        "inertia and friction too small, flat tops",
        "torque at the drive's limit",
        "share of samples at the limit, or held exactly at the extreme",
        "move more slowly, or leave these stretches out",
    )
    recordings = [r for r in evidence.recordings if r.tau is not None]
    return _row(
        entry,
        symptoms.clipped(recordings, evidence.samples.columns.arm.torque_limit),
        0.005,
    )


CHECKS: tuple[Callable[[FitEvidence, NominalSimilarity], Row], ...] = (
    *(_unit, _gain, _sign, _swapped, _zero, _bodies, _low_speed),
    *(_condition, _rest, _noise, _cutoff, _late, _saturated),
)
"""The rows, in the order in which to look at them."""
