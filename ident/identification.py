"""The pipeline: case, samples in a band, friction law, base parameters, intervals, physical parameters, validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from arm.case import Case
from arm.errors import InputError
from arm.motion import Motion
from arm.recording import CHANNELS, Recording
from ident.base_parameters import BaseParameters, base_parameters
from ident.conditioning import position_cutoff
from ident.estimate import Estimate, Estimator
from ident.estimators.irls import HuberLeastSquares
from ident.estimators.maximum_likelihood import MaximumLikelihood
from ident.estimators.ols import OrdinaryLeastSquares
from ident.estimators.ridge import Ridge
from ident.estimators.total_least_squares import TotalLeastSquares
from ident.estimators.truncated_svd import TruncatedSvd
from ident.estimators.wls import WeightedLeastSquares
from ident.evidence import Evidence, likeness
from ident.friction_law import FrictionLaw
from ident.joint_zero import JointZeros, estimate_zeros
from ident.law_choice import Choice, choose, penalties
from ident.model_columns import ModelColumns
from ident.physical import Physical, consistent, inconsistent
from ident.plausible_samples import check_count, check_recordings, check_unit, resting
from ident.recoverability import Recovery, recoveries
from ident.samples import Band, Samples
from ident.troubleshooting import FOUND, Row, fill_in
from ident.uncertainty import Uncertainty, sandwich
from ident.validation import Validation, validate

ESTIMATORS: dict[str, Callable[[], Estimator]] = {
    "consistent": WeightedLeastSquares,
    "wls": WeightedLeastSquares,
    "ols": OrdinaryLeastSquares,
    "irls": HuberLeastSquares,
    "ridge": Ridge,
    "truncated_svd": TruncatedSvd,
    "total_least_squares": TotalLeastSquares,
    "maximum_likelihood": MaximumLikelihood,
}
"""Estimators by name; ``consistent`` is weighted least squares constrained to bodies that can exist."""
HELD_OUT = 1 / 3
"""Share of a single recording that is set aside, its end [1]."""


@dataclass(frozen=True)
class Settings:
    """How to identify.

    Attributes:
        cutoff: of both sides [Hz]; chosen from the spectra of the positions where ``None``.
        estimator: one of ``ESTIMATORS``.
        judge: names of recordings to judge on; where empty those that the case sets aside, else the last one.
        any_torque: go on where the torque seems to be in another unit.
        trim: leave out both ends of a segment, where the filter settles.
        plain: only what URDF, data sheet and the catalogue's effects can say: no coupled motors, no friction that
            keeps its direction at rest.
    """

    cutoff: float | None = None
    estimator: str = "consistent"
    judge: tuple[str, ...] = ()
    any_torque: bool = False
    trim: bool = True
    plain: bool = False


@dataclass(frozen=True)
class Identification:
    """What was identified.

    Attributes:
        case: the case.
        settings: with the cut-off that was used.
        columns: the model tau = W x.
        choice: friction law, pull and noise.
        base: base parameters of the samples.
        estimate: of the base parameters.
        uncertainty: of the base parameters, for residuals that are no white noise.
        physical: consistent parameters.
        recovered: what can be said about each parameter.
        zeros: encoder zeros.
        value: x that the model predicts with, shape (p,).
        validation: on what was fitted, and on what was not.
        table: the troubleshooting table.
        condition: of the base columns with unit norm [1].
        questions: what only the user can answer.
        warnings: what makes the result doubtful.
    """

    case: Case
    settings: Settings
    columns: ModelColumns
    choice: Choice
    base: BaseParameters
    estimate: Estimate
    uncertainty: Uncertainty
    physical: Physical
    recovered: tuple[Recovery, ...]
    zeros: JointZeros
    value: np.ndarray
    validation: tuple[Validation, Validation]
    table: tuple[Row, ...]
    condition: float
    questions: tuple[str, ...]
    warnings: tuple[str, ...]

    def predict(self, motion: Motion) -> np.ndarray:
        """Torque that would be recorded on a motion without payload [N m], shape (N, n)."""
        return np.asarray(self.columns.matrix(motion, self.choice.law) @ self.value)


def identify(
    case: Case, settings: Settings | None = None, progress: Callable[[str], None] = lambda message: None
) -> Identification:
    """Identify an arm from the recordings of a case.

    Raises:
        InputError: the recordings or the settings cannot be used; says why and what to do.
        GapscopeError: no physically consistent parameters were found.
    """
    settings = settings or Settings()
    if settings.estimator not in ESTIMATORS:
        raise InputError(
            f"unknown estimator {settings.estimator!r}", f"use {', '.join(ESTIMATORS)}", where="--estimator"
        )
    fit, judged = split(case, settings.judge)
    check_recordings(fit, judged, case.name)
    if settings.cutoff is None:
        settings = replace(settings, cutoff=position_cutoff(tuple(fit)))
    assert settings.cutoff is not None
    band = Band(settings.cutoff, settings.trim)
    columns = ModelColumns(case.arm, None if settings.plain else case.importing)
    samples = Samples(columns, band.segments(fit), band)
    if not settings.any_torque:
        check_unit(likeness(samples), fit[0].name)
    evidence, estimate, uncertainty = _fit(samples, fit, settings, progress)
    value = evidence.physical.value
    if settings.estimator != "consistent":
        value = evidence.base.spread(estimate.value)
    progress("validates")
    law = evidence.choice.law
    nominal = columns.nominal(law)
    models = [
        lambda segment, x=x: columns.matrix(segment.motion, law) @ x + segment.known_torque(columns.body)
        for x in (value, nominal)
    ]
    validation = (
        validate("fit", samples.segments, band, *models),
        validate("judge", band.segments(judged), band, *models),
    )
    table = fill_in(evidence)
    found = recoveries(evidence.base, uncertainty.covariance, evidence.physical.value, nominal, columns.units(law))
    condition = next(row.measured for row in table if row.entry.key == "condition")
    return Identification(
        case, settings, columns, evidence.choice, evidence.base, estimate, uncertainty, evidence.physical, found,
        evidence.zeros, value, validation, table, condition, evidence.zeros.questions(),
        _warnings(case, fit, evidence, estimate, table),
    )  # fmt: skip


def _fit(
    samples: Samples, fit: Sequence[Recording], settings: Settings, progress: Callable[[str], None]
) -> tuple[Evidence, Estimate, Uncertainty]:
    """Friction law, base parameters with intervals, consistent parameters and zeros."""
    columns, n = samples.columns, samples.columns.arm.n_joints
    plain = samples.matrix(FrictionLaw())
    rank = base_parameters(plain.reshape(-1, plain.shape[2]), columns.names(FrictionLaw())).count
    check_count(samples, rank, fit[0].name)
    progress("chooses the form of the friction")
    choice = choose(samples, presliding=not settings.plain)
    matrix = samples.matrix(choice.law)
    base = base_parameters(matrix.reshape(-1, matrix.shape[2]), columns.names(choice.law))
    progress(f"estimates {base.count} base parameters")
    problem = samples.problem(choice.law, base.kept, [base.names[k] for k in base.kept])
    estimate = ESTIMATORS[settings.estimator]().estimate(problem)
    weight = np.diag(choice.noise**-2.0)
    uncertainty = sandwich(problem, estimate.value, weight)
    progress("recovers physical parameters")
    kept = (matrix[:, :, base.kept] / choice.noise[:, None]).reshape(-1, base.count)
    information = kept.T @ kept
    penalty = choice.pull * penalties(samples, choice.law, matrix, choice.noise)
    nominal = columns.nominal(choice.law)
    physical = consistent(base, estimate.value, information, nominal, samples.torque.size * penalty, n)
    progress("looks at the joints' zeros")
    zeros = estimate_zeros(columns, samples.segments, choice.law, samples.band, choice.noise, penalty)
    evidence = Evidence(fit, samples, choice, base, matrix, estimate.value, uncertainty.deviation, physical, zeros)
    return evidence, estimate, uncertainty


def split(case: Case, chosen: Sequence[str] = ()) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit, and to judge: those chosen by name, else the case's, else the last one or the last third.

    Raises:
        InputError: a name is not that of a recording, or nothing is left to fit.
    """
    everything = [*case.recordings, *case.judged]
    if chosen:
        names = [recording.name for recording in everything]
        for name in chosen:
            if name not in names:
                raise InputError(f"no recording is called {name!r}", f"there are {', '.join(names)}", where="--judge")
        fit = [r for r in everything if r.name not in chosen]
        if not fit:
            raise InputError("every recording is to be judged on, none is left to fit", where="--judge")
        return fit, [r for r in everything if r.name in chosen]
    if case.judged:
        return list(case.recordings), list(case.judged)
    if len(case.recordings) > 1:
        return list(case.recordings[:-1]), [case.recordings[-1]]
    (only,) = case.recordings
    cut = int(len(only.t) * (1 - HELD_OUT))
    return [_part(only, slice(0, cut), "start")], [_part(only, slice(cut, None), "end")]


def _part(recording: Recording, rows: slice, label: str) -> Recording:
    changed: dict[str, Any] = {"name": f"{recording.name}, {label}", "t": recording.t[rows]}
    for name in CHANNELS:
        series = getattr(recording, name)
        changed[name] = None if series is None else series[rows]
    return replace(recording, **changed)


def _warnings(
    case: Case, fit: Sequence[Recording], evidence: Evidence, estimate: Estimate, table: Sequence[Row]
) -> tuple[str, ...]:
    out = [*case.warnings, *estimate.warnings]
    still = resting([r for r in fit if r.tau is not None])
    if len(still):
        joints = ", ".join(str(j + 1) for j in still)
        out.append(f"joint {joints} rests in every fitted recording: its own parameters are not identifiable")
    wrong = inconsistent(evidence.physical.before)
    if wrong:
        negative = [str(c.link) for c in wrong if not c.positive_mass]
        masses = f"; link {', '.join(negative)} even of negative mass" if negative else ""
        out.append(
            f"the parameters nearest to the nominal arm that fit best are those of no body on link "
            f"{', '.join(str(c.link) for c in wrong)}{masses}: the consistent ones are used instead"
        )
    for row in table:
        if row.verdict == FOUND and row.entry.key not in ("low_speed_friction", "resting_joint"):
            where = f" on joint {', '.join(map(str, row.joints))}" if row.joints else ""
            out.append(f"{row.entry.cause}{where}: {row.entry.remedy}")
    return tuple(out)
