"""Whether positions are those of a motion: joints that never move, little motion, values that lie alone."""

from __future__ import annotations

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    LEAST_MOTION,
    LONE_OF_OTHERS,
    LONE_POSITION,
    LONE_SAMPLES,
    MOVING_TORQUE,
    SHORT_MOTION,
    STICKING_SPEED,
)

LOOK = 0.1
"""Time over which a joint's speed is looked at [s]."""


def check_moving(case: Case) -> None:
    """Check that joints move, in every recording whose torque tells of a motion, and that no value lies alone.

    Raises:
        InputError: no joint moves in any recording, or none in one whose torque changes as in the others; or some
            samples lie far from all others.
    """
    for recording in (*case.recordings, *case.judged):
        _check_lone_positions(recording)
    least = LEAST_MOTION * case.arm.per_radian
    moves = [bool((np.ptp(r.q, axis=0) > least).any()) for r in case.recordings]
    if not any(moves):
        raise InputError(
            "the positions never change: without a motion no effect can be told from another",
            "record a motion of all joints; or check the columns q1.. and their unit in import: {q: ...}",
            file=", ".join(recording.name for recording in case.recordings),
            where="columns q",
        )
    changes = [_torque_change(recording) for recording in case.recordings]
    in_motion = [
        change for change, moving in zip(changes, moves, strict=True) if moving
    ]
    # what a standing arm's torque changes by is noise and drift
    most = MOVING_TORQUE * max(in_motion)
    for recording, moving, change in zip(case.recordings, moves, changes, strict=True):
        if not moving and change > most:
            raise InputError(
                "the positions never change, but the torque does as in a motion",
                "take the recording out of the case; did the logger lose the positions?",
                file=recording.name,
                where="columns q",
            )


def still_note(case: Case) -> tuple[str, ...]:
    """A sentence on each joint that moves in no recording."""
    ranges = np.max([np.ptp(r.q, axis=0) for r in case.recordings], axis=0)
    still = ranges <= LEAST_MOTION * case.arm.per_radian
    return tuple(
        f"joint {j + 1} ({case.arm.joints[j]}) never moves: its friction and drive cannot be told, the other joints "
        "are diagnosed; if it did move, its position was not recorded"
        for j in np.flatnonzero(still)
    )


def short_note(case: Case) -> tuple[str, ...]:
    """A sentence on recordings in which the joints move for too short a time to tell small effects."""
    seconds = sum(_moving_time(r, case.arm.per_radian) for r in case.recordings)
    if seconds >= SHORT_MOTION:
        return ()
    return (
        f"only {int(seconds)} s of motion in all: a small effect may not stand out, and errors are wide; record "
        f"{SHORT_MOTION:g} s or more, in two motions at least",
    )


def _moving_time(recording: Recording, per_radian: np.ndarray) -> float:
    """Time in which some joint is faster than dry friction needs to be known [s]."""
    every = max(1, round(LOOK * recording.rate))
    steps = np.abs(np.diff(recording.q[::every], axis=0))
    spans = np.diff(recording.t[::every])
    moves = (steps > STICKING_SPEED * per_radian * spans[:, None]).any(axis=1)
    # a gap in time counts as one step
    return float(np.minimum(spans[moves], 2 * LOOK).sum())


def _torque_change(recording: Recording) -> float:
    """Largest standard deviation of a joint's torque [N m]; 0 without a torque."""
    return 0.0 if recording.tau is None else float(recording.tau.std(axis=0).max())


def _check_lone_positions(recording: Recording) -> None:
    """Check that no few samples of a joint lie many times further out than all of its others.

    A joint that moves passes through what lies between. A torque may do so, in an impact.

    Raises:
        InputError: some do.
    """
    series, few = recording.q, LONE_SAMPLES
    if len(series) <= 4 * few:
        return
    ends = [*range(few + 1), *range(-few - 1, 0)]
    ordered = np.partition(series, [k % len(series) for k in ends], axis=0)
    # the least span that is left without so many samples, taken from both ends together
    spans = [ordered[-1 - few + k] - ordered[k] for k in range(few + 1)]
    taken, span = np.argmin(spans, axis=0), np.min(spans, axis=0)
    joints = np.arange(series.shape[1])
    low, high = ordered[taken, joints], ordered[-1 - few + taken, joints]
    beyond = np.maximum(series - high, low - series)
    allowed = LONE_POSITION * np.maximum(span, LONE_OF_OTHERS * span.max())
    if not (beyond > allowed).any() or not span.max():
        return
    row, joint = np.unravel_index((beyond - allowed).argmax(), series.shape)
    raise InputError(
        f"{series[row, joint]:.4g} lies alone: all but {few} samples are from {low[joint]:.4g} to {high[joint]:.4g}",
        "drop or repair the row (a gap in time is understood); no arm jumps there and back",
        file=recording.name,
        where=f"row {int(row) + 1}, column q{int(joint) + 1}",
    )
