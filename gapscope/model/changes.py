"""What changes during recordings: which parameter, in which recording, at what moment, by how much.

Every recording is split into spans, each a group of the contrast (``difference.py``). A change is a value that the
spans of a recording from some moment on, or up to it, have of their own, beside all that the others share and what each
motion has of its own. Moments join one by one: spans of equal length show about where one lies, then the torque of the
change says when,

    p(tau) ~ exp(-1/2 sum_(t < tau) r^2 / s^2 - 1/2 sum_(t >= tau) (r - d)^2 / s^2),

with r the residual without the change, d what it does to the torque, and s^2 the variance of the noise and of what is
left. With spans that end there, all terms are asked again. A recording that differs from its first sample on is in
another state than the others; that is no change during it.

Of a stream (``changes_since``) the first recording is what was learnt: nothing changes in it, and it teaches noise and
form error. What the second one has since a moment, or has had all along, is asked beside friction, which may be
anything in it: it warms up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from gapscope.arm.display import effect_name, uncertain
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.effects.catalogue import of_quantity
from gapscope.model.conditioning import STANDS_OUT, slips, without_slips
from gapscope.model.design import (
    Design,
    FreeArm,
    design,
    fitted_arm,
    shared_basis,
)
from gapscope.model.difference import (
    GROWTHS,
    UNUSUAL,
    Difference,
    Fit,
    Search,
    in_a_row,
)
from gapscope.model.effective_samples import variance_inflation
from gapscope.model.equations import Equations, FormError, noise_of_motions
from gapscope.model.nonlinear_values import WINDOW_EDGES, Found
from gapscope.model.rows import MIN_MOTIONS, Rows, comparable
from gapscope.model.terms import Candidate, Term, Terms

SPANS = 8
"""Spans of a recording by which a moment is looked for. (budget)"""
PARTS = 3
"""Motions of each of them at least. (budget)"""
LEAST_MOTIONS = 2 * SPANS
"""Motions of all recordings at least, when it is asked what changed. (budget)"""
SMEARED = 1.0
"""Rows within so many periods of the band's cut-off of a moment are left out [1]: there a filter sees both sides, and
the reading of an encoder that slips has no velocity. (physical)"""
MAX_MOMENTS = 6
"""Moments of a case. (budget)"""
ZERO = "zero"
"""Quantity of a drive that an encoder which slips has another value of."""
FACTOR = "scale"
"""Quantity of a drive that multiplies its torque: it changes by a share of what it was."""
ANY_FRICTION = 1.0
"""Share by which friction now may differ from that which was learnt: a cold arm has up to twice as much [1]. (physical)
"""
SURE = 0.95
"""Probability that a moment is within its interval. (definition)"""


Moved = Mapping[str, tuple[np.ndarray, np.ndarray]]
"""By name of a recording, times in it by its own clock [s], (M,), and the torque that each coordinate of a term makes
there [N m], (M, n, linear)."""
Place = tuple[int, float, float]
"""Number of a recording, and the times in it between which something has a value [s]: infinite at an end."""


class Moment(NamedTuple):
    """When something changes.

    Attributes:
        time: likeliest moment, by the recording's own clock [s].
        interval: in which it lies with a probability of ``SURE`` [s].
    """

    time: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Change:
    """A parameter that changes at a moment of a recording, by the recording's own clock.

    Attributes:
        recording: name of the recording.
        time: likeliest moment [s].
        interval: in which it lies with a probability of ``SURE`` [s].
        term: what.
        value: by how much, the term's coordinates, (linear,).
        deviation: standard deviations of that, (linear,).
        probability: that it belongs to what changed [1].
        support: evidence of the change over what its prior odds ask for [1].
        columns: what it moves.
        until: when it has its whole value, which it takes in equal steps from ``time`` on [s]; ``None`` if at once.
    """

    recording: str
    time: float
    interval: tuple[float, float]
    term: Term
    value: np.ndarray
    deviation: np.ndarray
    probability: float
    support: float
    columns: Moved
    until: float | None = None

    @property
    def ends(self) -> float:
        """From when on all has changed, for certain [s]."""
        return self.interval[1] if self.until is None else self.until

    def __str__(self) -> str:
        """What changes when, in a few words."""
        where = f" of joint {self.term.joint}" * bool(self.term.joint)
        when = when_text(self.time, self.until)
        return f"{self.term.effect}{where} {when} of {self.recording}"


def when_text(time: float, until: float | None) -> str:
    """``at 3.70 s``, or ``from 3.00 to 6.00 s``."""
    return f"at {time:.2f} s" if until is None else f"from {time:.2f} to {until:.2f} s"


class Changes(NamedTuple):
    """What recordings and their spans have of their own.

    Attributes:
        during: what changes during recordings, in the order of recordings and moments.
        between: what whole recordings have of their own beside that, whatever changes during them; ``None`` if nothing
            is promised.
    """

    during: tuple[Change, ...]
    between: Difference | None


@dataclass(frozen=True)
class Learnt:
    """That the first recording is what was learnt of an arm, and the second what it does now.

    Attributes:
        about: the arm that predicts the first.
        asked: sets of spans that there are until as many false changes may be named as a user wants [1].
        free: what the second may have another value of all along, standard deviations of its coordinates, (linear,).
        taught: noise and form error that the first has taught about that arm, and from what.
        whole: makes rows of the same motion in as few segments as there are, in which a search is faster.
    """

    about: FreeArm
    asked: float
    free: Mapping[Term, np.ndarray]
    taught: tuple[FormError, Equations]
    whole: Callable[[], Rows]


class _Spans:
    """Spans of R recordings between times: groups of rows, and sets of them that may have one value.

    Args:
        rows: each recording a group.
        ends: per recording the times at which a span ends [s], rising.
        parts: motions of each span at least.
        moments: per recording, if not the ends of spans.
        learnt: if the first is what was learnt.
    """

    def __init__(
        self,
        rows: Rows,
        ends: Sequence[Sequence[float]],
        parts: int = MIN_MOTIONS,
        moments: Sequence[Sequence[float]] | None = None,
        learnt: Learnt | None = None,
    ) -> None:
        self.learnt = learnt
        # ends outside, or closer than a filter parts, would make spans without rows that count
        smeared = SMEARED / rows.cutoff
        kept = [
            _between(rows.t[rows.recording == number], some, smeared)
            for number, some in enumerate(ends)
        ]
        # span k of a recording lies between ends k and k + 1, the outer two at infinity
        self.ends = [np.array([-np.inf, *some, np.inf]) for some in kept]
        # groups are numbered through all recordings: the first one of each of them
        first = np.cumsum([0, *(len(some) + 1 for some in kept)]).tolist()
        self.groups = [list(range(a, b)) for a, b in pairwise(first)]
        group, left_out = rows.group.copy(), np.zeros(len(rows.group), dtype=bool)
        for number, some in enumerate(kept):
            mine = rows.recording == number
            group[mine] = first[number] + np.searchsorted(some, rows.t[mine])
            # a filter smears what changes: about the ends of a mere grid rows may stay
            for end in some if moments is None else moments[number]:
                left_out |= mine & (np.abs(rows.t - end) < smeared)
        self.rows = rows.regrouped(group, parts, left_out)

    def search(
        self, arm: FreeArm, sets: Sequence[tuple[int, ...]], asked: int
    ) -> Search:
        """The search for what sets of spans have of their own, of ``asked`` that there might be."""
        every = tuple(range(self.groups[-1][-1] + 1))
        if self.learnt is None:
            # all spans are of one day and teach noise: what changes lies between them
            terms = Terms(arm.arm.n_joints, {}, arm.arm.coupled_motors)
            return Search(
                self.rows,
                arm,
                sets,
                every,
                0.0,
                every,
                asked,
                passing=[some for some in sets if self._passes(some)],
                # forces as if they acted all along: the spans that have one say when
                found={t: Found(acts, (), 0.0) for t, acts in terms.forces.items()},
            )
        # only what was learnt teaches; what is now shares a friction of its own
        told, now = tuple(self.groups[0]), tuple(self.groups[1])
        return Search(
            rows=self.rows,
            arm=arm,
            sets=sets,
            taught_by=told,
            days=ANY_FRICTION,
            basis=told,
            asked=self.learnt.asked,
            together=[now],
            free=self.learnt.free,
            taught=self.learnt.taught,
        )

    def sets(self) -> list[tuple[int, ...]]:
        """Spans of a recording in a row, and all of each if there are several; of a stream those up to now."""
        if self.learnt is not None:
            # what a stream has it has until now: each set ends with the last span
            now = self.groups[1]
            return [tuple(now[k:]) for k in range(len(now))]
        out = []
        for some in self.groups:
            out += [tuple(some[k] for k in row) for row in in_a_row(len(some))]
            # all of a recording is one more state, if there are others to tell it from
            if len(self.groups) > 1:
                out.append(tuple(some))
        return out

    @property
    def parted(self) -> bool:
        """Whether some recording has more spans than one."""
        return any(len(ends) > 2 for ends in self.ends)

    def _passes(self, some: tuple[int, ...]) -> bool:
        """Whether spans begin and end within a recording."""
        return not any(some[0] == own[0] or some[-1] == own[-1] for own in self.groups)

    def place(self, one: Candidate) -> Place:
        """Recording of a candidate, and the times between which it has its value [s]: infinite at an end."""
        groups = one.groups or ()
        number = next(r for r, some in enumerate(self.groups) if groups[0] in some)
        first = self.groups[number][0]
        ends = self.ends[number]
        return (
            number,
            float(ends[groups[0] - first]),
            float(ends[groups[-1] - first + 1]),
        )

    def candidate(self, term: Term, place: Place) -> Candidate:
        """A term with a value of its own between the ends nearest to two times of a recording."""
        number, *times = place
        ends, groups = self.ends[number], np.array(self.groups[number])
        within = ends[1:-1]
        # its moments lie too near to the recording's ends
        if not len(within):
            return Candidate(term, tuple(groups.tolist()))
        # the grid moves from look to look: a time stands for the nearest end
        start, end = (
            float(within[np.argmin(np.abs(within - t))]) if np.isfinite(t) else t
            for t in times
        )
        inside = (ends[:-1] >= start) & (ends[1:] <= end)
        return Candidate(term, tuple(groups[inside].tolist()))

    def refined(self, fit: Fit, one: Candidate) -> Place:
        """Where a candidate has its value, the times taken from its torque."""
        number, start, end = self.place(one)
        moments = iter(self.moments(fit, one))
        begins = next(moments).time if np.isfinite(start) else start
        ends = next(moments).time if np.isfinite(end) else end
        # moments that swap leave nothing between them: the ends of the spans stand
        return (number, begins, ends) if begins < ends else (number, start, end)

    def moments(self, fit: Fit, one: Candidate) -> list[Moment]:
        """When a candidate begins and ends, each time between the ends before and after it.

        What a stream has all along began between what was learnt and now.
        """
        number, start, end = self.place(one)
        if self.learnt is not None and np.isinf(start):
            learnt = self.rows.recording == 0
            first = float(self.rows.t[~learnt].min())
            # clocks may overlap: an interval does not begin after its end
            since = min(float(self.rows.t[learnt].max()), first)
            return [Moment(first, (since, first))]
        return [
            self._moment(fit, one, number, time, begins)
            for time, begins in ((start, True), (end, False))
            if np.isfinite(time)
        ]

    def _moment(
        self, fit: Fit, one: Candidate, number: int, time: float, begins: bool
    ) -> Moment:
        """When a candidate begins or ends in a recording."""
        rows, made, values = self.rows, fit.contrast.design, fit.answer.values
        left = fit.left
        moved = made.torque(one.term, values[one])
        # as if the candidate were not there
        without = left + moved * np.isin(rows.group, one.groups or ())[:, None]
        # form error lasts longer than a row: neighbours that resemble each other count once
        alike = variance_inflation(left, rows.segment)
        variance = np.maximum(fit.contrast.error.noise2, alike * (left**2).mean(axis=0))
        ends = self.ends[number]
        k = int(np.argmin(np.abs(ends - time)))
        # the two spans about this end alone: at others something else may change
        here = (rows.t > ends[k - 1]) & (rows.t <= ends[k + 1])
        mine = np.flatnonzero((rows.recording == number) & here)
        # half the squares of each row in nats, without the change and with it
        off, on = (
            (r[mine] ** 2 / variance).sum(axis=1) / 2
            for r in (without, without - moved)
        )
        # between two rows: each side has some
        cost = np.cumsum(off - on if begins else on - off)[:-1]
        # less the least, so that one of them is 1 however long the recording is
        likely = np.exp(cost.min() - cost)
        total = np.cumsum(likely) / likely.sum()
        t = rows.t[mine]
        between = (t[1:] + t[:-1]) / 2
        # the filter sees about a row to both sides
        step = float(np.median(np.diff(t)))
        first, last = np.searchsorted(total, [(1 - SURE) / 2, (1 + SURE) / 2])
        # between two pieces of a recording there are no rows
        low = min(float(between[first]) - step, float(t[first]))
        high = max(float(between[last]) + step, float(t[last + 1]))
        return Moment(float(between[np.argmin(cost)]), (low, high))


def changes_of(
    recordings: Sequence[Recording],
    arm: NominalArm,
    progress: Callable[[str], None] = lambda message: None,
) -> Changes:
    """What changes during recordings, and what some have of their own from first to last sample.

    Those without a torque, or a stretch that is long enough, are left out. What is wrong all along is no change.
    """
    given = comparable(recordings)
    if not given:
        return Changes((), None)
    # a slip says itself when and how far: a filter would smear it over its neighbours
    recordings = [without_slips(one) for one in given]
    rows = Rows.recorded([[recording] for recording in recordings])
    # what whole recordings have of their own is told first, and then what it goes with
    ask = partial(likely_between, copy(rows), arm) if len(recordings) > 1 else None
    rows.follow_temperature()
    about = fitted_arm(rows, arm, tuple(range(len(recordings))))
    slipped = _slipped(given, rows, about)
    told = _by_torque(rows, about, {}, None, ask, progress)
    names = [one.name for one in recordings]
    moved = partial(_moved_by, names=names)
    found = _changes(told, names, moved) if told.found else ()
    number = {name: k for k, name in enumerate(names)}
    every = sorted((*slipped, *found), key=lambda c: (number[c.recording], c.time))
    return Changes(tuple(every), told.between)


def between_recordings(rows: Rows, arm: NominalArm) -> Difference:
    """What whole recordings, each a group of the rows, have of their own."""
    return _of_recordings(rows, fitted_arm(rows, arm, (0,))).run()


def likely_between(rows: Rows, arm: NominalArm) -> Difference | None:
    """The same; ``None`` if at a first look no recording promises anything."""
    about = fitted_arm(rows, arm, (0,))
    _, step = _of_recordings(rows, about).step({}, 0.0)
    return None if step is None else _of_recordings(rows, about).run()


def _of_recordings(rows: Rows, about: FreeArm) -> Search:
    """The search among whole recordings, each a group of the rows.

    Args:
        rows: the rows.
        about: the arm of the first one: fitted to all, it would have part of what some have of their own.
    """
    every = tuple(range(int(rows.group.max()) + 1))
    return Search(rows, about, in_a_row(len(every)), every, days=0.0)


def own_of_units(
    units: Mapping[str, Sequence[Recording]], arm: NominalArm, day: float
) -> list[dict[str, Any]]:
    """What units of a type have of their own beside what all share: entries of ``change_findings``, by ``unit``.

    Args:
        units: recordings of each, by its name; each unit is a group.
        arm: the nominal arm of the type.
        day: share by which friction differs from day to day, and is no difference [1].
    """
    rows = Rows.recorded(list(units.values()))
    every = tuple(range(len(units)))
    alone = [(group,) for group in every]
    about = fitted_arm(rows, arm, every)
    found = Search(rows, about, alone, every, day, every, together=alone).run()
    probabilities, names = found.probabilities, list(units)
    changes = [
        Change(
            recording=names[group],
            time=0.0,
            interval=(0.0, 0.0),
            term=one.term,
            value=found.fit.values[one],
            deviation=found.fit.answer.deviations[one],
            probability=probabilities[one],
            support=0.0,
            columns={},
        )
        for one in found.fit.mine
        for group in one.groups or ()
    ]
    told = ("what", "joints", "probability", "parameters")
    return [
        {"unit": entry["recording"]} | {key: entry[key] for key in told}
        for entry in change_findings(changes)
    ]


class Since(NamedTuple):
    """What a look at a stream says.

    Attributes:
        fit: what is left beside what was known.
        changes: what the second recording has had since a moment, or all along; ``None`` if nothing new is promised.
        steps: the same as what is known to have changed, a change that takes a while in steps.
        others: probability of every term of which it may have something.
        unknown: joints from 1 on which form error is larger, and since when [s].
        louder: joints from 1 with more noise: how much more, a ratio of RMS [1], and since when [s].
    """

    fit: Fit
    changes: tuple[Change, ...] | None = None
    steps: Mapping[tuple[Term, float], np.ndarray] = {}
    others: Mapping[Term, float] = {}
    unknown: Mapping[int, float] = {}
    louder: Mapping[int, tuple[float, float]] = {}


def changes_since(
    rows: Rows,
    known: Mapping[tuple[Term, float], np.ndarray],
    learnt: Learnt,
) -> Since:
    """What the second recording of rows has had since a moment that the first one, which was learnt, had not.

    Args:
        rows: both, on one clock.
        known: what is known to have changed, since when [s], and about by how much.
        learnt: beside what, and how rarely something may be named that is none.
    """
    # recording 1 is what is now, and what has changed lasts until its end
    given = {(term, (1, t, np.inf)): value for (term, t), value in known.items()}
    odds = float(np.log(learnt.asked))
    told = _by_torque(rows, learnt.about, given, learnt)
    if told.found is None:
        # no term: form error that is larger from some motion on is news by itself
        gain, joint, group = told.looked.unknown_since(told.fit)
        if gain <= odds:
            return Since(told.fit)
        since = float(rows.t[told.spans.rows.group == group].min())
        # what looks unknown may be noise that grew: both are told
        louder = _louder(told.fit, odds)
        return Since(told.fit, unknown={joint + 1: since}, louder=louder)
    # nobody asks where a term moves what
    changes = _changes(told, ["", ""], lambda made, term: {})
    steps = {
        (one.term, told.when[one][0].time): value
        for one, value in told.found.fit.values.items()
    }
    others = told.found.probabilities_of(lambda one: one.term)
    return Since(told.fit, changes, steps, others)


def _louder(fit: Fit, odds: float) -> dict[int, tuple[float, float]]:
    """Joints from 1 with more noise from some motion on: how much more, a ratio of RMS [1], and since when [s].

    The noise of motions scatters, its logarithms alike before and after. Of two means of N of them in all that are t
    deviations apart the evidence that they differ is N / 2 ln(1 + t^2 / (N - 2)).
    """
    contrast = fit.contrast
    rows, out = contrast.design.rows, {}
    gap = contrast.gap - fit.own.torque(fit.answer.values)
    beside = Equations.of(replace(contrast.design, gap=gap))
    for j in range(len(beside.cells)):
        begin, level = noise_of_motions(beside, j)
        # of variances: the logarithm of an RMS is half as large
        level, count = np.log(level), len(level)
        best = 0.0
        # splits from the first motion of now on, with two left after each at least
        for first in range(
            int((begin < len(rows.t[rows.recording == 0])).sum()), count - 1
        ):
            then, now = level[:first], level[first:]
            growth = now.mean() - then.mean()
            within = ((then - then.mean()) ** 2).sum() + ((now - now.mean()) ** 2).sum()
            # parted over within is t^2 / (N - 2)
            parted = growth**2 * len(then) * len(now) / count
            evidence = count / 2 * float(np.log1p(parted / max(within, SMALLEST)))
            # twice the RMS at least, as form error has to grow to be unknown
            if growth >= np.log(GROWTHS[0]) and evidence > max(best, odds):
                best = evidence
                out[j + 1] = float(np.exp(growth / 2)), float(rows.t[begin[first]])
    return out


def _slipped(
    recordings: Sequence[Recording], rows: Rows, about: FreeArm
) -> Iterator[Change]:
    """Encoders that slipped, as their readings say by themselves.

    Args:
        recordings: as recorded.
        rows: of these without the slips.
        about: the arm that predicts them.
    """
    every = [(one, slip) for one in recordings for slip in slips(one)]
    if not every:
        return
    made = design(rows, about, {})
    zeros = [t for t in made.terms.all if ZERO in t.definition.quantities.values()]
    by_joint = {term.joint: term for term in zeros}
    for one, slip in every:
        term, t = by_joint[slip.joint + 1], one.t
        before, after = float(t[slip.sample - 1]), float(t[slip.sample])
        yield Change(
            recording=one.name,
            time=(before + after) / 2,
            interval=(before, after),
            term=term,
            value=np.array([slip.size]),
            deviation=np.array([slip.error]),
            # the reading says so itself: no other hypothesis competes
            probability=1.0,
            support=abs(slip.size) / (STANDS_OUT * slip.error),
            columns=_moved_by(made, term, [one.name for one in recordings]),
        )


class _Told(NamedTuple):
    """What the torque says that changes.

    Attributes:
        found: the best hypothesis; ``None`` if nothing new is promised.
        spans: of it.
        when: moments of what it holds.
        between: what whole recordings have of their own, if that was asked.
        fit: what the last look left, beside what was known.
        looked: the search of the last look.
    """

    found: Difference | None
    spans: _Spans
    when: Mapping[Candidate, Sequence[Moment]]
    between: Difference | None
    fit: Fit
    looked: Search


def _by_torque(
    rows: Rows,
    about: FreeArm,
    known: Mapping[tuple[Term, Place], np.ndarray],
    learnt: Learnt | None = None,
    ask: Callable[[], Difference | None] | None = None,
    progress: Callable[[str], None] = lambda message: None,
) -> _Told:
    """What the torque says that changes during recordings.

    Args:
        rows: each recording a group.
        about: the arm that predicts.
        known: what is known to have changed, where, and about by how much.
        learnt: if the first recording is what was learnt.
        ask: asks what whole recordings have of their own.
        progress: is told.
    """
    count = int(rows.recording.max()) + 1
    times = [rows.t[rows.recording == k] for k in range(count)]
    # spans of as many rows each, since a log with gaps has some without any
    grid = [np.quantile(t, np.arange(1, SPANS) / SPANS) for t in times]
    # nothing changes in what was learnt
    if learnt is not None:
        grid[0] = np.zeros(0)
    torque: np.ndarray | float = 0.0
    # what changes, where, and by how much
    mine, new = dict(known), False
    before, left = _ends(known, count), MAX_MOMENTS
    between: Difference | None = None
    borne_out = False

    def question(
        some: Mapping[tuple[Term, Place], np.ndarray], ends: Sequence[list[float]]
    ) -> tuple[_Spans, Search, dict[Candidate, np.ndarray]]:
        """Spans between moments, the search among them, and what is likely to have changed."""
        # few long motions would be predicted from others that are unlike them
        groups = sum(map(len, ends)) + len(ends)
        parts = max(MIN_MOTIONS, -(-LEAST_MOTIONS // groups))
        spans = _Spans(learnt.whole() if learnt else rows, ends, parts, learnt=learnt)
        likely = {spans.candidate(*key): value for key, value in some.items()}
        # fewer sets than the look had, which chose among all of them: its odds hold
        return spans, spans.search(about, spans.sets(), len(sets)), likely

    while True:
        # look: the grid with the moments known, and what promises most beside them
        ends = _ends(mine, count)
        looked = _Spans(rows, list(map(_apart, grid, ends)), PARTS, before, learnt)
        sets = looked.sets()
        there = {looked.candidate(*key): value for key, value in mine.items()}
        # the odds of one set are shared by all that are looked at
        search = looked.search(about, sets, len(sets))
        fit, step = search.step(there, torque)
        if step is None and learnt is None:
            # what promised something may be nothing at its own moment
            fit = search.needed(fit)
        # what has no column about the moved arm, or cannot be beside the others, is none
        mine = {(one.term, looked.place(one)): fit.values[one] for one in fit.mine}
        # two that lie between the same moments become one
        moments = {
            (one.term, looked.place(one)): looked.moments(fit, one) for one in fit.mine
        }
        whole_ones = [tuple(some) for some in looked.groups]
        if step is not None and ask is not None and search.promises(fit, whole_ones):
            # what moves another load all along a recording looks like much else in its parts: whole ones first
            progress("asks whether the recordings share a state")
            between, ask = ask(), None
            if between is not None and between.fit.mine:
                mine = {
                    (one.term, (group, -np.inf, np.inf)): value
                    # each of these has it from first to last sample
                    for one, value in between.fit.values.items()
                    for group in one.groups or ()
                }
                about, torque = between.arm, between.fit.torque
                continue
        told = _Told(None, looked, {}, between, fit, search)
        # nothing new in a stream, or more noise, which makes all further questions vain
        ended = step is None or not left
        if learnt and ended and (not new or _louder(fit, float(np.log(learnt.asked)))):
            return told
        # what is told beside all that is no form error
        torque = fit.torque
        if step is not None and left:
            # what comes and goes has two moments: where none of two is borne out, others lead farther astray
            if learnt is None and not borne_out and sum(map(len, ends)) > 1:
                spans, asked, likely = question(mine, ends)
                borne_out = spans.parted and bool(asked.run(likely, torque).fit.mine)
                if not borne_out:
                    return told
            left, new, torque = left - 1, True, step.torque
            # one more moment moves the others: all are taken from the torque again
            mine = {
                (one.term, looked.refined(step, one)): value
                for one, value in step.values.items()
            }
            continue
        # recordings differ as a whole, but nothing changes during one
        if not mine or (learnt is None and not any(_ends(mine, count))):
            return told
        progress("asks what changed")
        spans, asked, likely = question(mine, ends)
        # all moments lie too near to the ends of their recordings
        if learnt is None and not spans.parted:
            return told
        found, borne_out = asked.run(likely, torque), True
        settled = set(found.fit.mine) <= set(likely)
        # what joined without having been asked gets a moment by another look
        if left and not settled:
            left, torque = left - 1, 0.0
            values = found.fit.values
            mine = {(one.term, spans.place(one)): x for one, x in values.items()}
            continue
        when = {one: spans.moments(found.fit, one) for one in found.fit.mine}
        # rows about these moments are left out of the spans, but not of the look
        if settled:
            when = {spans.candidate(*key): moment for key, moment in moments.items()}
        return told._replace(found=found, spans=spans, when=when)


def _ends(
    mine: Mapping[tuple[Term, Place], np.ndarray], count: int
) -> list[list[float]]:
    """Times at which what changes begins or ends, rising, of each of some recordings."""
    ends: list[set[float]] = [set() for _ in range(count)]
    for _, (number, *times) in mine:
        ends[number] |= {time for time in times if np.isfinite(time)}
    return [sorted(some) for some in ends]


def _between(t: np.ndarray, ends: Sequence[float], smeared: float) -> list[float]:
    """Ends, rising, of spans that each have rows, at times t, farther than ``smeared`` from both of its ends."""
    kept = [-np.inf]
    for end in ends:
        before = (t > kept[-1] + smeared) & (t < end - smeared)
        if before.any() and t[-1] > end + smeared:
            kept.append(end)
    return kept[1:]


def _apart(grid: np.ndarray, ends: Sequence[float]) -> list[float]:
    """Times of a grid and of the moments that are known, none closer to a moment than half a span."""
    if not len(grid):
        return list(ends)
    half = float(np.diff(grid).mean()) / 2
    kept = [t for t in grid.tolist() if all(abs(t - end) > half for end in ends)]
    return sorted([*kept, *ends])


def _changes(
    told: _Told,
    names: Sequence[str],
    moved: Callable[[Design, Term], Moved],
) -> tuple[Change, ...]:
    """Each moment at which what spans have of their own comes or goes.

    Args:
        told: what changes.
        names: of the recordings.
        moved: what a term moves in them.
    """
    found, spans, moments = told.found, told.spans, told.when
    assert found is not None
    made = found.fit.contrast.design
    # by number of the recording and joint
    out: dict[tuple[int, int], list[tuple[Candidate, Change]]] = {}
    # one change for each end of what the hypothesis holds: it comes, or it goes
    for one in found.fit.mine:
        number, start, _ = spans.place(one)

        def is_it(
            other: Candidate, term: Term = one.term, number: int = number
        ) -> bool:
            """The same term in the same recording, wherever it begins and ends."""
            mine = other.term == term and not other.everybody
            return mine and spans.place(other)[0] == number

        odds = found.odds[one]
        columns = moved(made, one.term)
        for k, moment in enumerate(moments[one]):
            # what ends takes its value away; what a stream always had has come
            comes = k == 0 and (np.isfinite(start) or spans.learnt is not None)
            change = Change(
                recording=names[number],
                time=moment.time,
                interval=moment.interval,
                term=one.term,
                value=found.fit.values[one] * (1.0 if comes else -1.0),
                deviation=found.fit.answer.deviations[one],
                probability=found.probabilities_of(is_it)[True],
                # log odds less prior odds is the evidence: over what the odds ask of it
                support=(found.log_odds(is_it) - odds) / -odds,
                columns=columns,
            )
            # a ramp may stand for several changes of a joint: these are kept together
            out.setdefault((number, one.term.joint), []).append((one, change))
    every: list[tuple[int, Change]] = []
    smeared = SMEARED / made.rows.cutoff
    for (number, _), some in out.items():
        changes = _at_once([change for _, change in some], smeared)
        parts = [one for one, _ in some]
        ramps = _gradual(found, number, parts, changes)
        first: dict[Term, float] = {}
        for one in dict.fromkeys(parts):
            # of what a stream has all along the begin is a change
            if np.isinf(spans.place(one)[1]) and spans.learnt is None:
                value = float(found.fit.values[one][0])
                first[one.term] = first.get(one.term, 0.0) + value
        every += [(number, one) for one in _of_before(ramps or changes, first)]
    every.sort(key=lambda pair: (pair[0], pair[1].time))
    return tuple(change for _, change in every)


def _at_once(changes: Sequence[Change], smeared: float) -> list[Change]:
    """Changes of a joint; those of a term that no filter can part, of a span's and of the next one's, are one.

    Args:
        changes: one for each end of what spans have of their own.
        smeared: moments that are closer are one [s].
    """
    out: list[Change] = []
    for change in sorted(changes, key=lambda c: c.time):
        last = next((c for c in reversed(out) if c.term == change.term), None)
        if last is None or change.time - last.time >= smeared:
            out.append(change)
            continue
        # when, by the larger of the two; how much, by both
        larger = max(last, change, key=lambda c: float(np.linalg.norm(c.value)))
        deviation = np.hypot(last.deviation, change.deviation)
        value = last.value + change.value
        whole = replace(larger, value=value, deviation=deviation)
        out[out.index(last)] = whole
    return out


def _of_before(
    changes: Sequence[Change], first: Mapping[Term, float]
) -> Iterator[Change]:
    """Changes, each of a factor as a share of the one before: (1 + s) becomes (1 + r) (1 + s).

    Args:
        changes: of a joint, of a factor by how much s changes.
        first: s at the begin of the recording.
    """
    before = dict(first)
    for change in sorted(changes, key=lambda c: c.time):
        if FACTOR not in change.term.definition.quantities.values():
            yield change
            continue
        was = 1.0 + before.get(change.term, 0.0)
        now = was + float(change.value[0])
        before[change.term] = now - 1.0
        # of 1 + r = now / was either may be the one that is not known
        std = change.deviation * max(1.0, abs(now / was)) / abs(was)
        yield replace(change, value=change.value / was, deviation=std)


def _gradual(
    found: Difference,
    number: int,
    parts: Sequence[Candidate],
    changes: Sequence[Change],
) -> list[Change]:
    """One even change in the place of those of a joint in a recording; nothing if it explains less.

    Several are replaced by a ramp of one term, or of all of them, that explains as much beside what the prior odds of
    each cost. Any is, if a ramp between any two moments is likelier than a change at once at any moment, by more than
    what a further parameter costs.

    Args:
        found: the hypothesis.
        number: of the recording.
        parts: what has something of its own in spans.
        changes: that it makes, each once.
    """
    fit = found.fit
    made, left = fit.contrast.design, fit.left
    rows, mine = made.rows, made.rows.recording == number
    variance = fit.contrast.error.noise2 + (left**2).mean(axis=0)
    # all steps put back: the ramp has to explain what they do together
    without = left.copy()
    for one in parts:
        there = np.isin(rows.group, one.groups or ())[:, None]
        without += made.torque(one.term, fit.values[one]) * there
    # a ramp pays once for a term, however many steps of it there are
    cost = {
        term: min(found.odds[one] for one in parts if one.term == term)
        for term in dict.fromkeys(one.term for one in parts)
    }
    # a change at once is told from a short ramp where it is thought to be
    moments = [change.time for change in changes]
    _, right, gram = _in_bins(made, mine, moments, without - left, without, variance)
    score = right.sum() ** 2 / max(float(gram.sum()), SMALLEST) / 2
    score += sum(cost[change.term] for change in changes)
    ramps: list[tuple[float, Ramp, list[Change]]] = []
    # a ramp of each term by itself, and one of all of them at once
    for terms in dict.fromkeys([*((term,) for term in cost), tuple(cost)]):
        likes = [_largest(term, changes, whole=len(terms) > 1) for term in terms]
        torques = [made.torque(like.term, like.value) for like in likes]
        moved = np.sum(torques, axis=0)
        own = _in_bins(made, mine, moments, moved, without, variance)
        # the filter makes a step as wide: a shorter ramp looks like one
        ramp = best_ramp(*own, 4 * SMEARED / rows.cutoff)
        if ramp is not None:
            # its end is one more parameter than a step has
            odds = sum(cost[term] for term in terms) + float(np.log(UNUSUAL))
            ramps.append((ramp.explained + odds, ramp, likes))
    if not ramps:
        return []
    best, ramp, likes = max(ramps, key=lambda one: one[0])
    if len(changes) > 1 and best < score:
        return []
    # one step of the same gives way only to ramps as a whole, whichever moments they have
    if ramp.mean + np.log(UNUSUAL) < ramp.at_once:
        return []
    return [
        replace(
            like,
            time=ramp.begin,
            interval=ramp.begins,
            until=ramp.end,
            value=ramp.share * like.value,
            deviation=np.abs(ramp.share) * like.deviation,
        )
        for like in likes
    ]


def _in_bins(
    made: Design,
    mine: np.ndarray,
    moments: Sequence[float],
    moved: np.ndarray,
    left: np.ndarray,
    variance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a torque explains of what is left in each bin of a recording, beside all that is shared.

    What was fitted beside changes at once has adapted to them.

    Args:
        made: the design.
        mine: rows of the recording, mask (M,).
        moments: at which a bin ends as well [s].
        moved, left: over the joints' scale [1], (M, n).
        variance: of what is left, (n,).

    Returns:
        Edges of the bins [s], (B + 1,), and the right sides, (B,), and normal matrix of their torques, (B, B) [nats].
    """
    t = made.rows.t
    even = np.linspace(t[mine].min(), t[mine].max(), WINDOW_EDGES)
    edges = np.unique([*even, *np.clip(moments, even[0], even[-1])])
    bins = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)
    inside = mine[:, None] & (bins[:, None] == np.arange(len(edges) - 1))
    right, gram = np.zeros(inside.shape[1]), np.zeros(2 * inside.shape[1:])
    for j in np.flatnonzero(moved.any(axis=0)):
        own = inside * moved[:, j, None]
        shared = shared_basis(made, j, float(variance[j]))
        beside = own - shared @ (shared.T @ own)
        right += beside.T @ left[:, j] / variance[j]
        gram += beside.T @ own / variance[j]
    return edges, right, gram


def _largest(term: Term, changes: Sequence[Change], whole: bool) -> Change:
    """The largest change of a term over its deviation, with the value of all of them together if that is asked."""
    own = [change for change in changes if change.term == term]
    largest = max(own, key=lambda c: float(np.abs(c.value / c.deviation).max()))
    if whole:
        return replace(largest, value=np.sum([c.value for c in own], axis=0))
    return largest


def _moved_by(made: Design, term: Term, names: Sequence[str]) -> Moved:
    """Times of rows, and the torque that each coordinate of a term makes there, by name of the recording."""
    rows, out = made.rows, {}
    units = [made.torque(term, unit) for unit in np.eye(len(term.columns))]
    torque = np.stack([rows.in_newton_metres(unit) for unit in units], axis=2)
    for k, name in enumerate(names):
        mine = rows.recording == k
        out[name] = rows.t[mine], torque[mine]
    return out


# Changes that take a while: a parameter that rises or falls evenly between two moments of a recording.
#
# The torque r that a recording has beside all else, of variance s^2, is taken as w(t) x d(t), with d the torque of a
# term and w 0 up to a moment a, 1 from a moment b on, and even in between. The likeliest x explains
#
#     G(a, b) = (sum w r d / s^2)^2 / (2 sum (w d)^2 / s^2)    [nats],
#
# sums over rows without what is shared, which r and w d are rid of.
#
# With a = b that is a change at once.


class Ramp(NamedTuple):
    """An even change.

    Attributes:
        begin, end: of it [s].
        begins: between which moments it begins with a probability of ``SURE`` [s].
        share: what it reaches, over the term's torque [1].
        explained: that is explained [nats].
        mean: evidence of a ramp between any two moments, each pair as likely [nats].
        at_once: the same of a change at once.
    """

    begin: float
    end: float
    begins: tuple[float, float]
    share: float
    explained: float
    mean: float
    at_once: float


def best_ramp(
    edges: np.ndarray,
    right: np.ndarray,
    gram: np.ndarray,
    shortest: float,
) -> Ramp | None:
    """The likeliest ramp of a term in a recording; ``None`` if none fits into it.

    Args:
        edges: of bins of it [s], (B + 1,).
        right: sum of r d / s^2 over the rows of each bin and all joints, (B,).
        gram: the same of d of one bin times d of another, beside what is shared, (B, B).
        shortest: a shorter ramp is none [s].
    """
    # pairs in the wrong order as well: their length sorts them out
    a, b = (x.ravel() for x in np.meshgrid(edges, edges))
    t = (edges[1:] + edges[:-1]) / 2
    gain, _ = _explained(t, right, gram, a, b)
    ramps = gain[b - a >= shortest]
    if not len(ramps):
        return None
    # at once, before each bin
    steps, _ = _explained(t, right, gram, edges[:-1], edges[:-1])
    of_ramps = np.where(b - a >= shortest, gain, -np.inf)
    width = np.diff(edges).max()
    # once more, about where it is likely to begin and to end
    likely = [_likely_within(moments, of_ramps) for moments in (a, b)]
    near = (np.linspace(x - width, y + width, WINDOW_EDGES) for x, y in likely)
    a, b = (x.ravel() for x in np.meshgrid(*near))
    longer = b - a >= shortest
    a, b = a[longer], b[longer]
    gain, share = _explained(t, right, gram, a, b)
    k = int(gain.argmax())
    low, high = _likely_within(a, gain)
    step = float(np.ptp(a)) / WINDOW_EDGES
    begins = low - step, high + step
    return Ramp(
        float(a[k]),
        float(b[k]),
        begins,
        float(share[k]),
        float(gain[k]),
        _mean(ramps),
        _mean(steps),
    )


def _explained(
    t: np.ndarray, right: np.ndarray, gram: np.ndarray, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """G of each pair of moments [nats], (K,), and the likeliest x, (K,)."""
    # at once is a ramp as steep as numbers can be
    length = np.maximum(b - a, np.finfo(float).eps)[:, None]
    w = np.clip((t - a[:, None]) / length, 0.0, 1.0)
    pull, weight = w @ right, ((w @ gram) * w).sum(axis=1)
    share = pull / np.maximum(weight, SMALLEST)
    return share * pull / 2, share


def _likely_within(moments: np.ndarray, gain: np.ndarray) -> tuple[float, float]:
    """Moments, (K,), between which one of the pairs of these log evidences lies with a probability of ``SURE`` [s]."""
    order = np.argsort(moments, kind="stable")
    likely = np.exp(gain - gain.max())[order].cumsum()
    ends = np.searchsorted(likely / likely[-1], [(1 - SURE) / 2, (1 + SURE) / 2])
    low, high = moments[order][np.minimum(ends, len(order) - 1)]
    return float(low), float(high)


def _mean(gain: np.ndarray) -> float:
    return float(np.logaddexp.reduce(gain) - np.log(len(gain)))


# Findings on what changed during a recording, as ``diagnosis.json`` holds them and in words.


PAYLOAD = of_quantity("load")[0].name
"""What a load on the last link is called, picked up or put down."""
LOAD = (
    ("mass", "kg"),
    ("first_moment_x", "kg m"),
    ("first_moment_y", "kg m"),
    ("first_moment_z", "kg m"),
)
"""Coordinates of a load that are told."""
FRICTION = {"damping": "viscous", "friction": "coulomb"}
"""Name of plain friction of a joint, by the quantity of the effect."""
PLAIN_FRICTION = "friction"


def change_findings(changes: Sequence[Change]) -> list[dict[str, Any]]:
    """Entries of ``changes``: what changed, in which recording, when, by how much."""
    out: list[dict[str, Any]] = []
    for entry in map(_finding, changes):
        # viscous and dry friction that change at one moment are told as one
        twin = next((other for other in out if _are_one(entry, other)), None)
        if twin is None:
            out.append(entry)
            continue
        twin["parameters"] |= entry["parameters"]
        # when, by whichever of the two says it more sharply
        if np.ptp(entry["interval"]) < np.ptp(twin["interval"]):
            twin |= {key: entry[key] for key in ("time", "interval", "until")}
    return out


def _are_one(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether both are plain friction of a joint that changes at one moment."""
    same = all(one[key] == other[key] for key in ("recording", "what", "joints"))
    low = max(one["interval"][0], other["interval"][0])
    high = min(one["interval"][1], other["interval"][1])
    new = not set(one["parameters"]) & set(other["parameters"])
    return one["what"] == PLAIN_FRICTION and same and low <= high and new


def called(term: Term) -> tuple[str, tuple[int, ...]]:
    """What a change of a term is called, and on which joints: plain friction together, a load by one name."""
    what = PLAIN_FRICTION if _friction(term) else term.effect
    if term.is_load:
        what = PAYLOAD
    return what, (term.joint,) if term.joint else ()


def _finding(change: Change) -> dict[str, Any]:
    what, joints = called(change.term)
    return {
        "recording": change.recording,
        "what": what,
        "effect": change.term.effect,
        "joints": list(joints),
        "time": change.time,
        "interval": list(change.interval),
        "until": change.until,
        "parameters": _parameters(change),
        "probability": change.probability,
        "times_threshold": change.support,
    }


def _friction(term: Term) -> str | None:
    """Name of plain friction; ``None`` of anything else."""
    quantities = term.definition.quantities.values()
    return next((FRICTION[q] for q in quantities if q in FRICTION), None)


def _parameters(change: Change) -> dict[str, dict[str, Any]]:
    """By how much each parameter changed, or what an effect has from then on, with its standard deviation."""
    value, deviations, term = change.value, change.deviation, change.term
    if term.is_load or _friction(term):
        unit = term.definition.parameters[0].unit
        names = LOAD if term.is_load else ((str(_friction(term)), unit),)
        coordinates = zip(names, value.tolist(), deviations.tolist(), strict=False)
        return {
            name: {"unit": unit, "value": x, "std": std}
            for (name, unit), x, std in coordinates
        }
    middle = _values(change, value)
    # each coordinate by a deviation up, and down
    steps = [
        (_values(change, value + step), _values(change, value - step))
        for step in np.diag(deviations)
    ]
    out, times = {}, term.parametrisation.nonlinear
    for parameter in term.definition.parameters:
        name = parameter.name
        # the number of a link is no value, and when a force acts is said already
        if name not in middle or name in times:
            continue
        # half the way between both sides: a law need not be linear in its coordinates
        half = [(up[name] - down[name]) / 2 for up, down in steps]
        both = middle[name], np.sqrt((np.array(half) ** 2).sum(axis=0))
        x, std = (v.tolist() if len(v) > 1 else float(v[0]) for v in both)
        out[name] = {"unit": parameter.unit, "value": x, "std": std}
    return out


def _values(change: Change, value: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters by the term's coordinates, (linear,)."""
    fitted = change.term.parametrisation
    given = fitted.values(value[:, None], np.zeros((len(fitted.nonlinear), 1)))
    return {name: np.ravel(np.asarray(x, dtype=float)) for name, x in given.items()}


def change_text(entry: Mapping[str, Any]) -> str:
    """A finding in words: ``load of 1.50 ± 0.01 kg picked up at 3.70 s of recording_1.csv``."""
    # documents written before changes could take a while have none
    when = f"{when_text(entry['time'], entry.get('until'))} of {entry['recording']}"
    if entry["what"] == PAYLOAD:
        mass = entry["parameters"]["mass"]
        done = "picked up" if mass["value"] > 0 else "put down"
        size = f"{uncertain(abs(mass['value']), mass['std'])} kg"
        return f"load of {size} {done} {when}"
    return f"{named_text(entry)} changed {when}: {size_text(entry, ' by')}"


def named_text(entry: Mapping[str, Any]) -> str:
    """What a finding is of, and where: ``friction of joint 2``."""
    plain = entry["what"] == PLAIN_FRICTION
    name = PLAIN_FRICTION if plain else effect_name(entry["what"])
    joints = entry["joints"]
    return f"{name} of joint {joints[0]}" if joints else name


def size_text(entry: Mapping[str, Any], by: str = "") -> str:
    """The numbers of a finding: ``coulomb 0.31 ± 0.01 N m``."""
    sizes = []
    for name, part in entry["parameters"].items():
        values, stds = np.ravel(part["value"]), np.ravel(part["std"])
        each = [uncertain(*pair) for pair in zip(values, stds, strict=True)]
        size = each[0] if len(each) == 1 else f"({', '.join(each)})"
        sizes.append(f"{name}{by} {size} {part['unit']}".removesuffix(" 1"))
    return ", ".join(sizes)
