"""Rows of groups of recordings: what a contrast compares, on decimated samples of one band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from gapscope.arm.recording import Recording
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    position_cutoff,
)
from gapscope.model.decimated_segments import DecimatedSegments
from gapscope.model.torque_gap import torque_scale

LEAST_MOTIONS = 4
"""Parts of a group at least, each of which counts as a motion of its own: one motion says nothing of another."""
SAME_STATE = 0.1
"""States closer than this share of the deviation of positions and velocities are passed again [1]: less than what
changes friction or gravity, more than what a controller misses its reference by."""
SAME_SHARE = 0.9
"""A part is a motion that comes again if this share of its rows passes through states of that motion [1]."""


class Rows(DecimatedSegments):
    """Rows of groups of recordings with a torque, M in all, of n joints.

    Args:
        groups: recordings of each group; a recording that is listed again counts once.

    Attributes:
        group, recording, segment: numbers of the group, of the recording and of the segment of each row, (M,).
        group_of: number of the group of each segment.
        motion: number of the motion of each row, (M,): one that comes again in a group keeps its number.
        torque: recorded [N m], (M, n).
        trust: square root of the weight of each row, (M, n): 1 unless its torque was not measured.
        scale: normalisation of the torque gap over all rows of the first group [N m], (n,).
        t: time since the start of the recording [s], (M,).
        position, velocity: [rad], [rad/s], (M, n).

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """

    def __init__(self, groups: Sequence[Sequence[Recording]]) -> None:
        groups = [_listed_once(recordings) for recordings in groups]
        cutoff = position_cutoff(tuple(r for group in groups for r in group))
        segments, self.group_of, of_recording, count = [], [], [], 0
        for number, recordings in enumerate(groups):
            for recording in recordings:
                own = condition(recording, cutoff)
                segments += own
                self.group_of += [number] * len(own)
                of_recording += [count] * len(own)
                count += 1
        super().__init__(segments, min(TORQUE_CUTOFF, cutoff))
        self.bodies = []
        counts = [len(self.time(s)) for s in segments]
        self.recording = np.repeat(of_recording, counts)
        self.segment = np.repeat(np.arange(len(segments)), counts)
        self.group = np.repeat(self.group_of, counts)
        self.torque = self.rows([_torque(s) for s in segments])
        self.trust = np.sqrt(np.vstack([self.known(s) for s in segments]))
        self.scale = torque_scale(self.torque[self.group == 0])
        self.t = np.concatenate([self.time(s) for s in segments])
        kept = [slice(s.inner.start, s.inner.stop, self.step(s)) for s in segments]
        pairs = list(zip(segments, kept, strict=True))
        self.position = np.vstack([s.motion.q[rows] for s, rows in pairs])
        self.velocity = np.vstack([s.motion.dq[rows] for s, rows in pairs])
        self.motion = self._motions()

    def of(self, group: int) -> np.ndarray:
        """Which rows belong to a group, mask (M,)."""
        return np.asarray(self.group == group)

    def part_of_motion(self, count: int) -> np.ndarray:
        """Number of the part of its motion in which each row lies, of parts of equal length, (M,)."""
        out = np.empty(len(self.motion), dtype=int)
        for cell in np.unique(np.column_stack([self.motion, self.segment]), axis=0):
            rows = np.flatnonzero((self.motion == cell[0]) & (self.segment == cell[1]))
            out[rows] = np.arange(len(rows)) * count // len(rows)
        return out

    def _motions(self) -> np.ndarray:
        """Numbers of the motions, (M,): parts of the groups, those that come again under one number."""
        parts = self._parts()
        deviation = [
            np.maximum(x.std(axis=0), 1e-9) for x in (self.position, self.velocity)
        ]
        state = np.hstack([self.position / deviation[0], self.velocity / deviation[1]])
        reach = SAME_STATE * np.sqrt(state.shape[1])
        motion = parts.copy()
        for part in range(1, parts.max() + 1):
            own, earlier = parts == part, parts < part
            # a part goes on from the one before: only another recording of the group can repeat it
            earlier &= ~np.isin(self.recording, self.recording[own])
            earlier &= self.group == self.group[own][0]
            if not earlier.any():
                continue
            distance, place = cKDTree(state[earlier]).query(
                state[own], distance_upper_bound=reach
            )
            near = np.isfinite(distance)
            if near.mean() >= SAME_SHARE:
                motion[own] = np.bincount(motion[earlier][place[near]]).argmax()
        return motion

    def _parts(self) -> np.ndarray:
        """Numbers of the parts, (M,): segments; those of a group with few of them are cut into equal parts."""
        parts, count = np.empty(len(self.group), dtype=int), 0
        for number in range(self.group.max() + 1):
            rows = np.flatnonzero(self.group == number)
            for segment in np.unique(self.segment[rows]):
                own = rows[self.segment[rows] == segment]
                pieces = max(1, round(LEAST_MOTIONS * len(own) / len(rows)))
                for piece in np.array_split(own, pieces):
                    parts[piece] = count
                    count += 1
        return parts


def _listed_once(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings with a torque, without those that repeat another one to the last digit."""
    kept: list[Recording] = []
    for recording in recordings:
        if recording.tau is None or any(_same(recording, other) for other in kept):
            continue
        kept.append(recording)
    return kept


def _same(one: Recording, other: Recording) -> bool:
    torques = np.asarray(one.tau), np.asarray(other.tau)
    return np.array_equal(one.q, other.q) and np.array_equal(*torques)


def _torque(segment: Segment) -> np.ndarray:
    assert segment.torque is not None
    return segment.bridged(segment.torque)
