"""What changes during recordings: which parameter, in which recording, at what moment, by how much.

Every recording is split into spans, each a group of the contrast (``difference.py``). A change is a value that the
spans of a recording from some moment on, or up to it, have of their own, beside all that the others share and what each
motion has of its own. Moments join one by one: spans of equal length show about where one lies, then the torque of the
change says when,

    p(tau) ~ exp(-1/2 sum_(t < tau) r^2 / s^2 - 1/2 sum_(t >= tau) (r - d)^2 / s^2),

with r the residual without the change, d what it does to the torque, and s^2 the variance of the noise and of what is
left. With spans that end there, all terms are asked again. A recording that differs from its first sample on is in
another state than the others; that is no change during it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.model.design import fitted_arm
from gapscope.model.difference import Difference, Fit, Search, in_a_row
from gapscope.model.rows import LEAST_MOTIONS, Rows
from gapscope.model.terms import Candidate, Term

SPANS = 8
"""Spans of a recording by which a moment is looked for. (budget)"""
PARTS = 3
"""Motions of each of them at least. (budget)"""
SMEARED = 1.0
"""Rows within so many periods of the band's cut-off of a moment are left out [1]: there a filter sees both sides, and
the reading of an encoder that slips has no velocity. (physical)"""
MOST_MOMENTS = 6
"""Moments of a case. (budget)"""
SURE = 0.95
"""Probability that a moment is within its interval. (definition)"""


@dataclass(frozen=True)
class Moment:
    """When something changes.

    Attributes:
        recording: its number.
        time: likeliest moment, since the start of the recording [s].
        interval: in which it lies with a probability of ``SURE`` [s].
    """

    recording: int
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
        t: times of rows of the recording [s], (M,).
        columns: torque of each coordinate there, one of each joint [N m], (M, n, linear).
    """

    recording: str
    time: float
    interval: tuple[float, float]
    term: Term
    value: np.ndarray
    deviation: np.ndarray
    probability: float
    support: float
    t: np.ndarray
    columns: np.ndarray

    def __str__(self) -> str:
        """What changes when, in a few words."""
        where = f" of joint {self.term.joint}" * bool(self.term.joint)
        return f"{self.term.effect}{where} at {self.time:.2f} s of {self.recording}"


class _Spans:
    """Spans of R recordings between times: groups of rows, and sets of them that may have one value.

    Args:
        rows: each recording a group.
        ends: per recording the times at which a span ends [s], rising.
        parts: motions of each span at least.
        smeared: time on both sides of an end of which the rows are left out [s].
    """

    def __init__(
        self,
        rows: Rows,
        ends: Sequence[Sequence[float]],
        parts: int = LEAST_MOTIONS,
        smeared: float = 0.0,
    ) -> None:
        kept = [
            _between(rows.t[rows.recording == number], some)
            for number, some in enumerate(ends)
        ]
        self.ends = [np.array([-np.inf, *some, np.inf]) for some in kept]
        first = np.cumsum([0, *(len(some) + 1 for some in kept)]).tolist()
        self.groups = [list(range(a, b)) for a, b in pairwise(first)]
        group, left_out = rows.group.copy(), np.zeros(len(rows.group), dtype=bool)
        for number, some in enumerate(kept):
            mine = rows.recording == number
            group[mine] = first[number] + np.searchsorted(some, rows.t[mine])
            for end in some:
                left_out |= mine & (np.abs(rows.t - end) < smeared)
        self.rows = rows.regrouped(group, parts, left_out)

    def search(
        self, arm: NominalArm, sets: Sequence[tuple[int, ...]], asked: int
    ) -> Search:
        """The search for what sets of spans have of their own, of ``asked`` that there might be."""
        every = tuple(range(self.groups[-1][-1] + 1))
        free = fitted_arm(self.rows, arm, every)
        return Search(self.rows, free, sets, every, 0.0, every, asked)

    def sets(
        self, known: Sequence[Sequence[float]] | None = None
    ) -> list[tuple[int, ...]]:
        """Spans of a recording in a row, and all of one that is not the first.

        Args:
            known: per recording the times of moments [s]: rows that begin and end elsewhere are left out.
        """
        out = []
        for number, some in enumerate(self.groups):
            ends = self.ends[number]
            for row in in_a_row(len(some)):
                sides = {float(ends[row[0]]), float(ends[row[-1] + 1])}
                if known is None or sides & {-np.inf, np.inf, *known[number]}:
                    out.append(tuple(some[k] for k in row))
            if number:
                out.append(tuple(some))
        return out

    def place(self, one: Candidate) -> tuple[int, float, float]:
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

    def candidate(self, term: Term, place: tuple[int, float, float]) -> Candidate:
        """A term with a value of its own between the ends nearest to two times of a recording."""
        number, *times = place
        ends, groups = self.ends[number], np.array(self.groups[number])
        within = ends[1:-1]
        start, end = (
            float(within[np.argmin(np.abs(within - t))]) if np.isfinite(t) else t
            for t in times
        )
        inside = (ends[:-1] >= start) & (ends[1:] <= end)
        return Candidate(term, tuple(groups[inside].tolist()))

    def moments(self, fit: Fit, one: Candidate) -> list[Moment]:
        """When a candidate begins and ends, each time between the ends before and after it."""
        number, start, end = self.place(one)
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
        shared, _ = fit.own.nuisances(values)
        left = fit.contrast.gap - fit.own.torque(values)
        for j, active in enumerate(made.active):
            left[:, j] -= made.columns[j] @ shared[active]
        moved = made.torque(one.term, values[one])
        without = left + moved * np.isin(rows.group, one.groups or ())[:, None]
        variance = fit.contrast.error.noise2 + (left**2).mean(axis=0)
        ends = self.ends[number]
        k = int(np.argmin(np.abs(ends - time)))
        here = (rows.t > ends[k - 1]) & (rows.t <= ends[k + 1])
        mine = np.flatnonzero((rows.recording == number) & here)
        off, on = (
            (r[mine] ** 2 / variance).sum(axis=1) / 2
            for r in (without, without - moved)
        )
        # between two rows: each side has some
        cost = np.cumsum(off - on if begins else on - off)[:-1]
        likely = np.exp(cost.min() - cost)
        total = np.cumsum(likely) / likely.sum()
        t = rows.t[mine]
        between = (t[1:] + t[:-1]) / 2
        # the filter sees about a row to both sides
        step = float(np.median(np.diff(t)))
        first, last = np.searchsorted(total, [(1 - SURE) / 2, (1 + SURE) / 2])
        interval = float(between[first]) - step, float(between[last]) + step
        return Moment(number, float(between[np.argmin(cost)]), interval)


def changes_of(
    recordings: Sequence[Recording],
    arm: NominalArm,
    progress: Callable[[str], None] = lambda message: None,
) -> tuple[Change, ...]:
    """What changes during recordings that have a torque, in the order of recordings and moments.

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """
    if not recordings:
        return ()
    rows = Rows([[recording] for recording in recordings])
    times = [rows.t[rows.recording == k] for k in range(len(recordings))]
    grid = [np.quantile(t, np.arange(1, SPANS) / SPANS) for t in times]
    smeared = SMEARED / rows.cutoff
    ends: list[list[float]] = [[] for _ in recordings]
    spans, found = _Spans(rows, ends), None
    moments: list[list[Moment]] = []
    while True:
        looked = _Spans(rows, list(map(_apart, grid, ends)), PARTS)
        sets = looked.sets(ends)
        mine: list[Candidate] = found.fit.mine if found else []
        known = [looked.candidate(one.term, spans.place(one)) for one in mine]
        fit, step = looked.search(arm, sets, len(sets)).step(known)
        moments = [looked.moments(fit, one) for one in known]
        if step is None or sum(map(len, ends)) >= MOST_MOMENTS:
            break
        one = step.mine[-1]
        tried, new = [list(some) for some in ends], []
        for moment in looked.moments(step, one):
            own = tried[moment.recording]
            if moment.time not in own:
                new.append((moment.recording, moment.time))
                tried[moment.recording] = sorted([*own, moment.time])
        progress("asks what changed")
        split = _Spans(rows, tried, smeared=smeared)
        likely = [
            split.candidate(other.term, looked.place(other)) for other in (*known, one)
        ]
        larger = split.search(arm, split.sets(), len(sets)).run(likely)
        places = [split.place(other) for other in larger.fit.mine]
        used = {(number, time) for number, *times in places for time in times}
        # also one that is not within a recording is looked for once
        if not used & set(new) and len(places) <= len(mine):
            break
        found, spans, ends = larger, split, tried
    return _changes(found, spans, moments, recordings) if found else ()


def _between(t: np.ndarray, ends: Sequence[float]) -> list[float]:
    """Ends that have rows at times t, rising, on both sides: of those between the same two rows the first."""
    place = np.searchsorted(t, ends)
    _, first = np.unique(place, return_index=True)
    return [ends[k] for k in first.tolist() if 0 < place[k] < len(t)]


def _apart(grid: np.ndarray, ends: Sequence[float]) -> list[float]:
    """Times of a grid and of the moments that are known, none closer to a moment than half a span."""
    half = float(np.diff(grid).mean()) / 2
    kept = [t for t in grid.tolist() if all(abs(t - end) > half for end in ends)]
    return sorted([*kept, *ends])


def _changes(
    found: Difference,
    spans: _Spans,
    moments: Sequence[Sequence[Moment]],
    recordings: Sequence[Recording],
) -> tuple[Change, ...]:
    """Each moment at which what spans have of their own comes or goes."""
    rows, made = spans.rows, found.fit.contrast.design
    out = []
    for one, own in zip(found.fit.mine, moments, strict=True):
        number, start, _ = spans.place(one)

        def is_it(
            other: Candidate, term: Term = one.term, number: int = number
        ) -> bool:
            """The same term in the same recording, wherever it begins and ends."""
            mine = other.term == term and not other.everybody
            return mine and spans.place(other)[0] == number

        odds = found.odds[one]
        units = [made.torque(one.term, unit) for unit in np.eye(len(one.term.columns))]
        mine = rows.recording == number
        zero = float(recordings[number].t[0])
        for k, moment in enumerate(own):
            low, high = moment.interval
            comes = np.isfinite(start) and k == 0
            change = Change(
                recording=recordings[number].name,
                time=zero + moment.time,
                interval=(zero + low, zero + high),
                term=one.term,
                value=found.fit.values[one] * (1.0 if comes else -1.0),
                deviation=found.fit.answer.deviation(one),
                probability=found.probabilities_of(is_it)[True],
                support=(found.log_odds(is_it) - odds) / -odds,
                t=zero + rows.t[mine],
                columns=np.stack(units, axis=2)[mine],
            )
            out.append((number, change))
    return tuple(c for _, c in sorted(out, key=lambda pair: (pair[0], pair[1].time)))
