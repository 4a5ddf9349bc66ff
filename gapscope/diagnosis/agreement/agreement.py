"""Do these recordings agree? For each parameter: agrees or differs, with what, and which value to trust.

The contrast of the recordings (``gapscope.model``), each a group: what all share is free, and each may have some of its
own. The best set of what recordings have of their own says which parameters differ.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name
from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.agreement.covariates import (
    Covariate,
    Explanation,
    covariates,
    explain,
)
from gapscope.diagnosis.thresholds import NAMED_PROBABILITY, OPEN_ALTERNATIVE
from gapscope.ident.checks.plausible_samples import check_recordings
from gapscope.model.changes import between_recordings
from gapscope.model.contrast import SIZES
from gapscope.model.design import lasts
from gapscope.model.difference import Difference, is_within
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term

AGREES, DIFFERS, NOT_DETERMINED = "agrees", "differs", "not determined"
LOAD = "load"
"""Key of the load on the last link."""
SHORT = {
    "friction": ("c", "Coulomb friction"),
    "damping": ("b", "viscous friction"),
    "offset": ("o", "torque offset"),
    "scale": ("gain", "torque gain"),
}
"""Key and name of an effect of a joint by its quantity; others go by their own name."""
TOLD = 0.05
"""A recording tells a value if its deviation is less than the value, or moves less than this of a joint's torque [1].
(physical)"""


@dataclass(frozen=True)
class Quantity:
    """What may have another value in each recording.

    Attributes:
        key: short name, ``c2``, ``load`` or ``gain2``.
        name: in words.
        unit: of its value.
        joint: from 1; ``None`` if it acts on several.
        term: of which the first coordinate is its value.
    """

    key: str
    name: str
    unit: str
    joint: int | None
    term: Term


@dataclass(frozen=True)
class RecordingValues:
    """A quantity's values in each recording; nan in a recording that does not determine it.

    Attributes:
        value: (R,).
        std: (R,).
        parameters: of the effect, by name, in each recording that has some of its own; but for friction beside those
            that have none.
    """

    value: np.ndarray
    std: np.ndarray
    parameters: tuple[dict[str, np.ndarray], ...]


@dataclass(frozen=True)
class ParameterAgreement:
    """One parameter in R recordings.

    Attributes:
        quantity: what it is.
        verdict: ``agrees``, ``differs``, or ``not determined`` by two recordings.
        p: probability that all recordings have one value [1]; ``None`` if it was not tested.
        information: square of what tells the value over the variance that each recording leaves [1], (R,).
        values: in each recording.
        birge: sqrt(Q / (k - 1)) of the k values that are determined [1]; ``None`` if not tested. Source: cochran1954.
        trusted: value and deviation, widened by the Birge ratio if that exceeds 1; ``None`` if there is none to trust.
        covariates: of the recordings, as this parameter sees them.
        explanation: what the difference goes with; ``None`` if there is none.
        alternatives: keys of other quantities that would explain the difference about as well.
    """

    quantity: Quantity
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
        unknown: joints, from 1, and numbers of the recordings in which something else differs.
        found: what they have of their own, of which all follows; ``None`` if none promises to differ.
    """

    case: Case
    recordings: tuple[Recording, ...]
    labels: tuple[str, ...]
    parameters: tuple[ParameterAgreement, ...]
    unknown: tuple[tuple[int, int], ...]
    found: Difference | None = None

    def having(self, verdict: str) -> tuple[ParameterAgreement, ...]:
        """Parameters of a verdict."""
        return tuple(one for one in self.parameters if one.verdict == verdict)

    def own(self, number: int) -> list[Candidate]:
        """What a recording has of its own, of what differs."""
        differing = {line.quantity.term for line in self.having(DIFFERS)}
        mine = [] if self.found is None else self.found.fit.mine
        return [one for one in mine if one.has(number) and one.term in differing]

    @property
    def states(self) -> list[list[int]]:
        """Numbers of the recordings that share a state; first the state that most time was recorded in to fit."""
        same: dict[frozenset[Candidate], list[int]] = {}
        for number in range(len(self.recordings)):
            same.setdefault(frozenset(self.own(number)), []).append(number)
        fitted = {recording.name for recording in self.case.recordings}

        def recorded(numbers: list[int]) -> float:
            every = (self.recordings[k] for k in numbers)
            return sum(r.duration for r in every if r.name in fitted)

        return sorted(same.values(), key=recorded, reverse=True)


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
    return compared(case, recordings, progress)


def alike(case: Case, recordings: tuple[Recording, ...]) -> Agreement:
    """Recordings of which none promises to differ: no parameter is compared."""
    return Agreement(case, recordings, _labels(recordings), (), ())


def compared(
    case: Case,
    recordings: tuple[Recording, ...],
    progress: Callable[[str], None] = lambda message: None,
    found: Difference | None = None,
) -> Agreement:
    """Compare recordings that have a torque and are long enough, two or more.

    Args:
        case: the case.
        recordings: two or more.
        progress: called with a few words at each step.
        found: what they have of their own, if that is known.
    """
    with threadpool_limits(1):
        if found is None:
            progress("looks for what some recordings have of their own")
            rows = Rows.recorded([[recording] for recording in recordings])
            found = between_recordings(rows, case.arm)
        progress("compares the values")
        lines = _lines(recordings, found)
    unknown = sorted({(j + 1, group) for j, group, _ in found.fit.grown})
    labels = _labels(recordings)
    return Agreement(case, recordings, labels, lines, tuple(unknown), found)


def _labels(recordings: tuple[Recording, ...]) -> tuple[str, ...]:
    count = Counter(recording.name for recording in recordings)
    return tuple(
        r.name if count[r.name] == 1 else f"{r.name} ({number})"
        for number, r in enumerate(recordings, 1)
    )


def quantities(found: Difference) -> tuple[Quantity, ...]:
    """What is compared: all that may change on an arm that stays as it was built, joint by joint, the load last."""
    terms = [
        term
        for term in found.fit.contrast.design.places
        if not (lasts(term) or term.parametrisation.nonlinear)
    ]
    every = [_quantity(term) for term in terms]
    return tuple(sorted(every, key=lambda one: (one.joint is None, one.joint or 0)))


def _quantity(term: Term) -> Quantity:
    unit = term.definition.parameters[0].unit
    if term.is_load:
        return Quantity(LOAD, "load on the last link", unit, None, term)
    plain = term.effect, effect_name(term.effect)
    quantity = "".join(term.definition.quantities.values())
    short, name = SHORT.get(quantity, plain) if term.joint else plain
    if not term.joint:
        return Quantity(short, name, unit, None, term)
    place = "motor" if term.definition.reach == "motor" else "joint"
    name = f"{name} of {place} {term.joint}"
    return Quantity(f"{short}{term.joint}", name, unit, term.joint, term)


def _lines(
    recordings: Sequence[Recording], found: Difference
) -> tuple[ParameterAgreement, ...]:
    """Verdicts on all quantities, what differs first."""
    every = quantities(found)
    keys = {one.term: one.key for one in every}
    lines = [_line(recordings, found, one, keys) for one in every]
    return tuple(sorted(lines, key=lambda line: line.verdict != DIFFERS))


def _line(
    recordings: Sequence[Recording],
    found: Difference,
    one: Quantity,
    keys: Mapping[Term, str],
) -> ParameterAgreement:
    """Verdict on one quantity, all others as the search has them."""
    probability = found.probabilities_of(lambda c: c.term).get(one.term, 0.0)
    differs = probability >= NAMED_PROBABILITY
    values, information = _values(found, one)
    there = covariates(recordings, found.fit.contrast.design.rows, one.joint)
    among = np.flatnonzero(np.isfinite(values.std))
    if len(among) < 2:
        verdict = DIFFERS if differs else NOT_DETERMINED
        return ParameterAgreement(
            one, verdict, None, information, values, None, None, there, None, ()
        )
    value, std = values.value[among], values.std[among]
    trusted, birge = _weighted_mean(value, std)
    others = _alternatives(found, one.term) if differs else ()
    return ParameterAgreement(
        quantity=one,
        verdict=DIFFERS if differs else AGREES,
        p=1.0 - probability,
        information=information,
        values=values,
        birge=birge,
        trusted=None if differs else trusted,
        covariates=there,
        explanation=explain(values.value, values.std, among, there)
        if differs
        else None,
        alternatives=tuple(keys[term] for term in others if term in keys),
    )


def _alternatives(found: Difference, term: Term) -> list[Term]:
    """What the likely sets without a term have in its place."""
    total = float(np.logaddexp.reduce(list(found.sets.values())))
    best = {one.term for one in found.fit.mine}
    likely = [
        some
        for some, value in found.sets.items()
        if np.exp(value - total) >= OPEN_ALTERNATIVE
    ]
    others = {one.term for some in likely for one in some} - best
    without = [some for some in likely if all(one.term != term for one in some)]
    return [t for t in others if any(one.term == t for some in without for one in some)]


def _values(found: Difference, one: Quantity) -> tuple[RecordingValues, np.ndarray]:
    """Values of a quantity in each recording beside what else differs, and what each tells of it, (R,).

    Friction is that of each recording, whatever the others have; of all else, which cannot be told from the arm that
    all share, differences from the first.
    """
    term, fit = one.term, found.fit
    design, groups = fit.contrast.design, range(fit.contrast.groups)
    absolute = term.parametrisation.data_sheet is not None
    contrast = fit.contrast
    mine = {g: c for c in fit.mine if c.term == term for g in c.groups or ()}
    # one that has none of its own is what all share
    base = None
    if absolute:
        contrast = contrast.unshared(design.places[term])
    else:
        base = next((g for g in groups if g not in mine), 0)
    own = np.array([group for group in groups if group != base])
    each = [Candidate(term, (group,)) for group in own.tolist()]
    others = [other for other in fit.mine if other.term != term]
    known = dict(zip(fit.chosen, fit.answer.sizes, strict=True))
    sizes = [known[other] for other in others]
    sizes += [known[mine[g]] if g in mine else float(SIZES[-1]) for g in own.tolist()]
    answer = fit.own.within(contrast).answer([*others, *each], sizes)
    linear, count = len(design.places[term]), len(groups)
    values, covariance = np.zeros((count, linear)), np.zeros((count, count))
    values[own] = [answer.values[c] for c in each]
    first = len(answer.covariance) - linear * len(each)
    covariance[np.ix_(own, own)] = answer.covariance[first::linear, first::linear]
    told = TOLD / design.units[term][0]
    # beside those that have none of their own
    beside = values
    if absolute:
        values += found.arm.theta[list(term.columns)]
        told = max(told, float(np.abs(values[:, 0]).mean()))
        variance = np.diag(covariance)
    else:
        values = values - values[0]
        # from the mean of all, of which each is a part
        apart = np.eye(count) - 1.0 / count
        variance = np.diag(apart @ covariance @ apart) * count / (count - 1)
        told = max(told, float(np.abs(values[:, 0]).max()))
    information = told**2 / variance
    std = np.where(information >= 1.0, np.sqrt(variance), np.nan)
    shown = _shown(one, values, np.isfinite(std))
    # a centre of what is not there is nowhere
    parameters = tuple(
        _parameters(term, beside[g]) if g in mine or absolute else {} for g in groups
    )
    return RecordingValues(shown, std, parameters), information


def _parameters(term: Term, value: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters of an effect by its coordinates, (linear,)."""
    given = term.parametrisation.values(value[:, None], np.zeros((0, 1)))
    out = {name: np.squeeze(np.asarray(x), axis=-1) for name, x in given.items()}
    if term.is_load:
        out["first_moment"] = value[1:]
        if not is_within(term, value, 0.0):
            # of two loads of about one mass that differ in place there is no centre
            del out["com"]
    return out


def _shown(one: Quantity, values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The value that stands for a quantity in each recording, (R,), from its coordinates, (R, linear)."""
    if "scale" in one.term.definition.quantities.values():
        # recorded over true torque
        return np.where(known, 1.0 / (1.0 + values[:, 0]), np.nan)
    if one.term.is_load:
        return np.where(known, values[:, 0], np.nan)
    name = one.term.definition.parameters[0].name
    each = [np.ravel(_parameters(one.term, value)[name])[0] for value in values]
    return np.where(known, each, np.nan)


def _weighted_mean(
    value: np.ndarray, std: np.ndarray
) -> tuple[tuple[float, float], float]:
    """Mean with weights 1 / std^2 and its deviation, widened by the Birge ratio if that exceeds 1; and that ratio."""
    weight = std**-2.0
    mean = float((weight * value).sum() / weight.sum())
    scatter = float((weight * (value - mean) ** 2).sum())
    birge = float(np.sqrt(scatter / (len(value) - 1)))
    return (mean, max(1.0, birge) / float(np.sqrt(weight.sum()))), birge
