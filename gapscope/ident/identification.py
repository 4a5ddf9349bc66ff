"""The pipeline: case, samples in a band, friction law, base parameters, intervals, physical parameters, validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.ident.checks.fit_evidence import FitEvidence, nominal_similarity
from gapscope.ident.checks.plausible_samples import (
    check_count,
    check_recordings,
    check_unit,
)
from gapscope.ident.checks.troubleshooting import Row, fill_in
from gapscope.ident.checks.warnings import doubts
from gapscope.ident.estimators.by_name import method
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.kalman.changes import FoundChange, find_changes
from gapscope.ident.model.base_parameters import BaseParameters, base_parameters
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.joint_zero import JointZeros, estimate_zeros
from gapscope.ident.model.law_choice import Choice, choose, penalties
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.model.physical_parameters import Physical, consistent
from gapscope.ident.model.recoverability import Recovery, recoveries
from gapscope.ident.signals.conditioning import Segment, position_cutoff
from gapscope.ident.signals.samples import Band, Samples
from gapscope.ident.signals.split import split
from gapscope.ident.uncertainty.examination import Examination, examine
from gapscope.ident.uncertainty.intervals import Uncertainty
from gapscope.ident.uncertainty.torque_interval import PredictedTorque, predicted_torque
from gapscope.ident.uncertainty.validation import Validation, validate


@dataclass(frozen=True)
class IdentificationSettings:
    """How to identify.

    Attributes:
        cutoff: of both sides [Hz]; chosen from the spectra of the positions if ``None``.
        estimator: one of ``gapscope.ident.estimators.by_name.METHODS``.
        judge: names of the held-out recordings; if empty those of the case, else the last one.
        any_torque: continue if the torque seems to be in another unit.
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
        uncertainty: of the base parameters, as belongs to the estimator.
        examined: what the recordings determine of the parameters.
        changes: changes of load or friction during recordings.
        predicted: intervals of the torque on the judged recordings; ``None`` if model error cannot be told.
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
    settings: IdentificationSettings
    columns: ModelColumns
    choice: Choice
    base: BaseParameters
    estimate: Estimate
    uncertainty: Uncertainty
    examined: Examination
    changes: tuple[FoundChange, ...]
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
        InputError: the recordings or the settings cannot be used; says why and what to do.
        GapscopeError: no physically consistent parameters were found.
    """
    settings = settings or IdentificationSettings()
    method(settings.estimator)
    fit, judged = split(case, settings.judge)
    check_recordings(fit, judged, case.name)
    if settings.cutoff is None:
        settings = replace(settings, cutoff=position_cutoff(tuple(fit)))
    assert settings.cutoff is not None
    band = Band(settings.cutoff, settings.trim)
    columns = ModelColumns(case.arm, None if settings.plain else case.importing)
    segments = band.segments(fit)
    samples = Samples(columns, segments, band.bounded(segments))
    alike = nominal_similarity(samples)
    if not settings.any_torque:
        check_unit(alike, fit[0].name)
    evidence, estimate, uncertainty, examined = _fit(samples, fit, settings, progress)
    value = evidence.physical.value
    if settings.estimator != "consistent":
        value = evidence.base.spread(estimate.value)
    progress("validates, and looks for changes")
    law = evidence.choice.law
    nominal = columns.nominal(law)
    models = [
        lambda segment, x=x: (
            columns.matrix(segment.motion, law) @ x + segment.known_torque(columns.body)
        )
        for x in (value, nominal)
    ]
    unseen = band.segments(judged)
    validation = (
        validate("fit", samples.segments, band, *models),
        validate("judge", unseen, band, *models),
    )
    table = fill_in(evidence)
    found = recoveries(
        evidence.base,
        uncertainty.covariance,
        evidence.physical.value,
        nominal,
        columns.units(law),
    )
    condition = next(row.measured for row in table if row.entry.key == "condition")
    changes = find_changes((*fit, *judged), columns, law, evidence.base, band)
    warnings = (
        *case.warnings,
        *doubts(evidence, estimate, examined, changes, alike, table, validation[1]),
    )
    return Identification(
        case,
        settings,
        columns,
        evidence.choice,
        evidence.base,
        estimate,
        uncertainty,
        examined,
        changes,
        _predicted(evidence, examined, value, unseen),
        evidence.physical,
        found,
        evidence.zeros,
        value,
        validation,
        table,
        condition,
        evidence.zeros.questions(),
        warnings,
    )


def _predicted(
    evidence: FitEvidence,
    examined: Examination,
    value: np.ndarray,
    unseen: Sequence[Segment],
) -> PredictedTorque | None:
    """Intervals of the torque on segments that were not fitted, about what x = ``value`` predicts."""
    if examined.interval is None:
        return None
    base, law = evidence.base, evidence.choice.law
    samples = Samples(
        evidence.samples.columns, unseen, evidence.samples.band.bounded(unseen)
    )
    problem = samples.problem(law, base.kept, [base.names[k] for k in base.kept])
    return predicted_torque(examined.interval, problem, base.of(value))


def _fit(
    samples: Samples,
    fit: Sequence[Recording],
    settings: IdentificationSettings,
    progress: Callable[[str], None],
) -> tuple[FitEvidence, Estimate, Uncertainty, Examination]:
    """Friction law, base parameters with intervals, consistent parameters, zeros, and what the recordings determine."""
    columns, n = samples.columns, samples.columns.arm.n_joints
    plain = samples.matrix(FrictionLaw())
    rank = base_parameters(
        plain.reshape(-1, plain.shape[2]), columns.names(FrictionLaw())
    ).count
    check_count(samples, rank, fit[0].name)
    progress("chooses the form of the friction")
    choice = choose(samples, presliding=not settings.plain)
    matrix = samples.matrix(choice.law)
    base = base_parameters(
        matrix.reshape(-1, matrix.shape[2]), columns.names(choice.law)
    )
    progress(f"estimates {base.count} base parameters")
    problem = samples.problem(choice.law, base.kept, [base.names[k] for k in base.kept])
    chosen, nominal = method(settings.estimator), columns.nominal(choice.law)
    estimator = chosen.make(base, nominal)
    estimate = estimator.estimate(problem)
    uncertainty = chosen.interval(problem, estimator, estimate)
    progress("recovers physical parameters")
    kept = (matrix[:, :, base.kept] / choice.noise[:, None]).reshape(-1, base.count)
    information = kept.T @ kept
    penalty = choice.pull * penalties(samples, choice.law, matrix, choice.noise)
    physical = consistent(
        base, estimate.value, information, nominal, samples.torque.size * penalty, n
    )
    progress("looks at the joints' zeros")
    zeros = estimate_zeros(
        columns, samples.segments, choice.law, samples.band, choice.noise, penalty
    )
    evidence = FitEvidence(
        fit,
        samples,
        choice,
        base,
        matrix,
        estimate.value,
        uncertainty.deviation,
        physical,
        zeros,
    )
    progress("examines what the recordings tell")
    return (
        evidence,
        estimate,
        uncertainty,
        examine(evidence, problem, estimator, estimate, uncertainty),
    )
