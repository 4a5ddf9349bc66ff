"""What recordings determine of the parameters, and how far the model may be off: the findings beside the estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.ident.checks.fit_evidence import FitEvidence
from gapscope.ident.estimators.estimate import Estimate, Estimator
from gapscope.ident.model.base_parameters import (
    BaseParameters,
    base_parameters,
    random_states,
)
from gapscope.ident.model.essential import EssentialParameters, essential_parameters
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.model.tsqr import TriangularFactor
from gapscope.ident.signals.sample_count import SampleCount, count_samples
from gapscope.ident.uncertainty.identifiability import (
    CONDITION_LIMIT,
    Identifiability,
    identifiability,
)
from gapscope.ident.uncertainty.intervals import Uncertainty
from gapscope.ident.uncertainty.repeated_groups import GroupComparison, compare_groups
from gapscope.ident.uncertainty.torque_interval import TorqueInterval, torque_interval
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.effective_samples import group_slices, variance_inflation

HELD_OUT = 4
"""Stretches of time, at least, that are predicted one at a time from the others."""


@dataclass(frozen=True)
class Examination:
    """What recordings determine of the parameters.

    Attributes:
        shown: rank, condition and spectrum of the samples, against the base parameters of the arm's structure.
        essential: base parameters that explain the fitted torque; ``None`` if samples do not suffice.
        groups: segments identified one by one; ``None`` if one does not determine the parameters.
        interval: of predicted torque; ``None`` if the others do not determine the parameters when one is held out.
        counted: how many independent samples there are.
        reasons: why something is ``None``, each a sentence.
    """

    shown: Identifiability
    essential: EssentialParameters | None
    groups: GroupComparison | None
    interval: TorqueInterval | None
    counted: SampleCount
    reasons: tuple[str, ...]

    def warnings(self) -> tuple[str, ...]:
        """What makes the result doubtful, each with a remedy."""
        found: list[str] = []
        shown = self.shown
        if shown.rank < shown.base.count or shown.condition > CONDITION_LIMIT:
            found += shown.warnings[:1]
        model_error = self.interval is not None and bool(self.interval.warnings)
        found += self.counted.warnings(model_error=model_error)
        if self.interval is not None:
            found += self.interval.warnings
        elif self.reasons:
            last = self.reasons[-1]
            found.append(f"the recordings cannot be checked for model error: {last}")
        return tuple(found)


def examine(
    evidence: FitEvidence,
    problem: Problem,
    estimator: Estimator,
    estimate: Estimate,
    uncertainty: Uncertainty,
) -> Examination:
    """Examine what was fitted.

    Args:
        evidence: the fit.
        problem: in base columns, that was solved.
        estimator: that solved it.
        estimate: its result.
        uncertainty: of that.
    """
    samples, law = evidence.samples, evidence.choice.law
    cutoff = samples.band.cutoff
    shown = identifiability(evidence.matrix, structural(samples.columns, law))
    reasons: list[str] = []
    essential, groups, interval = None, None, None
    try:
        essential = _essential(evidence, problem)
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
            _cut(problem), estimator, uncertainty, low_cutoff, estimate
        )
    except (InputError, np.linalg.LinAlgError):
        reasons.append(
            "without one of its segments the rest does not determine the parameters; record more motions"
        )
    counted = count_samples(samples, evidence.base.count)
    return Examination(
        shown=shown,
        essential=essential,
        groups=groups,
        interval=interval,
        counted=counted,
        reasons=tuple(reasons),
    )


def _cut(problem: Problem) -> Problem:
    """The problem with its groups cut into equal parts, at least ``HELD_OUT`` in all."""
    spans = group_slices(problem.group)
    pieces = -(-HELD_OUT // len(spans))  # rounded up
    starts: list[int] = []
    for span in spans:
        edges = np.linspace(span.start, span.stop, pieces + 1).astype(int)
        starts += edges[:-1].tolist()
    lengths = np.diff([*starts, len(problem.group)])
    return replace(problem, group=np.repeat(np.arange(len(lengths)), lengths))


def structural(columns: ModelColumns, law: FrictionLaw) -> BaseParameters:
    """Base parameters of the arm, whatever its recordings excite."""
    states = random_states(columns.regressor, np.random.default_rng(0), 300)
    # the states do not follow from one another, so that no direction can be kept from one to the next
    law = replace(law, presliding=None)
    return base_parameters(columns.matrix(states, law), columns.names(law))


def _essential(evidence: FitEvidence, problem: Problem) -> EssentialParameters:
    """Essential parameters of the equations weighted by joint; variances allow for autocorrelation."""
    noise = evidence.choice.noise
    residual = problem.residual(evidence.beta) / noise
    factor = TriangularFactor(evidence.base.count)
    factor.add(problem.matrix / noise[:, None], problem.torque / noise)
    inflation = float(variance_inflation(residual, problem.group).mean())
    return essential_parameters(factor, problem.names, inflation=inflation)
