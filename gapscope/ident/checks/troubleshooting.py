"""The table of what may be wrong with an identification, row by row, and the warnings that follow from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.recording import resting
from gapscope.ident.checks import symptoms
from gapscope.ident.checks.symptoms import FitEvidence
from gapscope.ident.estimators.linear import Estimate
from gapscope.ident.examination import Examination, Validation
from gapscope.ident.model.physical_parameters import inconsistent
from gapscope.model.change_findings import change_findings, change_text
from gapscope.model.changes import Change

# A row of the troubleshooting table: its text, and what was measured.


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


def make_row(
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
    return Row(
        entry=entry,
        measured=float(worst),
        threshold=threshold,
        unit=unit,
        verdict=status,
        joints=joints,
    )


# The troubleshooting table: symptom, cause, check, remedy, filled in from the data.


def fill_in(evidence: FitEvidence) -> tuple[Row, ...]:
    """The table for one identification."""
    return tuple(check(evidence) for check in CHECKS)


def _zero(evidence: FitEvidence) -> Row:
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


def _bodies_row(evidence: FitEvidence) -> Row:
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


def _low_speed(evidence: FitEvidence) -> Row:
    entry = Entry(
        key="low_speed_friction",
        symptom="residual peaks where a joint reverses",
        cause="low-speed friction other than Coulomb plus viscous: falls as the joint moves off, "
        "or rises less than linearly",
        check="share by which a Stribeck term lowers the error on held-out stretches",
        remedy="none needed, the term is part of the model then; record slow reversals to determine it",
    )
    return make_row(entry, symptoms.near_rest(evidence), 0.05)


def _condition(evidence: FitEvidence) -> Row:
    entry = Entry(
        key="condition",
        symptom="large intervals, parameters that change from fit to fit",
        cause="motion that does not excite all parameters",
        check="condition number of the base columns with unit norm",
        remedy="record an exciting trajectory (`gapscope excite`); without one, stay near the nominal arm: "
        "--estimator ridge, truncated_svd or partial_update, or --keep what it knows",
    )
    return make_row(entry, symptoms.condition(evidence), 1000.0)


def _rest(evidence: FitEvidence) -> Row:
    entry = Entry(
        key="resting_joint",
        symptom="parameters of a joint missing among the base parameters",
        cause="the joint does not move",
        check="number of joints that rest",
        remedy="record a motion of every joint",
    )
    still = _still_joints(evidence)
    return Row(
        entry=entry,
        measured=float(len(still)),
        threshold=0.0,
        unit="1",
        verdict=FOUND if len(still) else CLEAR,
        joints=tuple(int(j) + 1 for j in still),
    )


def _still_joints(evidence: FitEvidence) -> np.ndarray:
    """Joints, from 0, that rest in every fitted recording."""
    fitted = [r for r in evidence.recordings if r.tau is not None]
    return np.flatnonzero(resting(fitted, evidence.samples.columns.arm.per_radian))


def _noise(evidence: FitEvidence) -> Row:
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


def _cutoff(evidence: FitEvidence) -> Row:
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


def _late(evidence: FitEvidence) -> Row:
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


def _saturated(evidence: FitEvidence) -> Row:
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


CHECKS: tuple[Callable[[FitEvidence], Row], ...] = (
    *(_zero, _bodies_row, _low_speed),
    *(_condition, _rest, _noise, _cutoff, _late, _saturated),
)
"""The rows, in the order in which to look at them."""


# What makes an identification doubtful: warnings, each a sentence with a remedy.


BODIES = "unphysical"
"""Row of the table that says whether parameters of no body are certain."""
WORSE = "what was held out is predicted worse than by the nominal arm"
"""How the warning begins that comes before all others."""
SAID_OTHERWISE = (
    "low_speed_friction",
    "resting_joint",
    "condition",
    BODIES,
)
"""Rows of the troubleshooting table that need no warning, or have a fuller one here."""


def identification_warnings(
    evidence: FitEvidence,
    estimate: Estimate,
    examined: Examination,
    changes: Sequence[Change],
    table: Sequence[Row],
    held_out: Validation,
) -> tuple[str, ...]:
    """The warnings, those that concern all results first."""
    return (
        *_worse(held_out, examined.counted.per_parameter),
        *_changed(changes),
        *estimate.warnings,
        *examined.warnings(),
        *_still(evidence),
        *_bodies_warning(evidence, table),
        *_rows(table),
    )


def _worse(held_out: Validation, per_parameter: float) -> Iterator[str]:
    # p parameters from n samples predict others with a squared error of 1 + p / n times the noise's, even if the
    # nominal arm is exact; that share is itself uncertain by as much
    by_chance = 1.0 + 2.0 / max(per_parameter, 1e-3)
    if held_out.every.overall**2 > by_chance * held_out.nominal.overall**2:
        yield (
            f"{WORSE}: {held_out.every.overall:.1%} of the torque against {held_out.nominal.overall:.1%}; use the "
            "nominal arm, record an exciting trajectory (`gapscope excite`), or stay nearer to it: --estimator ridge, "
            "truncated_svd or partial_update, --keep"
        )


def _changed(changes: Sequence[Change]) -> Iterator[str]:
    for entry in change_findings(changes):
        yield f"{change_text(entry)}; cut the recording there, and name a known load in payloads:"


def _still(evidence: FitEvidence) -> Iterator[str]:
    still = _still_joints(evidence)
    if len(still):
        joints = ", ".join(str(j + 1) for j in still)
        yield f"joint {joints} rests in every fitted recording: its own parameters are not identifiable"


def _bodies_warning(evidence: FitEvidence, table: Sequence[Row]) -> Iterator[str]:
    wrong = inconsistent(evidence.physical.before)
    # noise alone takes parameters that the data hardly determine out of what bodies can have
    certain = any(row.entry.key == BODIES and row.verdict == FOUND for row in table)
    if wrong and (certain or len(evidence.zeros.asked)):
        negative = [str(c.link) for c in wrong if not c.positive_mass]
        masses = (
            f"; link {', '.join(negative)} even of negative mass" if negative else ""
        )
        yield (
            f"the parameters nearest to the nominal arm that fit best are those of no body on link "
            f"{', '.join(str(c.link) for c in wrong)}{masses}: the consistent ones are used instead"
        )


def _rows(table: Sequence[Row]) -> Iterator[str]:
    for row in table:
        if row.verdict == FOUND and row.entry.key not in SAID_OTHERWISE:
            where = f" on joint {', '.join(map(str, row.joints))}" if row.joints else ""
            yield f"{row.entry.cause}{where}: {row.entry.remedy}"
