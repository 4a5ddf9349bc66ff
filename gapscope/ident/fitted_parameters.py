"""The first half of the pipeline: samples in a band, friction law, base parameters, and those of bodies that can exist.

What needs no more than the parameters themselves, such as the skew of a reference's torque, ends here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.arm.recording import Recording
from gapscope.ident.checks.plausible_samples import (
    check_count,
    check_recordings,
)
from gapscope.ident.estimators.by_name import Given, method
from gapscope.ident.estimators.linear import Estimate, Estimator
from gapscope.ident.estimators.simulating import closed_loop
from gapscope.ident.form_error import form_columns
from gapscope.ident.intervals import Uncertainty
from gapscope.ident.model.base_parameters import BaseParameters, base_parameters
from gapscope.ident.model.friction import Choice, choose, penalties
from gapscope.ident.model.linear_problem import FrictionLaw, ModelColumns, Problem
from gapscope.ident.model.physical_parameters import Physical, consistent
from gapscope.ident.samples import Band, Samples, split
from gapscope.model.conditioning import position_cutoff

FILTERS = ("recursive", "unscented")
"""What follows the parameters over time; the recursive filter always does."""


HELD = 1e6
"""Pull on a parameter that is kept, over the usual one and the squares of its column at unit noise [1]."""


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
        return np.asarray(self.matrix[:, :, self.base.kept] @ self.estimate.value)

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
    if settings.filter not in FILTERS:
        raise InputError(
            f"unknown filter {settings.filter!r}",
            f"use {' or '.join(FILTERS)}",
            where="--filter",
        )
    fit, held_out = split(case, settings.judge)
    check_recordings(fit, held_out, case)
    # one cut-off for all recordings, so that their equations are comparable
    if settings.cutoff is None:
        settings = replace(settings, cutoff=position_cutoff(tuple(fit)))
    samples = _samples(case, fit, settings)
    columns = samples.columns
    progress("chooses the form of the friction")
    rich = not chosen.simulates
    choice = choose(samples, nonlinear=rich, presliding=rich and not settings.plain)
    matrix = samples.matrix(choice.law)
    base = _sample_base(matrix, columns, choice.law)
    progress(f"estimates {base.count} base parameters")
    problem = samples.problem(choice.law, base.kept, base.kept_names)
    problem = replace(problem, forms=form_columns(samples))
    nominal = columns.nominal(choice.law)
    given = Given(
        base,
        nominal,
        lambda: closed_loop(case, fit, samples, base, problem),
        settings.ridge,
        settings.singular_values,
    )
    estimator = chosen.make(given)
    estimate = estimator.estimate(problem)
    uncertainty = chosen.interval(problem, estimator, estimate)
    progress("recovers physical parameters")
    weighted = matrix[:, :, base.kept] / choice.noise[:, None]
    flat = weighted.reshape(-1, base.count)
    penalty = choice.pull * penalties(samples, choice.law, matrix, choice.noise)
    kept = _places(settings.keep, columns.names(choice.law), columns.arm.n_joints)
    # stiffer than all samples together
    pulled = matrix[:, :, kept] / choice.noise[:, None]
    penalty[kept] = HELD * (penalty[kept] + (pulled**2).mean(axis=(0, 1)))
    physical = consistent(
        base,
        estimate.value,
        flat.T @ flat,
        nominal,
        samples.torque.size * penalty,
        columns.arm.n_joints,
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


def _samples(
    case: Case, fit: Sequence[Recording], settings: IdentificationSettings
) -> Samples:
    """Samples of the recordings to fit, enough of them."""
    assert settings.cutoff is not None
    band = Band(settings.cutoff, settings.trim)
    columns = ModelColumns(case.arm)
    segments = band.segments(fit)
    samples = Samples(columns, segments, band.bounded(segments))
    # whether the samples suffice is known with the simplest friction law
    simplest = _sample_base(samples.matrix(FrictionLaw()), columns, FrictionLaw())
    check_count(samples, simplest.count, fit[0].name)
    return samples


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
