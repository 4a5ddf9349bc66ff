"""Do these recordings agree? For each parameter: agrees or differs, with what, and which value to trust."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.agreement.covariates import (
    Covariate,
    Explanation,
    covariates,
    explain,
)
from gapscope.diagnosis.agreement.difference_test import (
    RecordingValues,
    difference,
    information_ratio,
    recording_values,
)
from gapscope.diagnosis.agreement.equations import Equations, equations
from gapscope.diagnosis.agreement.hypotheses import Hypothesis, hypotheses
from gapscope.diagnosis.agreement.selection import Selection, select
from gapscope.diagnosis.agreement.stretch_model import StretchModel
from gapscope.diagnosis.fleet.heterogeneity import pooled
from gapscope.ident.checks.plausible_samples import check_recordings

AGREES, DIFFERS, NOT_DETERMINED = "agrees", "differs", "not determined"


@dataclass(frozen=True)
class ParameterAgreement:
    """One parameter in R recordings.

    Attributes:
        quantity: what it is.
        verdict: ``agrees``, ``differs``, or ``not determined`` by two recordings.
        p: of its F-test [1]; ``None`` if it was not tested.
        information: prior variance over the variance that each recording leaves [1], (R,); one that leaves more than
            was known before does not determine the parameter.
        values: in each recording.
        birge: sqrt(Q / (k - 1)) of the k values that are determined [1]; ``None`` if not tested. Source: cochran1954.
        trusted: value and deviation, widened by the Birge ratio if that exceeds 1; ``None`` if there is none to trust.
        covariates: of the recordings, as this parameter sees them.
        explanation: what the difference goes with; ``None`` if there is none.
        alternatives: keys of other quantities that would explain the difference about as well.
    """

    quantity: Hypothesis
    verdict: str
    p: float | None
    information: np.ndarray
    values: RecordingValues
    birge: float | None
    trusted: tuple[float, float] | None
    covariates: tuple[Covariate, ...]
    explanation: Explanation | None
    alternatives: tuple[str, ...]


@dataclass(frozen=True)
class Agreement:
    """The recordings of a case, compared.

    Attributes:
        case: the case.
        recordings: those with torque, (R,).
        labels: their names, told apart by a number if they are parts of one file, (R,).
        parameters: one by one, what differs first.
        level: probability below which one parameter differs [1].
        law: form of the dry friction, in words.
    """

    case: Case
    recordings: tuple[Recording, ...]
    labels: tuple[str, ...]
    parameters: tuple[ParameterAgreement, ...]
    level: float
    law: str

    def having(self, verdict: str) -> tuple[ParameterAgreement, ...]:
        """Parameters of a verdict."""
        return tuple(one for one in self.parameters if one.verdict == verdict)


def agreement(
    case: Case, progress: Callable[[str], None] = lambda message: None
) -> Agreement:
    """Compare the recordings of a case, held-out ones included.

    Raises:
        InputError: fewer than two recordings with torque, none that moves, or one too short.
    """
    every = (*case.recordings, *case.judged)
    check_recordings(every, every, case.name)
    recordings = tuple(r for r in every if r.tau is not None)
    if len(recordings) < 2:
        raise InputError(
            f"only {recordings[0].name} has torque, and one recording agrees with itself",
            "list at least two recordings with tau1..taun under recordings: in the case",
            file=case.name,
        )
    progress("fits each recording alone, and all together")
    of = equations(case, recordings)
    quantities = hypotheses(of)
    shared = StretchModel.shared(of)
    information = {one.key: information_ratio(shared, one) for one in quantities}
    determined = {k: np.flatnonzero(ratio >= 1.0) for k, ratio in information.items()}
    progress(f"compares {len(quantities)} parameters")
    selection = select(of, quantities, determined)
    lines = [
        _line(recordings, of, selection, one, determined[one.key], information[one.key])
        for one in quantities
    ]
    place = {key: number for number, key in enumerate(selection.differences)}
    lines.sort(key=lambda line: place.get(line.quantity.key, len(place)))
    return Agreement(
        case,
        recordings,
        _labels(recordings),
        tuple(lines),
        selection.level,
        str(of.law),
    )


def _labels(recordings: tuple[Recording, ...]) -> tuple[str, ...]:
    count = Counter(recording.name for recording in recordings)
    return tuple(
        r.name if count[r.name] == 1 else f"{r.name} ({number})"
        for number, r in enumerate(recordings, 1)
    )


def _line(
    recordings: tuple[Recording, ...],
    of: Equations,
    selection: Selection,
    one: Hypothesis,
    among: np.ndarray,
    information: np.ndarray,
) -> ParameterAgreement:
    """Verdict on one parameter, all others as the selection has them."""
    found = covariates(recordings, of, one.joint)
    differs = one.key in selection.differences
    if len(among) < 2:
        nothing = np.full((of.count, len(one.directions)), np.nan)
        values = RecordingValues(nothing, nothing[:, 0])
        return ParameterAgreement(
            one, NOT_DETERMINED, None, information, values, None, None, found, None, ()
        )
    others = selection.model.without(one.key)
    test = selection.differences.get(one.key) or difference(others, one, among)
    values = recording_values(others, one, among, test.scatter)
    value, std = values.value[among], values.std[among]
    birge = float(np.sqrt(pooled(value, std, 0.0).q / (len(among) - 1)))
    return ParameterAgreement(
        quantity=one,
        verdict=DIFFERS if differs else AGREES,
        p=test.p,
        information=information,
        values=values,
        birge=birge,
        trusted=None if differs else _weighted_mean(value, std, birge),
        covariates=found,
        explanation=explain(values.value, values.std, among, found)
        if differs
        else None,
        alternatives=selection.alternatives.get(one.key, ()),
    )


def _weighted_mean(
    value: np.ndarray, std: np.ndarray, birge: float
) -> tuple[float, float]:
    """Mean with weights 1 / std^2, and its deviation, widened by the Birge ratio if that exceeds 1."""
    weight = std**-2.0
    mean = float((weight * value).sum() / weight.sum())
    return mean, max(1.0, birge) / float(np.sqrt(weight.sum()))
