"""The pipeline: case, samples in a band, friction law, base parameters, intervals, physical parameters, validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.ident.checks.troubleshooting import Row, fill_in, identification_warnings
from gapscope.ident.estimators.by_name import method
from gapscope.ident.estimators.linear import (
    Estimator,
    PartialUpdate,
    WeightedLeastSquares,
    whitened,
)
from gapscope.ident.examination import (
    Examination,
    Validation,
    identifiability,
    validate,
)
from gapscope.ident.fitted_parameters import (
    FittedParameters,
    IdentificationSettings,
    fit_parameters,
)
from gapscope.ident.intervals import (
    PredictedTorque,
    compare_groups,
    predicted_torque,
    torque_interval,
)
from gapscope.ident.kalman import FilterReview, StatesAndFriction, follow_states, review
from gapscope.ident.model.base_parameters import (
    STATES,
    BaseParameters,
    EssentialParameters,
    Factor,
    Recovery,
    base_parameters,
    essential_parameters,
    random_states,
    recoveries,
)
from gapscope.ident.model.joint_zero import JointZeros, estimate_zeros
from gapscope.ident.model.linear_problem import FrictionLaw, ModelColumns
from gapscope.ident.samples import Samples, count_samples
from gapscope.model.changes import Change, changes_of
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, condition
from gapscope.model.effective_samples import variance_inflation
from gapscope.model.gravity_direction import as_mounted

__all__ = ["Identification", "IdentificationSettings", "examine_fit", "identify"]


@dataclass(frozen=True)
class Identification(FittedParameters):
    """Parameters that were fitted, and what they are worth.

    Attributes:
        examined: what the recordings determine of the parameters.
        changes: what changed during recordings, fitted or held out.
        states: position, velocity and friction by the unscented filter, if the settings ask for it.
        predicted: intervals of the torque on the held-out recordings; ``None`` if model error cannot be estimated.
        recovered: whether and how each parameter is determined.
        zeros: encoder zeros.
        value: x that the model predicts with, shape (p,).
        validation: on what was fitted, and on what was not.
        table: the troubleshooting table.
        condition: of the base columns with unit norm [1].
        questions: what only the user can answer.
        warnings: what makes the result doubtful.
    """

    examined: Examination
    changes: tuple[Change, ...]
    states: StatesAndFriction | None
    predicted: PredictedTorque | None
    recovered: tuple[Recovery, ...]
    zeros: JointZeros
    value: np.ndarray
    validation: tuple[Validation, Validation]
    table: tuple[Row, ...]
    condition: float
    questions: tuple[str, ...]
    warnings: tuple[str, ...]

    @cached_property
    def filtered(self) -> FilterReview:
        """A Kalman filter over the fitted recordings, beside the estimate; it runs when it is first asked for."""
        # beside the filter itself stands least squares, not its own last estimate
        kalman = self.settings.estimator == "kalman"
        batch = None if kalman else self.estimate.value
        return review(self.samples, self.problem, batch, self.changes)

    @property
    def moved(self) -> np.ndarray | None:
        """Which base parameters a partial update moved, the others stay nominal, (b,); ``None`` of other estimators."""
        if not isinstance(self.estimator, PartialUpdate):
            return None
        return self.estimator.moved(self.estimate)

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
    fitted = fit_parameters(case, settings or IdentificationSettings(), progress)
    return examine_fit(fitted, progress)


def examine_fit(
    fitted: FittedParameters, progress: Callable[[str], None] = lambda message: None
) -> Identification:
    """What a fit is worth: zeros, what the recordings determine, prediction of others, changes, and warnings."""
    case, settings, samples = fitted.case, fitted.settings, fitted.samples
    columns, base, estimate = samples.columns, fitted.base, fitted.estimate
    law = fitted.choice.law
    progress("looks at the joints' zeros")
    zeros = estimate_zeros(samples, fitted.choice, fitted.penalty)
    progress("examines what the recordings determine")
    # part of the samples cannot be simulated: what they determine is asked of least squares then
    simulates = method(settings.estimator).simulates
    judge = WeightedLeastSquares() if simulates else fitted.estimator
    examined = _examine(fitted, judge)
    value = model_value(fitted, settings.estimator, estimate.value)
    progress("validates")
    held_out_segments = samples.band.segments(fitted.held_out)
    validation = (
        validated(fitted, value, "fit", samples.segments),
        validated(fitted, value, "judge", held_out_segments),
    )
    table = fill_in(fitted, zeros)
    progress("looks for changes")
    # a change spoils the fit: it is looked for in every recording, fitted or held out
    every = (*fitted.fit, *fitted.held_out)
    arm = as_mounted(case.arm, [s for r in fitted.fit for s in condition(r)])
    changes = changes_of(every, arm, progress).during
    states = None
    if settings.filter == "unscented":
        progress("follows states and friction together")
        # over the first fitted recording, from the parameters of bodies that can exist
        names = columns.names(law)
        identified = dict(zip(names, fitted.physical.value.tolist(), strict=True))
        first, noise = fitted.measured[0], fitted.choice.noise
        states = follow_states(case.arm, first, identified, noise)
    doubtful = identification_warnings(
        fitted, zeros, examined, changes, table, validation
    )
    return Identification(
        **vars(fitted),
        examined=examined,
        changes=changes,
        states=states,
        predicted=_predicted(fitted, examined, value, held_out_segments),
        recovered=recoveries(
            base,
            fitted.uncertainty.covariance,
            fitted.physical.value,
            columns.nominal(law),
            columns.units(law),
        ),
        zeros=zeros,
        value=value,
        validation=validation,
        table=table,
        condition=next(row.measured for row in table if row.key == "condition"),
        questions=zeros.questions(),
        warnings=(*case.warnings, *doubtful),
    )


# What the recordings determine, and what the identified arm predicts.


def model_value(
    fitted: FittedParameters, estimator: str, beta: np.ndarray
) -> np.ndarray:
    """The x that an estimator's model predicts with, (p,), from its base parameters, (b,)."""
    if estimator == "consistent":
        return fitted.physical.value
    # others give base parameters alone; what the motion did not excite stays nominal
    nominal = fitted.columns.nominal(fitted.choice.law)
    return fitted.base.nearest(beta, nominal)


def validated(
    fitted: FittedParameters,
    value: np.ndarray,
    role: str,
    segments: Sequence[Segment],
) -> Validation:
    """Predictions of x = ``value``, (p,), and of the nominal arm on segments with torque; ``role`` names them."""
    columns, law = fitted.columns, fitted.choice.law

    def predict(x: np.ndarray, segment: Segment) -> np.ndarray:
        load = segment.known_torque(columns.body)
        return np.asarray(columns.matrix(segment.motion, law) @ x + load)

    both = partial(predict, value), partial(predict, columns.nominal(law))
    return validate(role, segments, fitted.samples.band, *both)


def _examine(fitted: FittedParameters, estimator: Estimator) -> Examination:
    """Examine what was fitted; ``estimator`` solves parts of it."""
    samples, problem = fitted.samples, fitted.problem
    cutoff = samples.band.cutoff
    structure = _structural(samples.columns, fitted.choice.law)
    shown = identifiability(fitted.matrix, structure)
    reasons: list[str] = []
    essential, groups, interval = None, None, None
    try:
        essential = _essential(fitted)
    except InputError as error:
        reasons.append(f"essential parameters: {error.problem}")
    try:
        groups = compare_groups(problem, estimator, cutoff)
    except (InputError, np.linalg.LinAlgError) as error:
        where = f"{error.where} " if isinstance(error, InputError) else ""
        reasons.append(f"segments: {where}by itself does not determine the parameters")
    # the bands of the split are set for this cut-off; higher up friction of a healthy arm passes for model error
    low_cutoff = min(cutoff, TORQUE_CUTOFF)
    try:
        interval = torque_interval(
            problem,
            estimator,
            fitted.uncertainty,
            low_cutoff,
            fitted.estimate,
        )
    except (InputError, np.linalg.LinAlgError):
        reasons.append(
            "without one of its segments the rest does not determine the parameters; record more motions"
        )
    counted = count_samples(samples, fitted.base.count)
    return Examination(
        shown=shown,
        essential=essential,
        groups=groups,
        interval=interval,
        counted=counted,
        reasons=tuple(reasons),
    )


def _structural(columns: ModelColumns, law: FrictionLaw) -> BaseParameters:
    """Base parameters of the arm, whatever its recordings excite."""
    states = random_states(columns.regressor, np.random.default_rng(0), STATES)
    # the states do not follow from one another, so that no direction can be kept from one to the next
    law = replace(law, presliding=None)
    return base_parameters(columns.matrix(states, law), columns.names(law))


def _essential(fitted: FittedParameters) -> EssentialParameters:
    """Essential parameters of the equations weighted by joint; variances allow for autocorrelation."""
    problem, noise = fitted.problem, fitted.choice.noise
    residual = problem.residual(fitted.estimate.value) / noise
    factor = Factor.of(*whitened(problem, noise))
    inflation = float(variance_inflation(residual, problem.group).mean())
    return essential_parameters(factor, problem.names, inflation)


def _predicted(
    fitted: FittedParameters,
    examined: Examination,
    value: np.ndarray,
    held_out: Sequence[Segment],
) -> PredictedTorque | None:
    """Intervals of the torque on segments that were not fitted, about what x = ``value`` predicts."""
    if examined.interval is None:
        return None
    base, band = fitted.base, fitted.samples.band.bounded(held_out)
    samples = Samples(fitted.columns, held_out, band)
    problem = samples.problem(fitted.choice.law, base.kept, base.kept_names)
    return predicted_torque(examined.interval, problem, base.of(value))
