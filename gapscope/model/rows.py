"""Rows of groups of recordings: what a contrast compares, on decimated samples of one band."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import STILL, Recording
from gapscope.model.conditioning import (
    LARGEST_CUTOFF,
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
    pieces,
    position_cutoff,
    thinned,
    torque_scale,
)
from gapscope.model.terms import Term

# Segments and the rows that are taken of them: filtered, trimmed, decimated to about twice the filter's cut-off.


PER_CUTOFF = 2.5
"""Rows a second over the cut-off of their filter, and samples over that of positions, at least [1]: what a filter
leaves lies well below half of it."""
MODEL_RATE = PER_CUTOFF * LARGEST_CUTOFF
"""Rate at which columns are computed before they are filtered [Hz]."""
UNMEASURED = 1e-3
"""Weight of a row whose torque was not measured [1]: not zero, as each half of a recording needs some rows."""


class DecimatedSegments:
    """Segments, and their series on decimated rows.

    Attributes:
        segments: the segments.
        cutoff: cut-off of the filter [Hz].
    """

    def __init__(self, segments: list[Segment], cutoff: float) -> None:
        self.segments, self.cutoff = segments, cutoff

    def thin(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        """Series of a segment, filtered, trimmed, and decimated to about twice the filter's cut-off."""
        flat, rate = series.reshape(len(series), -1), segment.motion.rate
        # most columns of the first links are zero: filtering them costs as much
        present = flat.any(axis=0)
        rows = low_pass(flat[:, present], rate, self.cutoff)[self.taken(segment)]
        out = np.zeros((len(rows), flat.shape[1]))
        out[:, present] = rows
        return out.reshape(len(rows), *series.shape[1:])

    def filtered(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        """The same at the rate of the segment."""
        every = low_pass(series, segment.motion.rate, self.cutoff)
        return every[self.inner(segment)]

    def inner(self, segment: Segment) -> slice:
        """The samples of a segment that count."""
        return segment.inner

    def taken(self, segment: Segment) -> slice:
        """Those of them that are its rows."""
        inner = self.inner(segment)
        return slice(inner.start, inner.stop, self.step(segment))

    def rows(self, series: Iterable[np.ndarray]) -> np.ndarray:
        """Series of every segment, (N, ...) each, on its rows, one below the other, (M, ...)."""
        pairs = zip(series, self.segments, strict=True)
        return np.vstack([self.thin(x, s) for x, s in pairs])

    def step(self, segment: Segment) -> int:
        """Every how many samples the rows are taken."""
        return max(1, int(segment.motion.rate // (PER_CUTOFF * self.cutoff)))

    def time(self, segment: Segment) -> np.ndarray:
        """Time of a segment's rows by the clock of its recording [s], (M,)."""
        return segment.motion.t[self.taken(segment)]


# Rows of groups of recordings.


MIN_MOTIONS = 4
"""Parts of a group at least, each of which counts as a motion of its own: one motion says nothing of another."""
SAME_STATE = 0.1
"""States closer than this share of the deviation of positions, velocities and accelerations are passed again [1]: less
than what changes friction or gravity, more than what a controller misses its reference by."""
SAME_SHARE = 0.9
"""A segment has no motion of its own if this share of its rows passes through states that were passed before [1]."""
LOOKS = 128
"""Times that a group is looked back upon: what is passed twice between two is not seen. (budget)"""


class PartOfDesign(NamedTuple):
    """What a design takes of a segment, on its rows, M of n joints, before scales and units.

    Attributes:
        terms: columns of the terms [N m] per unit, (M, n, P).
        inertial: of the inertial parameters, as their torque is recorded [N m], (M, n, 10 n).
        force: of a force on the tip [N m/N], (M, n, 3).
        gap: of the arm that predicts [N m], (M, n).
    """

    terms: np.ndarray
    inertial: np.ndarray
    force: np.ndarray
    gap: np.ndarray


class Kept(NamedTuple):
    """What a design takes of segments, kept from one design to the next.

    Attributes:
        about: the arm that it is about, the same object.
        parts: by identity of a segment the segment, which so stays alive, and what is taken of it.
    """

    about: object
    parts: dict[int, tuple[Segment, PartOfDesign]]


class Rows(DecimatedSegments):
    """Rows of groups of recordings with a torque, M in all, of n joints.

    Args:
        groups: the segments of each recording of each group.
        cutoff: of the positions [Hz].
        taught: recordings, by their number in the order of groups, that teach something: the first so many.

    Attributes:
        group, recording, segment: numbers of the group, of the recording and of the segment of each row, (M,).
        source: number of the recording by its name, (M,): that a stream is of many shows what another motion misses.
        set_aside: which rows are set aside, mask (M,).
        group_of: number of the group of each segment.
        motion: number of the motion of each row, (M,): one that comes again in a group keeps its number.
        torque: recorded [N m], (M, n).
        trust: square root of the weight of each row, (M, n): 1 unless its torque was not measured, or dry friction
            holds the joint.
        measured: the same but for friction, (M, n).
        sticking: RMS of what dry friction hides at rest, over the joint's scale [1], (M, n).
        hides: the same where it holds the joint, and 0 elsewhere.
        scale: normalisation of the torque gap over all rows of the first group [N m], (n,).
        t: time by the recording's own clock [s], (M,).
        position, velocity: [rad], [rad/s], (M, n).
        holding: what ``held`` was told.
        kept: what the last design, about some arm, took of segments.
        first_columns: of terms with a searched value, what follows from the recordings alone, as ``nonlinear_values``
            finds it: the same whatever the groups are.
        parted: whether the groups are spans of recordings.
        warmth: temperature of the joints over its mean [K], (M, n), if friction is to follow it.
    """

    def __init__(
        self,
        groups: Sequence[Sequence[Sequence[Segment]]],
        cutoff: float,
        taught: int,
    ) -> None:
        segments: list[Segment] = []
        self.group_of, of_recording, count = [], [], 0
        for number, recordings in enumerate(groups):
            for own in recordings:
                segments += own
                self.group_of += [number] * len(own)
                of_recording += [count] * len(own)
                count += 1
        # the torque gap is defined up to its own cut-off
        super().__init__(segments, min(TORQUE_CUTOFF, cutoff))
        self.kept: Kept | None = None
        self.parted = False
        self.warmth: np.ndarray | None = None
        self.first_columns: dict[Term, np.ndarray | None] = {}
        counts = [len(self.time(s)) for s in segments]
        self.recording = np.repeat(of_recording, counts)
        # a stream has many recordings in one
        every = [(k, s.recording) for k, s in zip(of_recording, segments, strict=True)]
        names = list(dict.fromkeys(every))
        self.source = np.repeat([names.index(one) for one in every], counts)
        self.segment = np.repeat(np.arange(len(segments)), counts)
        self.group = np.repeat(self.group_of, counts)
        self.set_aside = self.recording >= taught
        # straight lines over what was not measured: filters would spread it
        self.torque = self.rows([s.bridged(s.recorded_torque) for s in segments])
        known = np.vstack([s.measured[self.taken(s)] for s in segments])
        self.measured = np.sqrt(np.where(known, 1.0, UNMEASURED))
        self.trust = self.measured
        self.sticking = self.hides = np.zeros_like(self.trust)
        # groups that follow count in the torque of the first
        self.scale = torque_scale(self.torque[self.group == 0])
        self.t = np.concatenate([self.time(s) for s in segments])
        self._move_as(segments)
        self.motion = self._motions()

    @classmethod
    def recorded(
        cls,
        groups: Sequence[Sequence[Recording]],
        set_aside: Sequence[Recording] = (),
    ) -> Rows:
        """Rows of recordings.

        Args:
            groups: recordings of each group; a recording that is listed again counts once.
            set_aside: further recordings of the last group, which are predicted and teach nothing.

        Raises:
            InputError: a recording has no stretch without gaps that is long enough.
        """
        groups = [listed_once(recordings) for recordings in groups]
        taught = sum(len(recordings) for recordings in groups)
        groups[-1] = [*groups[-1], *(r for r in set_aside if r.tau is not None)]
        cutoff = position_cutoff(tuple(r for group in groups for r in group))
        own = [[_segments(recording) for recording in group] for group in groups]
        return cls(own, cutoff, taught)

    def regrouped(self, group: np.ndarray, least: int, left_out: np.ndarray) -> Rows:
        """The same rows in spans of recordings, each a group.

        Args:
            group: number of the group of each row, (M,).
            least: parts of a group at least, each of which counts as a motion of its own.
            left_out: rows that say nothing, mask (M,).
        """
        # arrays of rows are replaced, so that other groupings keep theirs
        other = copy(self)
        other.group, other.parted = group, True
        other.motion = other._motions(least)
        # by weight zero, not removed: rows keep their numbers
        other.measured = np.where(left_out[:, None], 0.0, self.measured)
        other.trust = np.where(left_out[:, None], 0.0, self.trust)
        return other

    def moved_as(self, recordings: Sequence[Recording]) -> Rows | None:
        """The same rows with the motions of others in the place of those that teach; ``None`` if lengths differ."""
        segments = [s for recording in recordings for s in _segments(recording)]
        # what is set aside comes last, and keeps its motion
        segments += self.segments[len(segments) :]
        lengths = [len(self.time(s)) for s in segments]
        if lengths != [len(self.time(s)) for s in self.segments]:
            return None
        other = copy(self)
        other.segments, other.kept, other.first_columns = segments, None, {}
        other._move_as(segments)
        return other

    def _move_as(self, segments: Sequence[Segment]) -> None:
        """Take the states of segments at their rows, as they are."""
        motions = [(s.motion, self.taken(s)) for s in segments]
        self.position = np.vstack([m.q[rows] for m, rows in motions])
        self.velocity = np.vstack([m.dq[rows] for m, rows in motions])

    def follow_temperature(self) -> None:
        """Let friction follow the temperature of its joint, if all recordings have it."""
        given = [s.temperature for s in self.segments if s.temperature is not None]
        if len(given) == len(self.segments):
            warmth = self.rows(given)
            self.warmth = warmth - warmth.mean(axis=0)

    def in_newton_metres(self, share: np.ndarray) -> np.ndarray:
        """Torque [N m], (M, n), from its share of the joints' scale on rows by trust; 0 on rows that are left out."""
        # friction hides rows from a fit, not from a person who looks at the torque
        weight = self.measured / np.where(self.trust > 0, self.trust, 1.0)
        return np.asarray(share * weight * self.scale)

    def of(self, group: int) -> np.ndarray:
        """Which rows belong to a group, mask (M,)."""
        return np.asarray(self.group == group)

    def held(
        self, friction: np.ndarray, noise: np.ndarray, per_radian: np.ndarray
    ) -> None:
        """Trust rows less on which dry friction holds a joint: there it takes any value, one in each stop.

        Args:
            friction: dry friction of the joints [N m], (n,).
            noise: what a model leaves of their torque, over their scale [1], (n,).
            per_radian: what counts as a radian of each joint, (n,).
        """
        self.holding = friction, noise, per_radian
        # of a smoothed direction s the share sqrt(1 - s^2) is not known
        # and all of it of a joint that rests: what it swings by bends its friction
        direction = [
            smooth_sign(s.motion.dq / per_radian)
            * (np.ptp(s.motion.q, axis=0) >= STILL * per_radian)
            for s in self.segments
        ]
        share = self.rows([np.sqrt(1.0 - s**2) for s in direction])
        self.sticking = np.abs(friction / self.scale * share)
        hidden = self.sticking / noise
        self.hides = np.where(hidden > 1, self.sticking, 0.0)
        # sigma^2 / (sigma^2 + n u^2): the n rows of a stop tell one unknown value
        self.trust = self.measured / np.sqrt(1.0 + self._stop(hidden > 1) * hidden**2)

    def _stop(self, stopped: np.ndarray) -> np.ndarray:
        """Rows of the stop to which each row belongs, of stopped rows, mask (M, n); 1 of all others, (M, n)."""
        count = np.ones(stopped.shape)
        for j, mine in enumerate(stopped.T):
            # a stop ends with its segment
            begins = np.diff(mine, prepend=False) | (
                np.diff(self.segment, prepend=0) > 0
            )
            stop = np.cumsum(begins)
            count[mine, j] = np.bincount(stop)[stop[mine]]
        return count

    def part_of_motion(self, count: int) -> np.ndarray:
        """Number of the part of its motion in which each row lies, of parts of equal length, (M,)."""
        out = np.empty(len(self.motion), dtype=int)
        for cell in np.unique(np.column_stack([self.motion, self.segment]), axis=0):
            rows = np.flatnonzero((self.motion == cell[0]) & (self.segment == cell[1]))
            out[rows] = np.arange(len(rows)) * count // len(rows)
        return out

    def _motions(self, least: int = MIN_MOTIONS) -> np.ndarray:
        """Numbers of the motions, (M,): parts of what a group passes for the first time, and all that repeats them."""
        every = [s.motion.ddq[self.taken(s)] for s in self.segments]
        faster = np.vstack(every)
        state = over_deviation(np.hstack([self.position, self.velocity, faster]))
        motion, count = np.empty(len(state), dtype=int), 0
        kinds = np.column_stack([self.group, self.set_aside])
        # from the calmest recording on: in which order they are listed says nothing of the arm
        speed = state[:, self.position.shape[1] :]
        total = np.bincount(self.recording, (speed**2).sum(axis=1))
        lively = total / np.maximum(np.bincount(self.recording), 1)
        # groups share no motion, nor does what is set aside with what teaches
        for kind in np.unique(kinds, axis=0):
            rows = np.flatnonzero((kinds == kind).all(axis=1))
            rows = rows[np.argsort(lively[self.recording[rows]], kind="stable")]
            # segments by numbers that rise with that
            begins = np.diff(self.segment[rows], prepend=-1) != 0
            segment = np.cumsum(begins)
            first = _first_passed(state[rows], segment)
            new = np.flatnonzero(first == np.arange(len(rows)))
            for number in np.unique(segment[new]):
                own = new[segment[new] == number]
                # parts by its share of what is new, so that all are about alike
                pieces = max(1, round(least * len(own) / len(new)))
                for piece in np.array_split(own, pieces):
                    motion[rows[piece]] = count
                    count += 1
            # what passes a state again belongs to the motion that passed it first
            motion[rows] = motion[rows[first]]
        return motion


def over_deviation(series: np.ndarray) -> np.ndarray:
    """Series over their deviation, (M, d); those that hardly differ over next to nothing."""
    return np.asarray(series / np.maximum(series.std(axis=0), 1e-9))


def _segments(recording: Recording) -> list[Segment]:
    """Segments of a recording at the rate at which columns are computed."""
    return [thinned(segment, MODEL_RATE) for segment in condition(recording)]


def _first_passed(state: np.ndarray, segment: np.ndarray) -> np.ndarray:
    """Number of the row that passed a row's state first, (M,): its own if none did.

    Args:
        state: over its deviation, (M, d).
        segment: number of the segment of each row, (M,).
    """
    first = np.arange(len(state))
    # a row that passes between two others may be half a step off
    step = np.linalg.norm(np.diff(state, axis=0, append=state[-1:]), axis=1)
    step[np.flatnonzero(np.diff(segment))] = 0.0
    reach = SAME_STATE * np.sqrt(state.shape[1])
    new: np.ndarray = np.zeros(0, dtype=int)
    for number in np.unique(segment):
        own = np.flatnonzero(segment == number)
        begin = len(new)
        for piece in np.array_split(own, max(1, LOOKS * len(own) // len(state))):
            if not len(new):
                new = piece
                continue
            near = np.hypot(reach, step[piece] / 2)
            # a tree that looks no farther is several times as fast
            most = 1.001 * near.max(initial=0.0)
            distance, place = _nearest(state[new], state[piece], most)
            near = distance <= near
            first[piece[near]] = new[place[near]]
            new = np.concatenate([new, piece[~near]])
        # a remainder is no motion of its own
        rest = new[begin:]
        if begin and len(rest) <= (1.0 - SAME_SHARE) * len(own):
            new = new[:begin]
            first[rest] = new[_nearest(state[new], state[rest], np.inf)[1]]
            first[own] = first[first[own]]
    return first


def _nearest(
    among: np.ndarray, states: np.ndarray, most: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the nearest of some states, and which it is; one farther than ``most`` need not be found."""
    # of few states a table is faster than a tree
    if len(among) <= LOOKS:
        distance = cdist(states, among)
        return distance.min(axis=1), distance.argmin(axis=1)
    distance, place = cKDTree(among).query(states, distance_upper_bound=most)
    return distance, place


def listed_once(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with a torque, without those that repeat another one to the last digit."""
    kept: list[Recording] = []
    for recording in recordings:
        if recording.tau is None or any(_same(recording, other) for other in kept):
            continue
        kept.append(recording)
    return kept


def comparable(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """The recordings that can be compared: with a torque, each once, and a stretch that is long enough."""
    return tuple(r for r in listed_once(recordings) if pieces(r))


def _same(one: Recording, other: Recording) -> bool:
    torques = np.asarray(one.tau), np.asarray(other.tau)
    return np.array_equal(one.q, other.q) and np.array_equal(*torques)
