"""Rows of groups of recordings: what a contrast compares, on decimated samples of one band."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import Recording
from gapscope.model.candidate_columns import CandidateColumns
from gapscope.model.conditioning import (
    LARGEST_CUTOFF,
    TORQUE_CUTOFF,
    Segment,
    condition,
    pieces,
    position_cutoff,
    thinned,
)
from gapscope.model.decimated_segments import DecimatedSegments
from gapscope.model.torque_gap import torque_scale

MODEL_RATE = 2.5 * LARGEST_CUTOFF
"""Rate at which columns are computed before they are filtered [Hz]: what is left of positions lies well below half."""
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
        set_aside: which rows are set aside, mask (M,).
        group_of: number of the group of each segment.
        motion: number of the motion of each row, (M,): one that comes again in a group keeps its number.
        torque: recorded [N m], (M, n).
        trust: square root of the weight of each row, (M, n): 1 unless its torque was not measured, or dry friction
            holds the joint.
        measured: the same but for friction, (M, n).
        sticking: RMS of what dry friction hides at rest, over the joint's scale [1], (M, n).
        scale: normalisation of the torque gap over all rows of the first group [N m], (n,).
        t: time since the start of the recording [s], (M,).
        position, velocity: [rad], [rad/s], (M, n).
        holding: what ``held`` was told.
        kept: what the last design, about some arm, took of segments.
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
        super().__init__(segments, min(TORQUE_CUTOFF, cutoff))
        self.kept: Kept | None = None
        self.warmth: np.ndarray | None = None
        self._candidates: list[CandidateColumns] = []
        self.bodies = []
        counts = [len(self.time(s)) for s in segments]
        self.recording = np.repeat(of_recording, counts)
        self.segment = np.repeat(np.arange(len(segments)), counts)
        self.group = np.repeat(self.group_of, counts)
        self.set_aside = self.recording >= taught
        self.torque = self.rows([_torque(s) for s in segments])
        self.measured = np.sqrt(np.vstack([self.known(s) for s in segments]))
        self.trust = self.measured
        self.sticking = np.zeros_like(self.trust)
        self.scale = torque_scale(self.torque[self.group == 0])
        self.t = np.concatenate([self.time(s) for s in segments])
        self.position = np.vstack([self._kept(s.motion.q, s) for s in segments])
        self.velocity = np.vstack([self._kept(s.motion.dq, s) for s in segments])
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
        """The same rows in other groups.

        Args:
            group: number of the group of each row, (M,).
            least: parts of a group at least, each of which counts as a motion of its own.
            left_out: rows that say nothing, mask (M,).
        """
        other = copy(self)
        other.group = group
        other.motion = other._motions(least)
        other.measured = np.where(left_out[:, None], 0.0, self.measured)
        other.trust = np.where(left_out[:, None], 0.0, self.trust)
        return other

    def moved_as(self, recordings: Sequence[Recording]) -> Rows | None:
        """The same rows with the motions of others in the place of those that teach; ``None`` if lengths differ."""
        segments = [s for recording in recordings for s in _segments(recording)]
        segments += self.segments[len(segments) :]
        lengths = [len(self.time(s)) for s in segments]
        if lengths != [len(self.time(s)) for s in self.segments]:
            return None
        other = copy(self)
        other.segments, other.bodies, other.kept = segments, [], None
        other._candidates = []
        other.position = np.vstack([self._kept(s.motion.q, s) for s in segments])
        other.velocity = np.vstack([self._kept(s.motion.dq, s) for s in segments])
        return other

    def _kept(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        """Series of a segment at its rows, as it is."""
        inner = segment.inner
        return series[inner.start : inner.stop : self.step(segment)]

    def follow_temperature(self) -> None:
        """Let friction follow the temperature of its joint, if all recordings have it."""
        given = [s.temperature for s in self.segments if s.temperature is not None]
        if len(given) == len(self.segments):
            warmth = self.rows(given)
            self.warmth = warmth - warmth.mean(axis=0)

    def candidates(self, per_radian: np.ndarray) -> CandidateColumns:
        """Columns of what a search tries that follow from the recordings alone, whatever the groups are.

        Args:
            per_radian: what counts as a radian of each joint, (n,).
        """
        # regrouped rows share the list
        if not self._candidates:
            self._candidates.append(CandidateColumns(self, per_radian))
        return self._candidates[0]

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
        direction = [smooth_sign(s.motion.dq / per_radian) for s in self.segments]
        share = self.rows([np.sqrt(1.0 - s**2) for s in direction])
        self.sticking = np.abs(friction / self.scale * share)
        hidden = self.sticking / noise
        self.trust = self.measured / np.sqrt(1.0 + self._stop(hidden > 1) * hidden**2)

    def _stop(self, stopped: np.ndarray) -> np.ndarray:
        """Rows of the stop to which each row belongs, of stopped rows, mask (M, n); 1 of all others, (M, n)."""
        count = np.ones(stopped.shape)
        for j, mine in enumerate(stopped.T):
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
        faster = np.vstack([self._kept(s.motion.ddq, s) for s in self.segments])
        every = (self.position, self.velocity, faster)
        state = np.hstack([x / np.maximum(x.std(axis=0), 1e-9) for x in every])
        motion, count = np.empty(len(state), dtype=int), 0
        kinds = np.column_stack([self.group, self.set_aside])
        for kind in np.unique(kinds, axis=0):
            rows = np.flatnonzero((kinds == kind).all(axis=1))
            segment = self.segment[rows]
            first = _first_passed(state[rows], segment)
            new = np.flatnonzero(first == np.arange(len(rows)))
            for number in np.unique(segment[new]):
                own = new[segment[new] == number]
                pieces = max(1, round(least * len(own) / len(new)))
                for piece in np.array_split(own, pieces):
                    motion[rows[piece]] = count
                    count += 1
            motion[rows] = motion[rows[first]]
        return motion


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


def _torque(segment: Segment) -> np.ndarray:
    assert segment.torque is not None
    return segment.bridged(segment.torque)
