"""The table of what may be wrong with an identification, row by row, and the warnings that follow from it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.recording import resting
from gapscope.ident.checks import symptoms
from gapscope.ident.estimators.linear import column_norms
from gapscope.ident.examination import CONDITION_LIMIT, Examination, Validation
from gapscope.ident.fitted_parameters import FittedParameters
from gapscope.ident.model.base_parameters import TINY, Factor, condition_number
from gapscope.ident.model.joint_zero import JointZeros
from gapscope.ident.model.physical_parameters import inconsistent
from gapscope.model.changes import Change, change_findings, change_text
from gapscope.model.effective_samples import group_slices, variance_inflation

# The troubleshooting table: symptom, cause, check, remedy, filled in from the data.


FOUND, CLEAR = "found", "clear"
SLOW, FAST = 0.1, 0.95
"""A joint hardly moves below this share of its speed, which it exceeds for the rest of this share of the time [1]."""


@dataclass(frozen=True)
class Row:
    """A row of the table, filled in.

    Attributes:
        key: name of the row.
        symptom: what one sees.
        cause: what is behind it.
        check: how the data show it.
        remedy: what to do.
        measured: the number that the check gave; the worst joint's.
        threshold: beyond which the row is found.
        unit: of both.
        verdict: ``found`` or ``clear``.
        joints: where, from 1.
    """

    key: str
    symptom: str
    cause: str
    check: str
    remedy: str
    measured: float
    threshold: float
    unit: str
    verdict: str
    joints: tuple[int, ...] = ()


def _row(
    key: str,
    value: np.ndarray | float,
    threshold: float,
    unit: str = "1",
    joints: Sequence[int] | np.ndarray | None = None,
    **text: str,
) -> Row:
    """A row that is found where a value per joint exceeds the threshold; or, if ``joints`` are given, on those."""
    values = np.atleast_1d(np.asarray(value, dtype=float))
    exceeded = values > threshold
    found = bool(exceeded.any()) if joints is None else len(joints) > 0
    where = (np.flatnonzero(exceeded) + 1).tolist() if np.ndim(value) else []
    return Row(
        key=key,
        **text,
        measured=float(values.max()),
        threshold=threshold,
        unit=unit,
        verdict=FOUND if found else CLEAR,
        joints=tuple(where if joints is None else joints),
    )


def fill_in(fitted: FittedParameters, zeros: JointZeros) -> tuple[Row, ...]:
    """The table for one identification, its rows in the order in which to look at them."""
    return (*_about_bodies(fitted, zeros), *_about_motion(fitted))


def _about_bodies(fitted: FittedParameters, zeros: JointZeros) -> Iterator[Row]:
    asked = zeros.asked
    known = np.where(zeros.known, np.abs(zeros.offset), 0.0)
    # an offset that nobody is asked about stays below the threshold
    worst = min(known.max(), np.deg2rad(0.999))
    yield _row(
        "joint_zero",
        np.rad2deg(known[asked].max() if len(asked) else worst),
        1.0,
        "deg",
        joints=(asked + 1).tolist(),
        symptom="negative masses, inertias that no body has",
        cause="zero of an encoder off",
        check="offset estimated together with the parameters, if it is certain and lowers the cost",
        remedy="calibrate the zero, or set import: {offsets: [...]}",
    )
    change = fitted.base.of(fitted.physical.value) - fitted.estimate.value
    deviations = change / np.maximum(fitted.uncertainty.deviation, TINY)
    impossible = _row(
        BODIES,
        float((deviations**2).mean()),
        10.0,
        symptom="the torque fits, the bodies cannot exist",
        cause="model error taken up by parameters: wrong zero, friction, geometry; or too little excitation",
        check="mean square distance of consistent from estimated base parameters, in standard deviations",
        remedy="look at the rows beside this one; keep the consistent parameters for simulation",
    )
    if impossible.verdict == FOUND:
        wrong = inconsistent(fitted.physical.before)
        impossible = replace(impossible, joints=tuple(check.link for check in wrong))
    yield impossible
    yield _row(
        "low_speed_friction",
        symptoms.near_rest(fitted.choice),
        0.05,
        symptom="residual peaks where a joint reverses",
        cause="low-speed friction other than Coulomb plus viscous: falls as the joint moves off, "
        "or rises less than linearly",
        check="share by which a Stribeck term lowers the error on held-out stretches",
        remedy="none needed, the term is part of the model then; record slow reversals to determine it",
    )


def _time_offset(fit: FittedParameters) -> tuple[np.ndarray, np.ndarray]:
    """How far the recorded torque lags behind the motion, and its standard deviation [s], each (n,).

    tau(t - T) = tau - T d tau / dt: the derivative of the fitted torque of each joint is a further column. If a
    joint hardly moves, its friction jumps or takes any value as at rest, which resembles an offset: these samples do
    not count.
    """
    samples, base, fitted = fit.samples, fit.base, fit.fitted_torque
    n, speed = fitted.shape[1], np.abs(samples.velocity)
    moving = speed > SLOW * np.quantile(speed, FAST, axis=0)
    weight = moving / fit.choice.noise
    residual = (samples.torque - fitted) * weight
    rate = np.concatenate(
        [
            np.gradient(fitted[rows], samples.interval, axis=0)
            for rows in group_slices(samples.group)
        ]
    )
    late = -rate[:, :, None] * np.eye(n)
    columns = np.concatenate([fit.matrix[:, :, base.kept], late], axis=2)
    flat = (columns * weight[:, :, None]).reshape(residual.size, -1)
    unit = column_norms(flat)
    factor = Factor.of(flat / unit, residual.ravel())
    inverse: np.ndarray = np.linalg.pinv(factor.triangle, rcond=1e-9)
    solution, spread = inverse @ factor.rotated, np.linalg.norm(inverse, axis=1)
    # samples at rest have no weight: they do not count in the mean of the squares either
    counted = np.maximum(moving.mean(axis=0), 1 / len(moving))
    variance = (residual**2).mean(axis=0) / counted
    scale = np.sqrt(variance * variance_inflation(residual, samples.group))
    return solution[-n:] / unit[-n:], spread[-n:] / unit[-n:] * scale


def _about_motion(fitted: FittedParameters) -> Iterator[Row]:
    yield _row(
        "condition",
        condition_number(fitted.matrix[:, :, fitted.base.kept]),
        CONDITION_LIMIT,
        symptom="large intervals, parameters that change from fit to fit",
        cause="motion that does not excite all parameters",
        check="condition number of the base columns with unit norm",
        remedy="record an exciting trajectory (`gapscope excite`); without one, stay near the nominal arm: "
        "--estimator ridge, truncated_svd or partial_update, or --keep what it knows",
    )
    still = _still_joints(fitted)
    yield _row(
        "resting_joint",
        float(len(still)),
        0.0,
        joints=(still + 1).tolist(),
        symptom="parameters of a joint missing among the base parameters",
        cause="the joint does not move",
        check="number of joints that rest",
        remedy="record a motion of every joint",
    )
    cutoff = fitted.samples.band.cutoff
    noise, lost = symptoms.spectral(fitted.fit, cutoff)
    yield _row(
        "derivative_noise",
        noise,
        0.3,
        symptom="rotor and link inertias too small, noisy acceleration",
        cause="noise of the encoder differentiated twice: cut-off too high, or encoder too coarse",
        check="RMS of the noise in the acceleration over RMS of the acceleration",
        remedy="lower --cutoff, move faster, or record a finer encoder",
    )
    yield _row(
        "cutoff_too_low",
        lost,
        0.05,
        symptom="fast parts of the motion badly predicted",
        cause="cut-off below what the motion holds",
        check="share of the speed's power beyond the cut-off",
        remedy="raise --cutoff, or move more slowly",
    )
    lag, deviation = _time_offset(fitted)
    certain = np.where(np.abs(lag) > 5 * deviation, np.abs(lag), 0.0)
    yield _row(
        "time_offset",
        1e3 * certain,
        3.0,
        "ms",
        symptom="viscous friction too large, small or negative, residual that follows the torque's rate",
        cause="torque recorded late or early against position, or a delayed drive",
        check="lag of the torque estimated together with the parameters, if it exceeds five standard deviations",
        remedy="put both on one clock: import: {join: interpolate}, or shift one; then `gapscope diagnose` for a delay",
    )
    yield _row(
        "saturated_torque",
        symptoms.clipped(fitted.measured, fitted.case.arm.torque_limit),
        0.005,
        symptom="inertia and friction too small, flat tops",
        cause="torque at the drive's limit",
        check="share of samples at the limit, or held exactly at the extreme",
        remedy="move more slowly, or leave these stretches out",
    )


def _still_joints(fitted: FittedParameters) -> np.ndarray:
    """Joints, from 0, that rest in every fitted recording."""
    arm = fitted.samples.columns.arm
    return np.flatnonzero(resting(fitted.measured, arm.per_radian))


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
    fitted: FittedParameters,
    zeros: JointZeros,
    examined: Examination,
    changes: Sequence[Change],
    table: Sequence[Row],
    validation: tuple[Validation, Validation],
) -> tuple[str, ...]:
    """The warnings, those that concern all results first."""
    fit, held_out = validation
    found = []
    if predicts_worse(fit, held_out, examined.counted.per_parameter):
        found.append(
            f"{WORSE}: {held_out.every.overall:.1%} of the torque against {held_out.nominal.overall:.1%}; use the "
            "nominal arm, record an exciting trajectory (`gapscope excite`), or stay nearer to it: --estimator ridge, "
            "truncated_svd or partial_update, --keep"
        )
    for entry in change_findings(changes):
        found.append(
            f"{change_text(entry)}; cut the recording there, and name a known load in payloads:"
        )
    found += [*fitted.estimate.warnings, *examined.warnings()]
    still = _still_joints(fitted)
    if len(still):
        found.append(
            f"joint {_numbers(still + 1)} rests in every fitted recording: its own parameters are not identifiable"
        )
    wrong = inconsistent(fitted.physical.before)
    rows = [row for row in table if row.verdict == FOUND]
    # noise alone takes parameters that the data hardly determine out of what bodies can have
    certain = any(row.key == BODIES for row in rows)
    if wrong and (certain or len(zeros.asked)):
        negative = _numbers(c.link for c in wrong if not c.positive_mass)
        masses = f"; link {negative} even of negative mass" if negative else ""
        found.append(
            f"the parameters nearest to the nominal arm that fit best are those of no body on link "
            f"{_numbers(c.link for c in wrong)}{masses}: the consistent ones are used instead"
        )
    for row in rows:
        if row.key not in SAID_OTHERWISE:
            where = f" on joint {_numbers(row.joints)}" if row.joints else ""
            found.append(f"{row.cause}{where}: {row.remedy}")
    return tuple(found)


def _numbers(values: Iterable[int]) -> str:
    return ", ".join(map(str, values))


def predicts_worse(fit: Validation, held_out: Validation, per_parameter: float) -> bool:
    """Whether the nominal arm predicts better than a fit to so many independent samples per parameter, beyond chance.

    p parameters from n samples predict others with p / n of the noise's square more than the noise itself, even if the
    nominal arm is exact; that share is itself uncertain by as much. The noise is what the fit leaves.
    """
    ours, nominal, noise = (
        float((own.rmse**2).sum())
        for own in (held_out.every, held_out.nominal, fit.every)
    )
    return ours > nominal + 2.0 / per_parameter * noise
