"""The pipeline: case, samples in a band, friction law, base parameters, intervals, physical parameters, validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.ident.checks.fit_evidence import FitEvidence, nominal_similarity
from gapscope.ident.checks.plausible_samples import (
    check_count,
    check_recordings,
    check_unit,
)
from gapscope.ident.checks.table_row import Row
from gapscope.ident.checks.troubleshooting import fill_in
from gapscope.ident.checks.warnings import identification_warnings
from gapscope.ident.estimators.by_name import Given, method
from gapscope.ident.estimators.closed_loop import closed_loop
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.held_out import base_problem, predicted, validated
from gapscope.ident.kalman.changes import RecordingChange, find_changes
from gapscope.ident.kalman.review import FilterReview, review
from gapscope.ident.kalman.states_and_friction import (
    StatesAndFriction,
    follow_states,
)
from gapscope.ident.model.base_parameters import BaseParameters, base_parameters
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.joint_zero import JointZeros, estimate_zeros
from gapscope.ident.model.law_choice import Choice, choose, penalties
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.model.physical_parameters import Physical, consistent
from gapscope.ident.model.recoverability import Recovery, recoveries
from gapscope.ident.signals.conditioning import position_cutoff
from gapscope.ident.signals.samples import Band, Samples
from gapscope.ident.signals.split import split
from gapscope.ident.uncertainty.examination import Examination, examine
from gapscope.ident.uncertainty.intervals import Uncertainty
from gapscope.ident.uncertainty.torque_interval import PredictedTorque
from gapscope.ident.uncertainty.validation import Validation

FILTERS = ("recursive", "unscented")
"""What follows the parameters over time; the recursive filter always does."""


@dataclass(frozen=True)
class IdentificationSettings:
    """How to identify.

    Attributes:
        cutoff: of both sides [Hz]; chosen from the spectra of the positions if ``None``.
        estimator: one of ``gapscope.ident.estimators.by_name.METHODS``.
        judge: names of recordings to hold out; if empty those that the case holds out, else the last one.
        any_torque: continue if the torque seems to be in another unit.
        trim: leave out both ends of a segment, where the filter settles.
        filter: ``recursive``, or ``unscented`` to follow states and friction together as well.
        plain: only what URDF, data sheet and effects can express: no friction that keeps its direction at rest.
    """

    cutoff: float | None = None
    estimator: str = "consistent"
    judge: tuple[str, ...] = ()
    any_torque: bool = False
    trim: bool = True
    filter: str = "recursive"
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
        uncertainty: of the base parameters, as belongs to the estimator.
        examined: what the recordings determine of the parameters.
        changes: changes of load or friction during recordings.
        filtered: a Kalman filter over the fitted recordings, beside the estimate.
        states: position, velocity and friction by the unscented filter, if the settings ask for it.
        predicted: intervals of the torque on the held-out recordings; ``None`` if model error cannot be estimated.
        physical: consistent parameters.
        recovered: whether and how each parameter is determined.
        zeros: encoder zeros.
        value: x that the model predicts with, shape (p,).
        validation: on what was fitted, and on what was not.
        table: the troubleshooting table.
        condition: of the base columns with unit norm [1].
        questions: what only the user can answer.
        warnings: what makes the result doubtful.
    """

    case: Case
    settings: IdentificationSettings
    columns: ModelColumns
    choice: Choice
    base: BaseParameters
    estimate: Estimate
    uncertainty: Uncertainty
    examined: Examination
    changes: tuple[RecordingChange, ...]
    filtered: FilterReview
    states: StatesAndFriction | None
    predicted: PredictedTorque | None
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
    case: Case,
    settings: IdentificationSettings | None = None,
    progress: Callable[[str], None] = lambda message: None,
) -> Identification:
    """Identify an arm from the recordings of a case.

    Raises:
        InputError: the recordings or the settings cannot be used.
        GapscopeError: no physically consistent parameters were found.
    """
    settings = settings or IdentificationSettings()
    method(settings.estimator)
    if settings.filter not in FILTERS:
        raise InputError(
            f"unknown filter {settings.filter!r}",
            f"use {' or '.join(FILTERS)}",
            where="--filter",
        )
    fit, held_out = split(case, settings.judge)
    check_recordings(fit, held_out, case.name)
    # one cut-off for all recordings, so that their equations are comparable
    if settings.cutoff is None:
        settings = replace(settings, cutoff=position_cutoff(tuple(fit)))
    assert settings.cutoff is not None
    band = Band(settings.cutoff, settings.trim)
    columns = ModelColumns(case.arm)
    segments = band.segments(fit)
    samples = Samples(columns, segments, band.bounded(segments))
    similarity = nominal_similarity(samples)
    # another unit would be fitted without complaint, as heavier links
    if not settings.any_torque:
        check_unit(similarity, fit[0].name)
    evidence, estimate, uncertainty, examined = _fit(
        case, samples, fit, settings, progress
    )
    base, law = evidence.base, evidence.choice.law
    # other estimators give base parameters alone; the rest stays zero, which predicts the same torque
    value = evidence.physical.value
    if settings.estimator != "consistent":
        value = base.spread(estimate.value)
    progress("validates, and looks for changes")
    held_out_segments = band.segments(held_out)
    validation = validated(evidence, value, held_out_segments, band)
    table = fill_in(evidence)
    # a change spoils the fit: it is looked for in every recording, fitted or held out
    changes = find_changes((*fit, *held_out), columns, law, base, band)
    progress("follows the parameters over time")
    # beside the filter itself stands least squares, not its own last estimate
    batch = None if settings.estimator == "kalman" else estimate.value
    problem = base_problem(samples, evidence.choice, base)
    states = None
    if settings.filter == "unscented":
        progress("follows states and friction together")
        states = _states(case, fit, evidence)
    doubtful = identification_warnings(
        evidence, estimate, examined, changes, similarity, table, validation[1]
    )
    return Identification(
        case=case,
        settings=settings,
        columns=columns,
        choice=evidence.choice,
        base=base,
        estimate=estimate,
        uncertainty=uncertainty,
        examined=examined,
        changes=changes,
        filtered=review(samples, problem, batch, changes),
        states=states,
        predicted=predicted(evidence, examined, value, held_out_segments),
        physical=evidence.physical,
        recovered=recoveries(
            base,
            uncertainty.covariance,
            evidence.physical.value,
            columns.nominal(law),
            columns.units(law),
        ),
        zeros=evidence.zeros,
        value=value,
        validation=validation,
        table=table,
        condition=next(row.measured for row in table if row.entry.key == "condition"),
        questions=evidence.zeros.questions(),
        warnings=(*case.warnings, *doubtful),
    )


def _states(
    case: Case, fit: Sequence[Recording], evidence: FitEvidence
) -> StatesAndFriction:
    """The unscented filter over the first fitted recording, from the parameters of bodies that can exist."""
    names = evidence.samples.columns.names(evidence.choice.law)
    identified = dict(zip(names, evidence.physical.value.tolist(), strict=True))
    recording = next(r for r in fit if r.tau is not None)
    return follow_states(case.arm, recording, identified, evidence.choice.noise)


def _fit(
    case: Case,
    samples: Samples,
    fit: Sequence[Recording],
    settings: IdentificationSettings,
    progress: Callable[[str], None],
) -> tuple[FitEvidence, Estimate, Uncertainty, Examination]:
    """Friction law, base parameters with intervals, consistent parameters, zeros, and what the recordings show."""
    columns = samples.columns
    # whether the samples suffice is known with the simplest friction law
    simplest = _sample_base(samples.matrix(FrictionLaw()), columns, FrictionLaw())
    check_count(samples, simplest.count, fit[0].name)
    progress("chooses the form of the friction")
    chosen = method(settings.estimator)
    rich = not chosen.simulates
    choice = choose(samples, nonlinear=rich, presliding=rich and not settings.plain)
    matrix = samples.matrix(choice.law)
    base = _sample_base(matrix, columns, choice.law)
    progress(f"estimates {base.count} base parameters")
    problem = base_problem(samples, choice, base)
    nominal = columns.nominal(choice.law)
    given = Given(base, nominal, lambda: closed_loop(case, fit, samples, base, problem))
    estimator = chosen.make(given)
    estimate = estimator.estimate(problem)
    uncertainty = chosen.interval(problem, estimator, estimate)
    progress("recovers physical parameters")
    weighted = matrix[:, :, base.kept] / choice.noise[:, None]
    flat = weighted.reshape(-1, base.count)
    penalty = choice.pull * penalties(samples, choice.law, matrix, choice.noise)
    physical = consistent(
        base,
        estimate.value,
        flat.T @ flat,
        nominal,
        samples.torque.size * penalty,
        columns.arm.n_joints,
    )
    progress("looks at the joints' zeros")
    zeros = estimate_zeros(
        columns, samples.segments, choice.law, samples.band, choice.noise, penalty
    )
    evidence = FitEvidence(
        recordings=fit,
        samples=samples,
        choice=choice,
        base=base,
        matrix=matrix,
        beta=estimate.value,
        deviation=uncertainty.deviation,
        physical=physical,
        zeros=zeros,
    )
    progress("examines what the recordings determine")
    # part of the samples cannot be simulated: what they determine is asked of least squares then
    judge = WeightedLeastSquares() if chosen.simulates else estimator
    examined = examine(evidence, problem, judge, estimate, uncertainty)
    return evidence, estimate, uncertainty, examined


def _sample_base(
    matrix: np.ndarray, columns: ModelColumns, law: FrictionLaw
) -> BaseParameters:
    """Base parameters that the samples of a regressor, shape (M, n, p), excite."""
    return base_parameters(matrix.reshape(-1, matrix.shape[2]), columns.names(law))
