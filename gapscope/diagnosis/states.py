"""What an arm has in recordings, or spans of them, beside what it has where it was diagnosed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.agreement import Agreement, compared
from gapscope.diagnosis.thresholds import VISIBLE_EFFECT
from gapscope.effects.applied import AppliedEffect, Place, State
from gapscope.model.changes import Change
from gapscope.model.conditioning import torque_scale
from gapscope.model.rows import comparable
from gapscope.model.terms import Term, Terms


@dataclass(frozen=True)
class Increment:
    """What a term has at a place beside what it has where the arm was diagnosed.

    Attributes:
        value, deviation: of its coordinates, (linear,).
        columns: torque that each coordinate makes there [N m], (M, n, linear).
        scale: deviation of the torque there [N m], (n,).
    """

    value: np.ndarray
    deviation: np.ndarray
    columns: np.ndarray
    scale: np.ndarray

    @property
    def torque(self) -> np.ndarray:
        """What it does to the torque there [N m], (M, n)."""
        return self.columns @ self.value

    def shows(self, value: np.ndarray) -> bool:
        """Whether a value of the term moves the torque of some joint by as much as an effect that is named."""
        torque = self.columns @ value
        share = np.sqrt((torque**2).mean(axis=0)) / self.scale
        return bool((share >= VISIBLE_EFFECT).any())

    def __add__(self, other: Increment) -> Increment:
        """Both together, seen where this one is."""
        # taken as independent
        deviation = np.hypot(self.deviation, other.deviation)
        return replace(self, value=self.value + other.value, deviation=deviation)

    def __neg__(self) -> Increment:
        """The same undone."""
        return replace(self, value=-self.value)


Increments = Mapping[Term, Increment]


@dataclass(frozen=True)
class OtherState:
    """What an arm has at a place beside what it has where it was diagnosed.

    Attributes:
        place: where.
        increments: by term; none where it was diagnosed.
    """

    place: Place
    increments: Increments = field(default_factory=dict)

    def theta(
        self, terms: Terms, theta: np.ndarray, least: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Coordinates of effects at the place, (P,).

        What shows too little there to be named is none.

        Args:
            terms: terms.
            theta: their coordinates where the arm was diagnosed, (P,).
            least: what they are without any effect, (P,).
        """
        theta, base = theta.copy(), np.broadcast_to(least, theta.shape)
        for term, increment in self.increments.items():
            # the same term of another table, where its places may be others
            (own,) = (t for t in terms.of(term.effect) if t.joint == term.joint)
            places = list(own.columns)
            theta[places] += increment.value
            if not increment.shows(theta[places] - base[places]):
                theta[places] = base[places]
        return terms.clipped(theta)

    def effects(
        self, terms: Terms, theta: np.ndarray, least: np.ndarray | float = 0.0
    ) -> tuple[AppliedEffect, ...]:
        """The same as effects: a force that acts at the place does so all the time."""
        mine = {(term.effect, term.joint) for term in self.increments}
        forces = {
            term: acts
            for term, acts in terms.forces.items()
            if (term.effect, term.joint) in mine
        }
        # a force of where the arm was diagnosed does not act here
        elsewhere = theta.copy()
        for term in forces:
            elsewhere[list(term.columns)] = 0.0
        here = Terms(terms.n_joints, {**terms.shapes, **forces}, terms.motors)
        return here.effects(self.theta(here, elsewhere, least))


@dataclass(frozen=True)
class States:
    """The states of an arm in a case.

    Attributes:
        found: whether its recordings share a state; ``None`` of a single one, or of a torque that was worked out.
        others: the states of whole recordings that are not those in which the arm was diagnosed.
        spans: the states of all recordings, a span of one each, in their order; none if they share one.
        like: a recording that is fitted for each that is judged, whose state it shares.
    """

    found: Agreement | None
    others: tuple[OtherState, ...] = ()
    spans: tuple[OtherState, ...] = ()
    like: Mapping[str, str] = field(default_factory=dict)

    def first(self, case: Case) -> Case:
        """The case with the recordings alone that share the first state; one that is judged and shares none stays."""
        assert self.found is not None
        here = [self.found.recordings[k].name for k in self.found.states[0]]
        recordings = tuple(r for r in case.recordings if r.name in here)
        judged = tuple(r for r in case.judged if self.like.get(r.name, here[0]) in here)
        return replace(case, recordings=recordings, judged=judged)

    def effects(
        self, terms: Terms, theta: np.ndarray, least: np.ndarray | float = 0.0
    ) -> tuple[State, ...]:
        """All effects in each recording and span.

        Args:
            terms: terms.
            theta: their coordinates where the arm was diagnosed, (P,).
            least: the same without any effect, (P,).
        """
        return tuple(
            State(span.place, span.effects(terms, theta, least)) for span in self.spans
        )


def states_of(
    case: Case,
    whole: Sequence[Recording],
    found: Agreement | None,
    changes: Sequence[Change],
) -> States:
    """The states of a case.

    Args:
        case: its recordings, or the parts of them that were compared.
        whole: the same recordings from first to last sample.
        found: whether those that are fitted share a state; ``None`` if that was not asked.
        changes: what changes during recordings.
    """
    others = () if found is None else _others(found)
    if not (others or changes):
        return States(found)
    like = _like(case) if others else {}
    # what recordings have all along, by name
    between = {name: s.increments for s in others for name in s.place.recordings}
    spans: list[OtherState] = []
    for recording in whole:
        name = recording.name
        # of a recording only the part that was compared may be left
        part = next(
            (r for r in (*case.recordings, *case.judged) if r.name == name), None
        )
        if part is None:
            # too short a part of it was left to tell
            continue
        mine = [step for c in changes if c.recording == name for step in _at_once(c)]
        mine.sort(key=lambda c: c.time)
        # what changed before the part that was compared is there already
        own, begins = between.get(like.get(name, name), {}), float(part.t[0])
        spans += _spans(recording, own, mine, begins)
    return States(found, others, tuple(spans), like)


def _like(case: Case) -> dict[str, str]:
    """A recording that is fitted for each that is judged, whose state it shares; none where it has one of its own.

    Its torque tells where it is judged, and no value.
    """
    if not case.judged:
        return {}
    # fitted and judged ones together, so that they can share states
    found = compared(case, comparable((*case.recordings, *case.judged)))
    fitted, judged = ({r.name for r in some} for some in (case.recordings, case.judged))
    like: dict[str, str] = {}
    for numbers in found.states:
        names = [found.recordings[k].name for k in numbers]
        known = [name for name in names if name in fitted]
        like |= {name: known[0] for name in names if known and name in judged}
    return like


def _others(found: Agreement) -> tuple[OtherState, ...]:
    """What recordings have that do not share the first state."""
    first, *others = found.states
    return tuple(
        OtherState(
            Place(tuple(found.recordings[k].name for k in numbers)),
            # one recording stands for all that share its state
            _beside(found, numbers[0], first[0]),
        )
        for numbers in others
    )


def _beside(found: Agreement, number: int, first: int) -> Increments:
    """What a recording has beside another one, of what differs."""
    assert found.found is not None
    fit = found.found.fit
    design = fit.contrast.design
    rows = design.rows
    mine = rows.of(number)
    scale = torque_scale(rows.torque[mine])
    parts: list[Increments] = []
    # what it has, less what the recording of the first state has
    for sign, own in ((1.0, found.own(number)), (-1.0, found.own(first))):
        for one in own:
            units = np.eye(len(one.term.columns))
            torque = [
                rows.in_newton_metres(design.torque(one.term, x))[mine] for x in units
            ]
            increment = Increment(
                sign * fit.values[one],
                fit.answer.deviations[one],
                np.stack(torque, axis=2),
                scale,
            )
            parts.append({one.term: increment})
    return _sum(parts)


def _spans(
    recording: Recording, own: Increments, changes: Sequence[Change], begins: float
) -> Iterator[OtherState]:
    """The states of a recording, one after the other.

    Args:
        recording: it.
        own: what the part has that was compared.
        changes: its changes, in their order.
        begins: when that part does [s].
    """
    times = [-np.inf, *(change.time for change in changes), np.inf]
    moved = [{c.term: _increment(c, recording)} for c in changes]
    # those before the part that was compared are in ``own``: undone, then added
    before = [
        {t: -x for t, x in m.items()}
        for m, c in zip(moved, changes, strict=True)
        if c.time <= begins
    ]
    for k, (start, end) in enumerate(pairwise(times)):
        # several may change at once
        if start == end:
            continue
        # span k begins with change k - 1: it has all up to that one
        increments = _sum([own, *before, *moved[:k]])
        yield OtherState(Place((recording.name,), start, end), increments)


def _at_once(change: Change) -> list[Change]:
    """A change; of one that takes a while half of it, which the arm has on average meanwhile, and the other half."""
    if change.until is None:
        return [change]
    half = replace(change, value=change.value / 2, deviation=change.deviation / 2)
    return [half, replace(half, time=change.until)]


def _increment(change: Change, recording: Recording) -> Increment:
    """What an arm has from a change on."""
    columns = change.columns[recording.name][1]
    assert recording.tau is not None
    scale = torque_scale(recording.tau)
    return Increment(change.value, change.deviation, columns, scale)


def _sum(parts: Sequence[Increments]) -> Increments:
    """Increments of all parts, term by term."""
    out: dict[Term, Increment] = {}
    for part in parts:
        for term, increment in part.items():
            out[term] = out[term] + increment if term in out else increment
    return out
