"""Identification: parameters fitted to recordings, what they are worth, and what makes them doubtful."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np
from scipy.linalg import cholesky
from scipy.optimize import least_squares
from scipy.signal import welch

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nearest_name import check_known
from gapscope.arm.recording import Recording, held_torque, resting
from gapscope.ident.estimators.by_name import SIMULATING, Given, method
from gapscope.ident.estimators.linear import (
    SLIGHT,
    Estimate,
    Estimator,
    column_norms,
    weighted_least_squares,
    whitened,
)
from gapscope.ident.estimators.simulating import closed_loop
from gapscope.ident.intervals import (
    GroupComparison,
    PredictedTorque,
    TorqueInterval,
    Uncertainty,
    Whiteness,
    compare_groups,
    form_columns,
    predicted_torque,
    torque_interval,
    whiteness,
)
from gapscope.ident.kalman import (
    FilterReview,
    StatesAndFriction,
    check_followed,
    follow_states,
    review,
)
from gapscope.ident.model.base_parameters import (
    CONDITION_LIMIT,
    CONTRIBUTION,
    ROUNDING,
    STATES,
    TINY,
    BaseParameters,
    EssentialParameters,
    Factor,
    Recovery,
    base_parameters,
    condition_number,
    essential_parameters,
    random_states,
    rank_by_gap,
    recoveries,
    unit_triangle,
)
from gapscope.ident.model.physical_parameters import (
    Physical,
    check_links,
    consistent,
    inconsistent,
)
from gapscope.ident.samples import (
    AT_LIMIT,
    MOVING,
    PER_CUTOFF,
    PER_PARAMETER,
    Choice,
    FrictionLaw,
    ModelColumns,
    Problem,
    SampleCount,
    Samples,
    check_recordings,
    choose,
    count_samples,
    penalties,
    pulled_solution,
    split,
)
from gapscope.model.changes import Change, change_findings, change_text, changes_of
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    position_cutoff,
    uniform,
)
from gapscope.model.effective_samples import (
    band_samples,
    group_slices,
    variance_inflation,
)
from gapscope.model.readings import as_mounted
from gapscope.model.rows import DecimatedSegments

# Encoder zeros estimated together with the parameters: what negative masses lead to asking.


WIDTH = 0.15
"""Standard deviation that zeros are believed to have before the data speak [rad]."""
KNOWN = 0.1
"""An offset is determined if the data shrink its deviation to less than this share of ``WIDTH`` [1]."""
LEAST = np.deg2rad(1.0)
"""Smaller offsets are no reason to ask [rad]."""
CERTAIN = 8.0
"""An offset of fewer standard deviations is no reason to ask; model error makes them too small on real arms [1]."""
LARGEST = np.deg2rad(45.0)
"""Offsets are sought up to this; one that ends there is not determined [rad]."""


@dataclass(frozen=True)
class JointZeros:
    """Offsets of the encoders, recorded q = true q + offset.

    Attributes:
        offset: [rad], shape (n,).
        deviation: standard deviation [rad], shape (n,).
        known: whether data and nominal arm determine it, shape (n,); no joint if the search did not converge.
        asked: joints, from 0, whose zero must be asked about: the offset is large and certain, and with the offsets the
            fit is much better, or more bodies become possible.
    """

    offset: np.ndarray
    deviation: np.ndarray
    known: np.ndarray
    asked: np.ndarray

    def questions(self) -> tuple[str, ...]:
        """A question about each zero that must be asked about."""
        # recorded q = true q + offset, and an import adds: it takes the other sign
        offset, deviation = np.rad2deg(self.offset), np.rad2deg(self.deviation)
        return tuple(
            f"is the zero of joint {j + 1} right? The torque fits physical bodies with a zero that is off by "
            f"{offset[j]:+.2f} ± {deviation[j]:.2f} degrees; if so, say in the case "
            f"import: {{offsets: [...]}} with {-self.offset[j]:+.4f} rad for this joint, or calibrate it"
            for j in self.asked
        )


def estimate_zeros(samples: Samples, choice: Choice, penalty: np.ndarray) -> JointZeros:
    """Estimate offsets and parameters of tau = W(q - offset) x.

    Minimises sum |(tau - W(q - delta) x) / noise|^2 / rows + sum_k w_k (x_k - x0_k)^2 + |delta|^2 / (rows WIDTH^2)
    over |delta| <= LARGEST by a trust region; x follows from delta by linear least squares (variable projection). The
    pull to the nominal arm decides if the links' own parameters could take up an offset: of the first joint about the
    vertical it leaves the offset open, of the last joint it says how far the nominal link would need to be turned.

    Args:
        samples: with their segments, the model and the band of both sides.
        choice: form of the dry friction, and RMS residual per joint.
        penalty: w, shape (p,).

    Source: hollerbach2008, golub1973.
    """
    columns = samples.columns
    n, rows = columns.arm.n_joints, samples.torque.size

    # the solver asks for the residual and its derivative at the same offsets
    @cache
    def at(offset: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return _reduced(samples, choice, rows * penalty, np.array(offset))

    widest = LARGEST * columns.arm.per_radian
    found = least_squares(
        lambda offset: at(tuple(offset))[1],
        np.zeros(n),
        jac=lambda offset: at(tuple(offset))[2],
        bounds=(-widest, widest),
        # less than the noise of the data makes of the cost
        ftol=CONTRIBUTION**2,
    )
    # the same cost without offsets is the rival: the gain is by the offsets alone
    ends = at((0.0,) * n), at(tuple(found.x))
    impossible, with_offsets = (
        len(inconsistent(check_links(value[: columns.links]))) for value, *_ in ends
    )
    without, cost = (float(residual @ residual) for _, residual, _ in ends)
    # a band of f Hz holds 2 f independent samples a second
    noise_scale = np.sqrt(max(cost / rows, TINY) * PER_CUTOFF / 2)
    jacobian = ends[1][2]
    spread = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    deviation = spread * noise_scale
    # a spread near WIDTH is the prior's: the data say nothing of that zero
    known = (spread < KNOWN * WIDTH) & (found.active_mask == 0)
    # where a slide's zero lies shows in the levers alone
    known &= ~np.array(columns.arm.sliding) & bool(found.success)
    size = np.abs(found.x)
    certain = known & (size > LEAST) & (size > CERTAIN * deviation)
    better = cost < (1 - SLIGHT) ** 2 * without or with_offsets < impossible
    asked = np.flatnonzero(certain & better)
    return JointZeros(found.x, deviation, known, asked)


def _reduced(
    samples: Samples, choice: Choice, weight: np.ndarray, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Regularised least squares at some offsets, x eliminated by the triangular factor of [W, S, y].

    Returns:
        The best x, (p,); the residual at unit noise in n + 1 orthonormal directions, whose square is the cost,
        penalties included; and its derivative by the offsets, (n + 1, n).
    """
    columns, law, p, n = samples.columns, choice.law, len(weight), len(offset)
    nominal, body = columns.nominal(law), columns.body
    true = [replace(s.motion, q=s.motion.q - offset) for s in samples.segments]

    def stacked(part: Callable[[Segment, Motion], np.ndarray]) -> np.ndarray:
        """Columns of each segment, (N, n, k), in the band, thinned, at unit noise, one row for each joint; (M n, k)."""
        rows = samples.rows(map(part, samples.segments, true)) / choice.noise[:, None]
        return rows.reshape(-1, rows.shape[2])

    def equations(segment: Segment, motion: Motion) -> np.ndarray:
        known = replace(segment, motion=motion).known_torque(body)
        torque = segment.torque - known
        # dry friction sees speeds and distances alone, which a zero does not change
        dry = columns.dry(segment.motion, law)
        parts = [columns.smooth(motion), dry, torque[:, :, None]]
        return np.concatenate(parts, axis=2)

    whole = stacked(equations)
    # 1: the weights hold the number of rows already
    value = pulled_solution(whole.T @ whole, 1, weight, nominal)
    change = (value[: columns.links] - body.inertial_parameters()).reshape(-1, 10)

    def slopes(segment: Segment, motion: Motion) -> np.ndarray:
        """S = -d tau / d q with the bodies as they are identified now."""
        bodies = segment.bodies(body).changed(change)
        # the true q falls as the offset grows, hence the sign
        return -bodies.sensitivities(motion.q, motion.dq, motion.ddq)[0]

    whole = np.hstack([whole[:, :-1], stacked(slopes), whole[:, -1:]])
    gram = whole.T @ whole
    # penalties are further rows: sqrt(w) (x - x0), and (delta + step) / WIDTH
    pull = np.concatenate([np.sqrt(weight), np.full(n, 1 / WIDTH)])
    target = np.concatenate([nominal, -offset])
    penalties = np.column_stack([np.diag(pull), pull * target])
    gram += penalties.T @ penalties
    # rows below those of x hold what x cannot explain: [S, y] in n + 1 directions
    # of upper triangular R with R^T R the Gram matrix, of columns that differ by orders of magnitude
    unit = np.sqrt(np.maximum(np.diag(gram), TINY))
    scaled = gram / unit[:, None] / unit
    # a little weight keeps the factor real where columns depend on each other to rounding
    rest = (cholesky(scaled + 1e-13 * np.eye(len(gram))) * unit)[p:, p:]
    return value, rest[:, -1], -rest[:, :-1]


# Identification: parameters fitted to recordings, what they are worth, and what makes them doubtful.


FILTERS = ("recursive", "unscented")
"""What follows the parameters over time; the recursive filter always does."""


@dataclass(frozen=True)
class IdentificationSettings:
    """How to identify.

    Attributes:
        cutoff: of both sides [Hz]; chosen from the spectra of the positions if ``None``.
        estimator: one of ``gapscope.ident.estimators.by_name.METHODS``.
        judge: names of recordings to hold out; if empty those that the case holds out, else the last one.
        any_torque: continue if the torque shows that the case reads its log wrongly, or says another gravity.
        trim: leave out both ends of a segment, where the filter settles.
        filter: ``recursive``, or ``unscented`` to follow states and friction together as well.
        plain: only what URDF, data sheet and effects can express: no friction that keeps its direction at rest.
        ridge: strength of the estimator ``ridge`` [1], chosen by held-out motions if ``None``.
        singular_values: how many ``truncated_svd`` keeps, likewise.
        keep: parameters that ``consistent`` leaves at the nominal arm's, by name; ``link5`` for all ten of a link.
    """

    cutoff: float | None = None
    estimator: str = "consistent"
    judge: tuple[str, ...] = ()
    any_torque: bool = False
    trim: bool = True
    filter: str = "recursive"
    plain: bool = False
    ridge: float | None = None
    singular_values: int | None = None
    keep: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check that what is asked for belongs to the estimator."""
        belongs = {
            "ridge": (self.ridge is not None, "ridge"),
            "singular-values": (self.singular_values is not None, "truncated_svd"),
            "keep": (bool(self.keep), "consistent"),
        }
        for option, (given, estimator) in belongs.items():
            if given and self.estimator != estimator:
                raise InputError(
                    f"belongs to the estimator {estimator}, not {self.estimator}",
                    f"leave it out, or --estimator {estimator}",
                    where=f"--{option}",
                )


@dataclass(frozen=True)
class FittedParameters:
    """Parameters fitted to the recordings of a case, p of the model and b of its base.

    Attributes:
        case: the case.
        settings: with the cut-off that was used.
        fit, held_out: recordings that were fitted, and others.
        samples: those of the fit, in the band.
        choice: friction law, pull and noise.
        matrix: W in the band, shape (M, n, p).
        base: base parameters of the samples.
        problem: in the base columns.
        estimator: that solved it.
        estimate: of the base parameters.
        uncertainty: of the base parameters, as belongs to the estimator.
        penalty: of the pull to the nominal arm, shape (p,).
        physical: consistent parameters.
    """

    case: Case
    settings: IdentificationSettings
    fit: Sequence[Recording]
    held_out: Sequence[Recording]
    samples: Samples
    choice: Choice
    matrix: np.ndarray
    base: BaseParameters
    problem: Problem
    estimator: Estimator
    estimate: Estimate
    uncertainty: Uncertainty
    penalty: np.ndarray
    physical: Physical

    @property
    def columns(self) -> ModelColumns:
        """The model tau = W x."""
        return self.samples.columns

    @property
    def fitted_torque(self) -> np.ndarray:
        """Torque by the estimate in the band [N m], shape (M, n)."""
        return self.matrix[:, :, self.base.kept] @ self.estimate.value

    @property
    def measured(self) -> list[Recording]:
        """Recordings that were fitted, those without torque left out."""
        return [r for r in self.fit if r.tau is not None]


def fit_parameters(
    case: Case,
    settings: IdentificationSettings,
    progress: Callable[[str], None] = lambda message: None,
) -> FittedParameters:
    """Fit the parameters of an arm to the recordings of a case.

    Raises:
        InputError: the recordings or the settings cannot be used.
        GapscopeError: no physically consistent parameters were found.
    """
    chosen = method(settings.estimator)
    check_known("filter", settings.filter, FILTERS, where="--filter")
    fit, held_out = split(case, settings.judge)
    check_recordings(fit, held_out, case)
    if settings.filter == "unscented":
        # followed at the end, over the first recording with torque
        check_followed(case.arm, next(r for r in fit if r.tau is not None))
    # one cut-off for all recordings, so that their equations are comparable
    cutoff = settings.cutoff
    if cutoff is None:
        cutoff = position_cutoff(tuple(fit))
        settings = replace(settings, cutoff=cutoff)
    columns = ModelColumns(case.arm)
    samples = Samples(columns, fit, cutoff, settings.trim)
    # whether the samples suffice is known with the simplest friction law
    simplest = _sample_base(samples.matrix(FrictionLaw()), columns, FrictionLaw())
    seconds = samples.interval.sum()
    per_second = columns.arm.n_joints * band_samples(1.0, cutoff)
    # what is missing, said as a time to record
    needed = PER_PARAMETER * simplest.count / per_second
    if seconds < needed:
        raise InputError(
            f"{seconds:.2g} s in a band of {cutoff:g} Hz hold {seconds * per_second:.0f} independent samples, too "
            f"few for {simplest.count} base parameters",
            f"record for at least {np.ceil(needed + 1):.0f} s, ten times that for good measure, or raise --cutoff",
            file=fit[0].name,
        )
    progress("chooses the form of the friction")
    # what simulates an arm knows Coulomb and viscous friction alone
    rich = settings.estimator not in SIMULATING
    choice = choose(samples, nonlinear=rich, presliding=rich and not settings.plain)
    matrix = samples.matrix(choice.law)
    # what these samples do not excite has no base column
    base = _sample_base(matrix, columns, choice.law)
    progress(f"estimates {base.count} base parameters")
    problem = samples.problem(choice.law, base.kept, base.kept_names)
    problem = replace(problem, forms=form_columns(samples))
    nominal = columns.nominal(choice.law)
    given = Given(
        base,
        nominal,
        # built only if an estimator simulates: it may refuse the controller
        lambda: closed_loop(case, fit, samples, base, problem),
        settings.ridge,
        settings.singular_values,
    )
    estimator = chosen.make(given)
    estimate = estimator(problem)
    uncertainty = chosen.interval(problem, estimator, estimate)
    progress("recovers physical parameters")
    # the pull is on all x, the base columns alone would not feel it
    unit_noise = matrix / choice.noise[:, None]
    squares = (unit_noise**2).sum(axis=(0, 1))
    penalty = choice.pull * penalties(samples, choice.law, squares)
    kept = _places(settings.keep, columns.names(choice.law), columns.arm.n_joints)
    # stiffer than all samples together
    held = penalty[kept] + squares[kept] / samples.torque.size
    penalty[kept] = held / ROUNDING
    # bodies are near if their torque is, not their parameters
    flat = unit_noise[:, :, base.kept].reshape(-1, base.count)
    physical = consistent(
        base,
        estimate.value,
        flat.T @ flat,
        nominal,
        samples.torque.size * penalty,
    )
    return FittedParameters(
        case=case,
        settings=settings,
        fit=fit,
        held_out=held_out,
        samples=samples,
        choice=choice,
        matrix=matrix,
        base=base,
        problem=problem,
        estimator=estimator,
        estimate=estimate,
        uncertainty=uncertainty,
        penalty=penalty,
        physical=physical,
    )


def _places(keep: Sequence[str], names: Sequence[str], n_joints: int) -> list[int]:
    """Places of parameters by name, ``link5`` for the ten of a link.

    Raises:
        InputError: there is no such parameter.
    """
    links = {f"link{j + 1}": range(10 * j, 10 * j + 10) for j in range(n_joints)}
    known = {name: range(k, k + 1) for k, name in enumerate(names)} | links
    for name in keep:
        check_known("parameter", name, known, where="--keep")
    return [place for name in keep for place in known[name]]


def _sample_base(
    matrix: np.ndarray, columns: ModelColumns, law: FrictionLaw
) -> BaseParameters:
    """Base parameters that the samples of a regressor, shape (M, n, p), excite."""
    return base_parameters(matrix.reshape(-1, matrix.shape[2]), columns.names(law))


# Which parameters of an arm a motion determines: rank, condition, spectrum.


@dataclass(frozen=True)
class Identifiability:
    """What samples determine of p parameters pi of an arm with b base parameters, as the JSON document has it.

    Attributes:
        structural: b.
        rank: how many base parameters, or combinations of them, the samples determine.
        condition: condition number of the base columns, scaled to unit norm [1].
        condition_limit: above which it is doubtful [1].
        singular_values: of the unit base columns over their largest, shape (b,), falling.
        weakest: the base parameters that make up the worst determined combination, largest share first.
        column_norms: RMS torque of each parameter per unit of it [N m per unit], by name.
    """

    structural: int
    rank: int
    condition: float
    condition_limit: float
    singular_values: np.ndarray
    weakest: tuple[str, ...]
    column_norms: dict[str, float]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes results doubtful, a sentence with a remedy, or none."""
        weakest = ", ".join(self.weakest)
        # a parameter that is not seen at all matters more than a weak one
        if self.rank < self.structural:
            return (
                f"the samples determine only {self.rank} of {self.structural} base parameters, not {weakest}; "
                "record a motion that moves every joint, up to higher speed and acceleration",
            )
        if self.condition > self.condition_limit:
            return (
                f"condition number {self.condition:.3g} with unit columns is above {self.condition_limit:g}: "
                f"{weakest} cannot be separated; record an optimised exciting motion, or drop what is not essential",
            )
        return ()


def identifiability(samples: np.ndarray, base: BaseParameters) -> Identifiability:
    """What samples determine of the parameters of an arm.

    Args:
        samples: regressor of all p parameters, shape (M, p) or (N, n, p).
        base: base parameters of the arm (``structural_base``), which separate what the arm cannot show from what the
            motion does not show.

    Raises:
        InputError: values that are not finite, too few rows, or no motion at all.

    Source: gautier1992.
    """
    scaled, norms = unit_triangle(samples, base.names)
    unit = scaled[:, base.kept]
    # the last right vector: least torque for a change of unit size
    values, right = np.linalg.svd(unit)[1:]
    relative = values / values[0]
    # the parameters that make up the direction that the samples show least
    last, names = np.abs(right[-1]), base.kept_names
    order = np.argsort(-last).tolist()
    # columns without content are zero, and have the norm 1
    seen = scaled.any(axis=0) * norms / np.sqrt(samples.size / len(norms))
    return Identifiability(
        structural=base.count,
        rank=rank_by_gap(relative),
        condition=float(np.linalg.cond(unit)),
        condition_limit=CONDITION_LIMIT,
        singular_values=relative,
        weakest=tuple(names[k] for k in order if last[k] > last.max() / 2),
        column_norms=dict(zip(base.names, seen.tolist(), strict=True)),
    )


# Validation: how well the identified model predicts recordings, per joint, and whether the residual is noise.


Predict = Callable[[Segment], np.ndarray]


@dataclass(frozen=True)
class Errors:
    """Errors of predicted torque on some samples, n joints.

    Attributes:
        rmse: [N m], shape (n,).
        relative: RMS residual over RMS torque [1], shape (n,); NaN if there is no sample.
        largest: [N m], shape (n,).
        overall: RMS residual over RMS torque of all joints together [1].
        share: of the samples that count, per joint [1], shape (n,).
    """

    rmse: np.ndarray
    relative: np.ndarray
    largest: np.ndarray
    overall: float
    share: np.ndarray


@dataclass(frozen=True)
class Validation:
    """Prediction against a group of recordings.

    Attributes:
        recordings: their names.
        role: ``fit`` or ``judge``.
        every: errors on every sample whose torque was measured.
        moving: errors while the joint is faster than ``MOVING``.
        nominal: errors of the nominal arm on every sample.
        whiteness: of the residual.
        t: time, of the segments one after the other [s], shape (M,).
        torque, predicted, before: recorded, predicted and the nominal arm's torque in the band [N m], (M, n).
        velocity: dq [rad/s], (M, n).
        edges: rows at which segments begin, and the end.
    """

    recordings: tuple[str, ...]
    role: str
    every: Errors
    moving: Errors
    nominal: Errors
    whiteness: Whiteness
    t: np.ndarray
    torque: np.ndarray
    predicted: np.ndarray
    before: np.ndarray
    velocity: np.ndarray
    edges: tuple[int, ...]


def validate(
    role: str,
    samples: DecimatedSegments,
    predict: Predict,
    nominal: Predict,
) -> Validation:
    """Compare predictions with recorded torque, both in one band.

    Args:
        role: ``fit`` or ``judge``.
        samples: segments with torque, and their band.
        predict: the identified model, segment to torque [N m], (N, n).
        nominal: the nominal arm, likewise.
    """
    parts = []
    for segment in samples.segments:
        rows = samples.inner(segment)
        motion = segment.motion
        sides = (np.asarray(segment.torque), predict(segment), nominal(segment))
        filtered = (samples.filtered(side, segment) for side in sides)
        known = motion.t[rows], motion.dq[rows], segment.measured[rows]
        parts.append((*known, *filtered))
    t, dq, every, torque, after, before = map(np.concatenate, zip(*parts, strict=True))
    lengths = [len(part[0]) for part in parts]
    group = np.repeat(np.arange(len(parts)), lengths)
    rate = np.repeat([segment.motion.rate for segment in samples.segments], lengths)
    # a torque that was not measured leaves nothing
    residual = np.where(every, torque - after, 0.0)
    return Validation(
        recordings=tuple(dict.fromkeys(s.recording for s in samples.segments)),
        role=role,
        every=errors(torque, after, every),
        moving=errors(torque, after, every & (np.abs(dq) > MOVING)),
        nominal=errors(torque, before, every),
        whiteness=whiteness(residual, group, rate, samples.cutoff),
        t=t,
        torque=torque,
        predicted=after,
        before=before,
        velocity=dq,
        edges=tuple(np.cumsum([0, *lengths]).tolist()),
    )


def errors(torque: np.ndarray, predicted: np.ndarray, counted: np.ndarray) -> Errors:
    """Errors [N m] on the samples that count; torque, prediction and mask of shape (N, n)."""
    residual, known = (np.where(counted, x, 0.0) for x in (torque - predicted, torque))
    count = counted.sum(axis=0)
    squares, power = (residual**2).sum(axis=0), (known**2).sum(axis=0)
    # a joint without samples has no relative error
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(count > 0, np.sqrt(squares / power), np.nan)
        overall = float(np.sqrt(squares.sum() / power.sum()))
    return Errors(
        rmse=np.sqrt(squares / np.maximum(count, 1)),
        relative=relative,
        largest=np.abs(residual).max(axis=0),
        overall=overall,
        share=count / len(torque),
    )


# The pipeline: parameters that were fitted, and what they are worth.


@dataclass(frozen=True)
class Identification(FittedParameters):
    """Parameters that were fitted, and what they are worth.

    Attributes:
        determined: rank, condition and spectrum of the samples, against the base parameters of the arm's structure.
        essential: base parameters that explain the fitted torque; ``None`` if samples do not suffice.
        groups: segments identified one by one; ``None`` if one does not determine the parameters.
        interval: of predicted torque; ``None`` if the others do not determine the parameters when one is held out.
        counted: how many independent samples there are.
        reasons: why something is ``None``, each a sentence.
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

    determined: Identifiability
    essential: EssentialParameters | None
    groups: GroupComparison | None
    interval: TorqueInterval | None
    counted: SampleCount
    reasons: tuple[str, ...]
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
        by_filter = self.settings.estimator == "kalman"
        batch = None if by_filter else self.estimate.value
        return review(self.samples, self.problem, batch, self.changes)

    @property
    def moved(self) -> np.ndarray | None:
        """Which base parameters a partial update moved, the others stay nominal, (b,); ``None`` of other estimators."""
        if self.settings.estimator != "partial_update":
            return None
        nominal = self.columns.nominal(self.choice.law)
        return self.estimate.value != self.base.of(nominal)

    def predict(self, motion: Motion) -> np.ndarray:
        """Torque that would be recorded on a motion without payload [N m], shape (N, n)."""
        return self.columns.matrix(motion, self.choice.law) @ self.value


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
    columns, base, problem = samples.columns, fitted.base, fitted.problem
    law, cutoff = fitted.choice.law, samples.cutoff
    progress("looks at the joints' zeros")
    zeros = estimate_zeros(samples, fitted.choice, fitted.penalty)
    progress("examines what the recordings determine")
    determined = identifiability(fitted.matrix, _structural(fitted))
    # part of the samples cannot be simulated: what they determine is asked of least squares then
    simulates = settings.estimator in SIMULATING
    estimator = weighted_least_squares if simulates else fitted.estimator
    reasons = []
    # a part that fails leaves a sentence; the others are still worth having
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
            problem, estimator, fitted.uncertainty, low_cutoff, fitted.estimate
        )
    except (InputError, np.linalg.LinAlgError):
        reasons.append(
            "without one of its segments the rest does not determine the parameters; record more motions"
        )
    counted = count_samples(samples, base.count)
    value = fitted.physical.value
    # others give base parameters alone; what the motion did not excite stays nominal
    if settings.estimator != "consistent":
        value = base.nearest(fitted.estimate.value, columns.nominal(law))
    progress("validates")
    # what was held out goes through the same band as what was fitted
    held_out = samples.of(fitted.held_out)
    validation = (
        validated(fitted, value, "fit", samples),
        validated(fitted, value, "judge", held_out),
    )
    predicted = None
    if interval is not None:
        # about what the model predicts on segments that were not fitted
        unseen = held_out.problem(law, base.kept, base.kept_names)
        predicted = predicted_torque(interval, unseen, base.of(value))
    table = tuple(troubleshooting(fitted, zeros))
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
    # what makes the result doubtful; what concerns all of it first, and how the model predicts before that
    fit, judged = validation
    doubts = []
    # p parameters from n samples predict others with p / n of the noise's square more than the noise itself, even
    # if the nominal arm is exact; that share is itself uncertain by as much; the noise is what the fit leaves
    ours, nominal, noise2 = (
        (own.rmse**2).sum() for own in (judged.every, judged.nominal, fit.every)
    )
    if ours > nominal + 2.0 / counted.per_parameter * noise2:
        doubts.append(
            f"{WORSE}: {judged.every.overall:.1%} of the torque against {judged.nominal.overall:.1%}; use the "
            "nominal arm, record an exciting trajectory (`gapscope excite`), or stay nearer to it: --estimator ridge, "
            "truncated_svd or partial_update, --keep"
        )
    for entry in change_findings(changes):
        doubts.append(
            f"{change_text(entry)}; cut the recording there, and name a known load in payloads:"
        )
    doubts += [*fitted.estimate.warnings, *determined.warnings]
    warned = () if interval is None else interval.warnings()
    doubts += counted.warnings(model_error=bool(warned))
    doubts += warned
    if interval is None:
        doubts.append(
            f"the recordings cannot be checked for model error: {reasons[-1]}"
        )
    still = _still_joints(fitted)
    if len(still):
        doubts.append(
            f"joint {_numbers(still + 1)} rests in every fitted recording: its own parameters are not identifiable"
        )
    wrong = inconsistent(fitted.physical.before)
    rows = [row for row in table if row.verdict == FOUND]
    # noise alone takes parameters that the data hardly determine out of what bodies can have
    certain = any(row.key == BODIES for row in rows)
    if wrong and (certain or len(zeros.asked)):
        negative = _numbers(c.link for c in wrong if not c.positive_mass)
        masses = f"; link {negative} even of negative mass" if negative else ""
        doubts.append(
            f"the parameters nearest to the nominal arm that fit best are those of no body on link "
            f"{_numbers(c.link for c in wrong)}{masses}: the consistent ones are used instead"
        )
    for row in rows:
        if row.key not in SAID_OTHERWISE:
            where = f" on joint {_numbers(row.joints)}" if row.joints else ""
            doubts.append(f"{row.cause}{where}: {row.remedy}")
    return Identification(
        **vars(fitted),
        determined=determined,
        essential=essential,
        groups=groups,
        interval=interval,
        counted=counted,
        reasons=tuple(reasons),
        changes=changes,
        states=states,
        predicted=predicted,
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
        warnings=(*case.warnings, *case.notes, *doubts),
    )


def _structural(fitted: FittedParameters) -> BaseParameters:
    """Base parameters of the arm, whatever its recordings excite."""
    columns = fitted.columns
    states = random_states(columns.regressor, np.random.default_rng(0), STATES)
    # the states do not follow from one another, so that no direction can be kept from one to the next
    law = replace(fitted.choice.law, presliding=None)
    return base_parameters(columns.matrix(states, law), columns.names(law))


def _essential(fitted: FittedParameters) -> EssentialParameters:
    """Essential parameters of the equations weighted by joint; variances allow for autocorrelation."""
    problem, noise = fitted.problem, fitted.choice.noise
    residual = problem.residual(fitted.estimate.value) / noise
    factor = Factor.of(*whitened(problem, noise))
    inflation = float(variance_inflation(residual, problem.group).mean())
    return essential_parameters(factor, problem.names, inflation)


def validated(
    fitted: FittedParameters,
    value: np.ndarray,
    role: str,
    samples: Samples,
) -> Validation:
    """Predictions of x = ``value``, (p,), and of the nominal arm on samples; ``role`` names them."""
    columns, law = fitted.columns, fitted.choice.law

    def predict(x: np.ndarray, segment: Segment) -> np.ndarray:
        load = segment.known_torque(columns.body)
        return columns.matrix(segment.motion, law) @ x + load

    both = partial(predict, value), partial(predict, columns.nominal(law))
    return validate(role, samples, *both)


# The troubleshooting table: symptom, cause, check, remedy, filled in from the data.


FOUND, CLEAR = "found", "clear"
WORSE = "what was held out is predicted worse than by the nominal arm"
"""How the warning begins that comes before all others."""
BODIES = "unphysical"
"""Row of the table that says whether parameters of no body are certain."""
SAID_OTHERWISE = ("low_speed_friction", "resting_joint", "condition", BODIES)
"""Rows of the table that need no warning, or have a fuller one."""


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


def troubleshooting(fitted: FittedParameters, zeros: JointZeros) -> Iterator[Row]:
    """The rows of the table for one identification, in the order in which to look at them."""
    asked = zeros.asked
    known = np.where(zeros.known, np.abs(zeros.offset), 0.0)
    # an offset that nobody is asked about stays below the threshold
    worst = min(known.max(), np.deg2rad(0.999))
    yield _row(
        "joint_zero",
        np.rad2deg(known[asked].max() if len(asked) else worst),
        1.0,
        "deg",
        # found by what must be asked about, whatever the number beside it says
        joints=(asked + 1).tolist(),
        symptom="negative masses, inertias that no body has",
        cause="zero of an encoder off",
        check="offset estimated together with the parameters, if it is certain and lowers the cost",
        remedy="calibrate the zero, or set import: {offsets: [...]}",
    )
    change = fitted.base.of(fitted.physical.value) - fitted.estimate.value
    # chance alone makes the mean of these squares about one
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
    # the number is of all links together: the estimate says which are impossible
    if impossible.verdict == FOUND:
        wrong = inconsistent(fitted.physical.before)
        impossible = replace(impossible, joints=tuple(check.link for check in wrong))
    yield impossible
    yield _row(
        "low_speed_friction",
        fitted.choice.stribeck_gain,
        0.05,
        symptom="residual peaks where a joint reverses",
        cause="low-speed friction other than Coulomb plus viscous: falls as the joint moves off, "
        "or rises less than linearly",
        check="share by which a Stribeck term lowers the error on held-out stretches",
        remedy="none needed, the term is part of the model then; record slow reversals to determine it",
    )
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
    noise, lost = _spectral(fitted.fit, fitted.samples.cutoff)
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
    # a lag that is not certain counts as none, however large
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
    limit, at_limit = fitted.case.arm.torque_limit, []
    for recording in fitted.measured:
        tau = np.asarray(recording.tau)
        # in any case if it stands at its largest or smallest value for longer than its values usually last
        clipped = held_torque(recording.t, recording.q, tau).clipped
        if limit is not None:
            clipped = clipped | (np.abs(tau) >= AT_LIMIT * limit)
        at_limit.append(clipped)
    yield _row(
        "saturated_torque",
        np.concatenate(at_limit).mean(axis=0),
        0.005,
        symptom="inertia and friction too small, flat tops",
        cause="torque at the drive's limit",
        check="share of samples at the limit, or held exactly at the extreme",
        remedy="move more slowly, or leave these stretches out",
    )


def _time_offset(fit: FittedParameters) -> tuple[np.ndarray, np.ndarray]:
    """How far the recorded torque lags behind the motion, and its standard deviation [s], each (n,).

    tau(t - T) = tau - T d tau / dt: the derivative of the fitted torque of each joint is a further column. If a
    joint hardly moves, its friction jumps or takes any value as at rest, which resembles an offset: these samples do
    not count.
    """
    samples, base, fitted = fit.samples, fit.base, fit.fitted_torque
    n, moving = fitted.shape[1], np.abs(samples.velocity) > MOVING
    weight = moving / fit.choice.noise
    residual = (samples.torque - fitted) * weight
    # of the fitted torque, whose derivative has no noise; never across a gap
    rate = np.concatenate(
        [
            np.gradient(fitted[rows], samples.interval[rows.start], axis=0)
            for rows in group_slices(samples.group)
        ]
    )
    # a joint's lag moves its own torque alone: one column each
    late = -rate[:, :, None] * np.eye(n)
    columns = np.concatenate([fit.matrix[:, :, base.kept], late], axis=2)
    flat = (columns * weight[:, :, None]).reshape(residual.size, -1)
    # seconds and kilograms differ by orders of magnitude
    unit = column_norms(flat)
    factor = Factor.of(flat / unit, residual.ravel())
    # columns that depend on each other to rounding share, instead of growing
    inverse = np.linalg.pinv(factor.triangle, rcond=1e-9)
    solution, spread = inverse @ factor.rotated, np.linalg.norm(inverse, axis=1)
    # samples at rest have no weight: they do not count in the mean of the squares either
    counted = np.maximum(moving.mean(axis=0), 1 / len(moving))
    variance = (residual**2).mean(axis=0) / counted
    scale = np.sqrt(variance * variance_inflation(residual, samples.group))
    return solution[-n:] / unit[-n:], spread[-n:] / unit[-n:] * scale


def _still_joints(fitted: FittedParameters) -> np.ndarray:
    """Joints, from 0, that rest in every fitted recording."""
    arm = fitted.samples.columns.arm
    return np.flatnonzero(resting(fitted.measured, arm.per_radian))


def _spectral(
    recordings: Sequence[Recording], cutoff: float
) -> tuple[np.ndarray, np.ndarray]:
    """RMS of the noise in ddq over that of ddq below a cut-off [Hz], and share of the power of dq beyond it; each (n,).

    The noise density of q is the median one in the upper half of the band; differentiating twice multiplies it by
    (2 pi f)^4. Only power that exceeds it counts beyond the cut-off.
    """
    powers = np.zeros((4, recordings[0].n_joints))
    for recording in recordings:
        rate = recording.rate
        _, q = uniform(recording.t, recording.q, rate)
        # a motion that does not end where it began would leak over the whole spectrum
        drift = np.linspace(0, 1, len(q))[:, None] * (q[-1] - q[0])
        # four seconds at most: stretches to average, and fine enough for slow motion
        length = min(len(q), int(4 * rate))
        frequency, density = welch(
            q - drift, rate, nperseg=length, axis=0, detrend="linear"
        )
        # the median: a resonance or hum in the upper half is no floor
        floor = np.median(density[frequency > rate / 4], axis=0)
        # d/dt multiplies the density by (2 pi f)^2; the bin width turns it into power
        derivative = (2 * np.pi * frequency[:, None]) ** 2
        velocity_power = derivative * (frequency[1] - frequency[0])
        acceleration_power = velocity_power**2
        inside = frequency <= cutoff
        # the floor itself scatters; only what stands well above it is motion
        above_floor = np.where(density > 10 * floor, density - floor, 0.0)
        parts = (
            (acceleration_power * floor)[inside],
            (acceleration_power * density)[inside],
            (velocity_power * above_floor)[~inside],
            (velocity_power * density)[inside],
        )
        powers += [part.sum(axis=0) for part in parts]
    noise, acceleration, lost, speed = powers
    noise_share = np.sqrt(noise / np.maximum(acceleration, TINY))
    return noise_share, lost / np.maximum(speed + lost, TINY)


def _numbers(values: Iterable[int]) -> str:
    return ", ".join(map(str, values))
