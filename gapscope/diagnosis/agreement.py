"""Whether recordings agree: one parameter at a time, what a difference goes with, in words and as a document."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name, percent
from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import plain
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    COVARIATE_CHANGE,
    COVARIATE_SHARE,
    COVARIATE_TEMPERATURE,
    FALSE_ALARM_RATE,
    NAMED_PROBABILITY,
    OPEN_ALTERNATIVE,
)
from gapscope.ident.samples import check_recordings
from gapscope.model.changes import between_recordings
from gapscope.model.contrast import SIZES
from gapscope.model.design import lasts
from gapscope.model.difference import Difference, is_within
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term

# What a difference between recordings goes with: speed, temperature, load, time, or one recording alone.


SPEED, TEMPERATURE, LOAD, START, ORDER = (
    "speed",
    "temperature",
    "load",
    "start time",
    "order",
)
CLOCK = 1e8
"""Time stamps beyond this are those of a clock, not of the recording's start [s]."""
AS_WELL = 4.0
"""What leaves no more than this many times the least remainder explains about as well [1]."""


@dataclass(frozen=True)
class Covariate:
    """A property of the recordings.

    Attributes:
        name: speed, temperature, load, start time or order.
        unit: of the values.
        value: in each recording, (R,).
    """

    name: str
    unit: str
    value: np.ndarray

    def differs(self, among: np.ndarray) -> bool:
        """Whether some recordings, numbers (k,), differ in it enough to compare them by it."""
        value = self.value[among]
        apart = float(np.ptp(value))
        if self.name == TEMPERATURE:
            return apart >= COVARIATE_TEMPERATURE
        if self.name in (START, ORDER):
            return apart > 0.0
        return apart >= COVARIATE_CHANGE * float(np.abs(value).mean()) > 0.0


@dataclass(frozen=True)
class Explanation:
    """What a difference goes with.

    Attributes:
        goes_with: names of covariates that explain it about as well as the best; one name is an answer, several are
            not told apart by these recordings, none explains it.
        alone: number of the recording without which the others agree as well, or ``None``.
        shares: share of the squared deviations that each differing covariate explains [1], by name.
        changed: names of the covariates that differ, the most different first.
    """

    goes_with: tuple[str, ...]
    alone: int | None
    shares: dict[str, float]
    changed: tuple[str, ...]


def covariates(
    recordings: Sequence[Recording], rows: Rows, joint: int | None
) -> tuple[Covariate, ...]:
    """Covariates of a joint, from 1, or of the whole arm: mean |dq|, temperature, |torque|, start.

    Args:
        recordings: R recordings.
        rows: of them, a group each.
        joint: the joint; ``None`` for all.
    """
    places = slice(None) if joint is None else slice(joint - 1, joint)
    numbers = range(len(recordings))

    def mean(series: np.ndarray) -> np.ndarray:
        """Mean size in each recording, (R,)."""
        return np.array([np.abs(series[rows.of(k)][:, places]).mean() for k in numbers])

    found = [
        Covariate(SPEED, "rad/s", mean(rows.velocity)),
        Covariate(LOAD, "N m", mean(rows.torque)),
    ]
    logged = [r.temperature for r in recordings if r.temperature is not None]
    if len(logged) == len(recordings):
        warmth = np.array([series[:, places].mean() for series in logged])
        found.append(Covariate(TEMPERATURE, "deg C", warmth))
    starts = np.array([r.stamps[0] for r in recordings])
    if starts.min() > CLOCK:
        found.append(Covariate(START, "h", (starts - starts.min()) / 3600.0))
    else:
        found.append(Covariate(ORDER, "1", np.arange(1.0, len(recordings) + 1.0)))
    return tuple(found)


def explain(
    value: np.ndarray,
    std: np.ndarray,
    among: np.ndarray,
    candidates: Sequence[Covariate],
) -> Explanation:
    """What values that differ, (R,) with deviations, go with among the recordings that determine them, numbers (k,).

    A weighted line over each covariate leaves Q_res of Cochran's Q; so does leaving one recording out. Two recordings
    lie on a line over anything: nothing is named then.
    """
    differing = [one for one in candidates if one.differs(among)]
    differing.sort(key=lambda one: _relative_change(one, among), reverse=True)
    x, weight = value[among], std[among] ** -2.0
    total = _remainder(x, weight, np.ones((len(x), 1)))
    left = {}
    for one in differing:
        line = np.column_stack([np.ones(len(x)), one.value[among]])
        left[one.name] = _remainder(x, weight, line)
    shares = {name: 1.0 - rest / total for name, rest in left.items()}
    changed = tuple(left)
    if len(among) < 3:
        return Explanation((), None, shares, changed)
    apart = {}
    for place, number in enumerate(among.tolist()):
        step = np.column_stack([np.ones(len(x)), np.arange(len(x)) == place])
        apart[number] = _remainder(x, weight, step)
    odd = min(apart, key=lambda number: apart[number])
    least = min(min(left.values(), default=np.inf), apart[odd])
    if 1.0 - least / total < COVARIATE_SHARE:
        return Explanation((), None, shares, changed)
    # a remainder as small as noise leaves is as good as none
    border = AS_WELL * max(least, len(x) - 2.0)
    names = tuple(name for name in changed if left[name] <= border)
    return Explanation(names, odd if apart[odd] <= border else None, shares, changed)


def _relative_change(one: Covariate, among: np.ndarray) -> float:
    """Range over mean [1]; of times and temperatures, whose zero is arbitrary, below those of the others."""
    value = one.value[among]
    change = float(np.ptp(value) / max(np.abs(value).mean(), 1e-300))
    return change if one.name in (SPEED, LOAD) else min(change, COVARIATE_CHANGE)


def _remainder(x: np.ndarray, weight: np.ndarray, design: np.ndarray) -> float:
    """Sum of weighted squares that a design of few columns leaves."""
    root = np.sqrt(weight)
    # centred columns keep a covariate with a large mean well conditioned
    shifted = design - np.append(0.0, design[:, 1:].mean(axis=0))
    fit = np.linalg.lstsq(shifted * root[:, None], x * root, rcond=None)[0]
    return float((((x - shifted @ fit) * root) ** 2).sum())


# Do these recordings agree? For each parameter: agrees or differs, with what, and which value to trust.
#
# The contrast of the recordings (``gapscope.model``), each a group: what all share is free, and each may have some of
# its own. The best set of what recordings have of their own says which parameters differ.


AGREES, DIFFERS, NOT_DETERMINED = "agrees", "differs", "not determined"
LAST_LOAD = "load"
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
    check_recordings(every, every, case)
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
        return Quantity(LAST_LOAD, "load on the last link", unit, None, term)
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
    sizes += [known[mine[g]] if g in mine else SIZES[-1] for g in own.tolist()]
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


# An agreement in sentences: with what a difference goes, and which recording would settle it.


QUANTITY = {
    SPEED: "mean speed",
    TEMPERATURE: "temperature",
    LOAD: "load torque",
    START: "start time",
    ORDER: "order of the recordings",
}
"""Covariates in words."""


def goes_with(line: ParameterAgreement, labels: Sequence[str]) -> str:
    """What a difference goes with; an empty string if there is none."""
    found = line.explanation
    if found is None:
        return ""
    if len(_among(line)) < 3:
        changed = [QUANTITY[name] for name in found.changed]
        return f"two recordings cannot say; they differ in {_listed(changed) or 'nothing known'}"
    names = [QUANTITY[name] for name in found.goes_with]
    if found.alone is not None:
        names.insert(0, f"{labels[found.alone]} alone")
    if not names:
        return "nothing that is known of the recordings"
    if len(names) == 1:
        shares = [found.shares[name] for name in found.goes_with]
        return f"{names[0]} ({percent(shares[0])})" if shares else names[0]
    return f"{' or '.join(names)}: not told apart"


def settles(line: ParameterAgreement, labels: Sequence[str]) -> str:
    """The recording that would settle a difference; an empty string if there is none."""
    found = line.explanation
    if found is None:
        return ""
    among = _among(line)
    if line.quantity.key == LAST_LOAD:
        value = line.values.value
        heaviest = labels[among[int(np.argmax(value[among]))]]
        return (
            f"repeat {heaviest} with the empty flange; if it carried a known load, enter that under payloads: in the "
            "case"
        )
    if len(among) > 2 and found.alone is not None:
        again = f"repeat {labels[found.alone]}: if its value comes back, what is different there changes it"
        others = [QUANTITY[name] for name in found.goes_with]
        if others:
            again += f"; then vary the {others[0]} alone"
        return again
    names = found.goes_with if len(among) > 2 else found.changed
    if len(names) > 1:
        return _one_at_a_time(line, labels, names[0])
    if names:
        return _variation(line, labels, names[0])
    last = labels[among[-1]]
    return f"repeat {labels[among[0]]} and {last} one after the other: values that stay apart belong to the motion"


def _variation(line: ParameterAgreement, labels: Sequence[str], name: str) -> str:
    """The recording that tests one covariate."""
    low, high = _extremes(line, labels, name)
    if name == SPEED:
        return f"the motion of {high} at half speed: if the value follows the speed, the arm is the same"
    if name == TEMPERATURE:
        return f"the motion of {low} once more, as warm as {high}: the value should be that of {high}"
    if name == LOAD:
        return f"the motion of {low} with a known payload (payloads: in the case): does the value follow the load?"
    return f"repeat {low} now: if the value of {low} comes back, it was not the time between"


def _one_at_a_time(line: ParameterAgreement, labels: Sequence[str], name: str) -> str:
    """The recording that separates covariates that changed together."""
    low, high = _extremes(line, labels, name)
    if name in (START, ORDER):
        return f"repeat {low} now: if the value of {low} comes back, it was not the time between"
    return f"repeat {low} with the {QUANTITY[name]} of {high}, all else as it was"


def _extremes(
    line: ParameterAgreement, labels: Sequence[str], name: str
) -> tuple[str, str]:
    """Recordings with the lowest and highest value of a covariate."""
    among = _among(line)
    values = covariate(line, name).value[among]
    low, high = among[int(np.argmin(values))], among[int(np.argmax(values))]
    return labels[low], labels[high]


def covariate(line: ParameterAgreement, name: str) -> Covariate:
    """A covariate of a line by its name."""
    return next(one for one in line.covariates if one.name == name)


def _among(line: ParameterAgreement) -> list[int]:
    """Numbers of the recordings that determine the parameter."""
    return [int(r) for r in np.flatnonzero(np.isfinite(line.values.std))]


def _listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


# The document of an agreement, ``agreement.json``.


def document(found: Agreement) -> dict[str, Any]:
    """An agreement as plain data; numbers that are not known are null.

    ``parameters`` has one entry per parameter, what differs first. ``values``, ``std`` and ``information`` have one
    number per recording, in the order of ``recordings``. ``covariates`` are those of the recordings as that parameter
    sees them.
    """
    content = {
        "schema": 1,
        "case": found.case.name,
        "joints": list(found.case.arm.joints),
        "recordings": list(found.labels),
        "friction_law": "Coulomb and viscous friction",
        "false_alarm_rate": FALSE_ALARM_RATE,
        "level": 1.0 - NAMED_PROBABILITY,
        "parameters": [_parameter(line, found) for line in found.parameters],
        "unknown": [
            {"joint": joint, "recording": found.labels[number]}
            for joint, number in found.unknown
        ],
    }
    result: dict[str, Any] = plain(content, null_if_not_finite=True)
    return result


def states(found: Agreement) -> dict[str, Any]:
    """Whether recordings share a state, and what differs, as an entry of ``diagnosis.json``."""
    differing = found.having(DIFFERS)
    content = {
        "shared": not differing,
        "recordings": list(found.labels),
        "differs": [
            {
                "name": line.quantity.name,
                "unit": line.quantity.unit,
                "joints": [] if line.quantity.joint is None else [line.quantity.joint],
                "probability": 1.0 - (line.p or 0.0),
                "values": line.values.value,
                "std": line.values.std,
                "parameters": _per_recording(line),
            }
            for line in differing
        ],
        "command": f"gapscope agree {found.case.name}",
        "diagnosed": [found.labels[k] for k in found.states[0]],
    }
    result: dict[str, Any] = plain(content, null_if_not_finite=True)
    return result


def _per_recording(line: ParameterAgreement) -> list[dict[str, Any]]:
    """Parameters of the effect in each recording."""
    return [
        {name: value.tolist() for name, value in each.items()}
        for each in line.values.parameters
    ]


def _parameter(line: ParameterAgreement, found: Agreement) -> dict[str, Any]:
    """One parameter."""
    trusted = line.trusted
    names = {one.quantity.key: one.quantity.name for one in found.parameters}
    return {
        "key": line.quantity.key,
        "name": line.quantity.name,
        "unit": line.quantity.unit,
        "joint": line.quantity.joint,
        "verdict": line.verdict,
        "p": line.p,
        "values": line.values.value,
        "parameters": _per_recording(line),
        "std": line.values.std,
        "information": line.information,
        "birge": line.birge,
        "trusted": None
        if trusted is None
        else {"value": trusted[0], "std": trusted[1]},
        "goes_with": None if line.explanation is None else _explanation(line, found),
        "settled_by": settles(line, found.labels) or None,
        "alternatives": [names[key] for key in line.alternatives],
        "covariates": {
            one.name: {"unit": one.unit, "values": one.value} for one in line.covariates
        },
    }


def _explanation(line: ParameterAgreement, found: Agreement) -> dict[str, Any]:
    """What a difference goes with."""
    explanation = line.explanation
    assert explanation is not None
    alone = explanation.alone
    return {
        "text": goes_with(line, found.labels),
        "covariates": list(explanation.goes_with),
        "recording": None if alone is None else found.labels[alone],
        "shares": explanation.shares,
        "differ": list(explanation.changed),
    }
