"""Whether recordings agree: one parameter at a time, what a difference goes with, in words and as a document."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name, listing, percent
from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import plain
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.thresholds import (
    COVARIATE_CHANGE,
    COVARIATE_SHARE,
    COVARIATE_TEMPERATURE,
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
    # only if every recording logs it: a hole has no place on a line
    logged = [r.temperature for r in recordings if r.temperature is not None]
    if len(logged) == len(recordings):
        warmth = np.array([series[:, places].mean() for series in logged])
        found.append(Covariate(TEMPERATURE, "deg C", warmth))
    # stamps that begin at zero tell no time of day: only the order of the list is known
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
    # a quantity that hardly varies goes with a difference by chance alone
    differing = [one for one in candidates if one.differs(among)]
    differing.sort(key=lambda one: _relative_change(one, among), reverse=True)
    x, weight = value[among], std[among] ** -2.0
    # Cochran's Q: what the weighted mean leaves
    total = _remainder(x, weight, np.ones((len(x), 1)))
    left = {}
    for one in differing:
        line = np.column_stack([np.ones(len(x)), one.value[among]])
        left[one.name] = _remainder(x, weight, line)
    shares = {name: 1.0 - rest / total for name, rest in left.items()}
    changed = tuple(left)
    if len(among) <= 2:
        return Explanation((), None, shares, changed)
    # each recording alone against the mean of all others: a step in place of a line
    apart = {}
    for place, number in enumerate(among.tolist()):
        step = np.column_stack([np.ones(len(x)), np.arange(len(x)) == place])
        apart[number] = _remainder(x, weight, step)
    odd = min(apart, key=lambda number: apart[number])
    least = min(min(left.values(), default=np.inf), apart[odd])
    # neither a line nor one odd recording explains most of the scatter
    if 1.0 - least / total < COVARIATE_SHARE:
        return Explanation((), None, shares, changed)
    # a remainder as small as noise leaves is as good as none
    border = AS_WELL * max(least, len(x) - 2.0)
    names = tuple(name for name in changed if left[name] <= border)
    return Explanation(names, odd if apart[odd] <= border else None, shares, changed)


def _relative_change(one: Covariate, among: np.ndarray) -> float:
    """Range over mean [1]; of times and temperatures, whose zero is arbitrary, below those of the others."""
    value = one.value[among]
    change = float(np.ptp(value) / max(np.abs(value).mean(), SMALLEST))
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
class ParameterAgreement:
    """One parameter in R recordings.

    Attributes:
        term: of which the first coordinate is its value.
        verdict: ``agrees``, ``differs``, or ``not determined`` by two recordings.
        p: probability that all recordings have one value [1]; ``None`` if it was not tested.
        information: square of what tells the value over the variance that each recording leaves [1], (R,).
        value, std: in each recording, (R,); the deviation is not a number in one that does not determine it, nor is the
            value.
        parameters: of the effect, by name, in each recording that has some of its own; but for friction beside those
            that have none.
        covariates: of the recordings, as this parameter sees them.
        birge: sqrt(Q / (k - 1)) of the k values that are determined [1]; ``None`` if not tested. Source: cochran1954.
        trusted: value and deviation, widened by the Birge ratio if that exceeds 1; ``None`` if there is none to trust.
        explanation: what the difference goes with; ``None`` if there is none.
        alternatives: other terms that would explain the difference about as well.
    """

    term: Term
    verdict: str
    p: float | None
    information: np.ndarray
    value: np.ndarray
    std: np.ndarray
    parameters: tuple[dict[str, np.ndarray], ...]
    covariates: tuple[Covariate, ...]
    birge: float | None = None
    trusted: tuple[float, float] | None = None
    explanation: Explanation | None = None
    alternatives: tuple[Term, ...] = ()

    @property
    def _called(self) -> tuple[str, str]:
        """Key and name of its effect by its quantity, or by its own name."""
        plain = self.term.effect, effect_name(self.term.effect)
        quantity = "".join(self.term.definition.needed_quantities)
        return SHORT.get(quantity, plain) if self.term.joint else plain

    @property
    def key(self) -> str:
        """Short name: ``c2``, ``load`` or ``gain2``."""
        key, _ = self._called
        return LAST_LOAD if self.term.is_load else f"{key}{self.term.joint or ''}"

    @property
    def name(self) -> str:
        """In words."""
        joint, (_, name) = self.term.joint, self._called
        if self.term.is_load:
            return "load on the last link"
        place = "motor" if self.term.definition.reach == "motor" else "joint"
        return f"{name} of {place} {joint}" if joint else name

    @property
    def unit(self) -> str:
        """Unit of its value."""
        return self.term.definition.parameters[0].unit

    @property
    def joint(self) -> int | None:
        """Its joint from 1; ``None`` if it acts on several."""
        return self.term.joint or None

    @property
    def among(self) -> np.ndarray:
        """Numbers of the recordings that determine it."""
        return np.flatnonzero(np.isfinite(self.std))


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
        # what is less likely than not makes no state of its own
        differing = {line.term for line in self.having(DIFFERS)}
        mine = [] if self.found is None else self.found.fit.mine
        return [one for one in mine if one.has(number) and one.term in differing]

    @property
    def states(self) -> list[list[int]]:
        """Numbers of the recordings that share a state; first the state that most time was recorded in to fit."""
        same: dict[frozenset[Candidate], list[int]] = {}
        for number in range(len(self.recordings)):
            same.setdefault(frozenset(self.own(number)), []).append(number)
        fitted = {recording.name for recording in self.case.recordings}

        # values are fitted to none that is judged only: its time does not count
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
            # each recording is a group of its own
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


def _lines(
    recordings: Sequence[Recording], found: Difference
) -> tuple[ParameterAgreement, ...]:
    """Verdicts on all that may change on an arm that stays as it was built, joint by joint, what differs first."""
    # one arm was built once; searched parameters have no single value to compare
    terms = [
        term
        for term in found.fit.contrast.design.places
        if not (lasts(term) or term.parametrisation.nonlinear)
    ]
    # the load last
    terms.sort(key=lambda term: (not term.joint, term.joint))
    lines = [_line(recordings, found, term) for term in terms]
    return tuple(sorted(lines, key=lambda line: line.verdict != DIFFERS))


def _line(
    recordings: Sequence[Recording], found: Difference, term: Term
) -> ParameterAgreement:
    """Verdict on one parameter, all others as the search has them."""
    # summed over all sets of terms that were weighed, whatever else they hold
    probability = found.probabilities_of(lambda c: c.term).get(term, 0.0)
    differs = probability >= NAMED_PROBABILITY
    rows = found.fit.contrast.design.rows
    value, std, parameters, information = _values(found, term)
    line = ParameterAgreement(
        term=term,
        verdict=DIFFERS if differs else NOT_DETERMINED,
        p=1.0 - probability if differs else None,
        information=information,
        value=value,
        std=std,
        parameters=parameters,
        covariates=covariates(recordings, rows, term.joint or None),
    )
    among = line.among
    # one value has nothing to agree with
    if len(among) < 2:
        return line
    # the mean by weights 1 / std^2, its deviation widened by the Birge ratio if that exceeds 1
    x, weight = value[among], std[among] ** -2.0
    mean = float((weight * x).sum() / weight.sum())
    scatter = float((weight * (x - mean) ** 2).sum())
    birge = float(np.sqrt(scatter / (len(x) - 1)))
    line = replace(line, p=1.0 - probability, birge=birge)
    if not differs:
        deviation = max(1.0, birge) / float(np.sqrt(weight.sum()))
        return replace(line, verdict=AGREES, trusted=(mean, deviation))
    return replace(
        line,
        explanation=explain(value, std, among, line.covariates),
        alternatives=tuple(_alternatives(found, term)),
    )


def _alternatives(found: Difference, term: Term) -> list[Term]:
    """What the likely sets without a term have in its place."""
    # log of the sum over all sets: exp(value - total) is a set's probability
    total = float(np.logaddexp.reduce(list(found.sets.values())))
    best = {one.term for one in found.fit.mine}
    likely = [
        some
        for some, value in found.sets.items()
        if np.exp(value - total) >= OPEN_ALTERNATIVE
    ]
    others = {one.term for some in likely for one in some} - best
    # only what takes its place: the set has to lack the term on every recording
    without = [some for some in likely if all(one.term != term for one in some)]
    return [t for t in others if any(one.term == t for some in without for one in some)]


def _values(
    found: Difference, term: Term
) -> tuple[np.ndarray, np.ndarray, tuple[dict[str, np.ndarray], ...], np.ndarray]:
    """Value, deviation and parameters in each recording beside what else differs, and what each tells of it, (R,).

    Friction is that of each recording, whatever the others have; of all else, which cannot be told from the arm that
    all share, differences from the first.
    """
    fit = found.fit
    design, groups = fit.contrast.design, range(fit.contrast.groups)
    absolute = term.parametrisation.data_sheet is not None
    contrast = fit.contrast
    # by group: what the search has of this term
    mine = {g: c for c in fit.mine if c.term == term for g in c.groups or ()}
    # one that has none of its own is what all share
    base = None
    if absolute:
        # without the value that all share, each recording tells its whole value
        contrast = contrast.unshared(design.places[term])
    else:
        base = next((g for g in groups if g not in mine), 0)
    own = np.array([group for group in groups if group != base])
    # a candidate in every group: one without a value of its own is asked as well
    each = [Candidate(term, (group,)) for group in own.tolist()]
    others = [other for other in fit.mine if other.term != term]
    known = dict(zip(fit.chosen, fit.answer.sizes, strict=True))
    # sizes as the search has them, and the widest where it has none
    sizes = [known[other] for other in others]
    sizes += [known[mine[g]] if g in mine else SIZES[-1] for g in own.tolist()]
    answer = fit.own.within(contrast).answer([*others, *each], sizes)
    linear, count = len(design.places[term]), len(groups)
    values, covariance = np.zeros((count, linear)), np.zeros((count, count))
    values[own] = [answer.values[c] for c in each]
    # own values come last; of each, the first coordinate is the one that is shown
    first = len(answer.covariance) - linear * len(each)
    covariance[np.ix_(own, own)] = answer.covariance[first::linear, first::linear]
    # beside those that have none of their own
    beside = values
    if absolute:
        values += found.arm.theta[list(term.columns)]
        size, variance = float(np.abs(values[:, 0]).mean()), np.diag(covariance)
    else:
        values = values - values[0]
        # from the mean of all, of which each is a part
        apart = np.eye(count) - 1.0 / count
        variance = np.diag(apart @ covariance @ apart) * count / (count - 1)
        size = float(np.abs(values[:, 0]).max())
    information = max(TOLD / design.units[term][0], size) ** 2 / variance
    std = np.where(information >= 1.0, np.sqrt(variance), np.nan)
    shown = [_shown(term, value) for value in values]
    # a centre of what is not there is nowhere
    parameters = tuple(
        _parameters(term, beside[g]) if g in mine or absolute else {} for g in groups
    )
    return np.where(np.isfinite(std), shown, np.nan), std, parameters, information


def _parameters(term: Term, value: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters of an effect by its coordinates, (linear,)."""
    given = term.parametrisation.values(value[:, None], np.zeros((0, 1)))
    out = {name: np.squeeze(np.asarray(x), axis=-1) for name, x in given.items()}
    if term.is_load:
        # coordinates of a load: its mass, then mass times centre
        out["first_moment"] = value[1:]
        if not is_within(term, value, 0.0):
            # of two loads of about one mass that differ in place there is no centre
            del out["com"]
    return out


def _shown(term: Term, value: np.ndarray) -> float:
    """The value that stands for coordinates of a term, (linear,)."""
    if "scale" in term.definition.quantities.values():
        # recorded over true torque
        return float(1.0 / (1.0 + value[0]))
    if term.is_load:
        return float(value[0])
    name = term.definition.parameters[0].name
    return float(np.ravel(_parameters(term, value)[name])[0])


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
    # a line over anything goes through two points
    if len(line.among) <= 2:
        changed = [QUANTITY[name] for name in found.changed]
        return f"two recordings cannot say; they differ in {listing(changed) or 'nothing known'}"
    names = [QUANTITY[name] for name in found.goes_with]
    if found.alone is not None:
        names.insert(0, f"{labels[found.alone]} alone")
    if not names:
        return "nothing that is known of the recordings"
    if len(names) == 1:
        # one odd recording has no share: no line was drawn
        shares = [found.shares[name] for name in found.goes_with]
        return f"{names[0]} ({percent(shares[0])})" if shares else names[0]
    return f"{' or '.join(names)}: not told apart"


def settles(line: ParameterAgreement, labels: Sequence[str]) -> str:
    """The recording that would settle a difference; an empty string if there is none."""
    found = line.explanation
    if found is None:
        return ""
    among = line.among
    # no motion settles what hangs on the flange
    if line.term.is_load:
        heaviest = labels[among[int(np.argmax(line.value[among]))]]
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
    # of two recordings nothing is named: ask about what differs between them
    names = found.goes_with if len(among) > 2 else found.changed
    if not names:
        last = labels[among[-1]]
        return f"repeat {labels[among[0]]} and {last} one after the other: values that stay apart belong to the motion"
    # the recordings with the lowest and the highest value of a covariate
    name, *others = names
    values = next(one for one in line.covariates if one.name == name).value[among]
    ends = np.argmin(values), np.argmax(values)
    low, high = (labels[among[int(end)]] for end in ends)
    if name in (START, ORDER):
        return f"repeat {low} now: if the value of {low} comes back, it was not the time between"
    # several go together: vary one, keep the others
    if others:
        return f"repeat {low} with the {QUANTITY[name]} of {high}, all else as it was"
    if name == SPEED:
        return f"the motion of {high} at half speed: if the value follows the speed, the arm is the same"
    if name == TEMPERATURE:
        return f"the motion of {low} once more, as warm as {high}: the value should be that of {high}"
    return f"the motion of {low} with a known payload (payloads: in the case): does the value follow the load?"


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
        "joints": found.case.arm.joints,
        "recordings": found.labels,
        "friction_law": "Coulomb and viscous friction",
        "level": 1.0 - NAMED_PROBABILITY,
        "parameters": [_parameter(line, found) for line in found.parameters],
        "unknown": [
            {"joint": joint, "recording": found.labels[number]}
            for joint, number in found.unknown
        ],
    }
    return _plain(content)


def _plain(content: dict[str, Any]) -> dict[str, Any]:
    """As a document has it: numbers that are not known are null."""
    result: dict[str, Any] = plain(content, null_if_not_finite=True)
    return result


def states(found: Agreement) -> dict[str, Any]:
    """Whether recordings share a state, and what differs, as an entry of ``diagnosis.json``."""
    differing = found.having(DIFFERS)
    content = {
        "shared": not differing,
        "recordings": found.labels,
        "differs": [
            {
                "name": line.name,
                "unit": line.unit,
                "joints": [line.joint] if line.joint else [],
                "probability": 1.0 - (line.p or 0.0),
                "values": line.value,
                "std": line.std,
                "parameters": line.parameters,
            }
            for line in differing
        ],
        "command": f"gapscope agree {found.case.name}",
        "diagnosed": [found.labels[k] for k in found.states[0]],
    }
    return _plain(content)


def _parameter(line: ParameterAgreement, found: Agreement) -> dict[str, Any]:
    """One parameter."""
    trusted = line.trusted
    names = {one.term: one.name for one in found.parameters}
    return {
        "key": line.key,
        "name": line.name,
        "unit": line.unit,
        "joint": line.joint,
        "verdict": line.verdict,
        "p": line.p,
        "values": line.value,
        "parameters": line.parameters,
        "std": line.std,
        "information": line.information,
        "birge": line.birge,
        "trusted": None
        if trusted is None
        else {"value": trusted[0], "std": trusted[1]},
        "goes_with": None if line.explanation is None else _explanation(line, found),
        "settled_by": settles(line, found.labels) or None,
        "alternatives": [names[term] for term in line.alternatives if term in names],
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
        "covariates": explanation.goes_with,
        "recording": None if alone is None else found.labels[alone],
        "shares": explanation.shares,
        "differ": explanation.changed,
    }
