"""Recordings that can be diagnosed: what is odd about motion and torque, and what is left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.plausibility import DIAGNOSE_FIRST, PLAUSIBLE_RATES
from gapscope.arm.recording import STILL, Recording, resting
from gapscope.diagnosis.thresholds import (
    EXAMINED,
    LARGEST_POSITION,
    LARGEST_TORQUE,
    LONE_POSITION,
    LONE_SAMPLES,
    LONG_RECORDINGS,
    MIN_MOTION,
    MIN_MOTION_SHARE,
    MIN_UNCHANGED,
    MIN_WINDOW,
    MOVING_TORQUE,
    SHORT_MOTION,
    STICKING_SPEED,
    WINDOW,
)
from gapscope.model.changes import Change
from gapscope.model.conditioning import MIN_FLOOR

# Whether positions are those of a motion: joints that never move, little motion, values that lie alone.


LOOK = 0.1
"""Time over which a joint's speed is looked at [s]."""


def check_moving(case: Case) -> None:
    """Check that joints move, in every recording whose torque tells of a motion, and that no value lies alone.

    Raises:
        InputError: the arm stands still in all recordings, or its positions do in one whose torque changes as in the
            others; or some samples lie far from all others.
    """
    for recording in (*case.recordings, *case.judged):
        _check_lone_positions(recording)
    least = MIN_MOTION * case.arm.per_radian
    moves = [bool((np.ptp(r.q, axis=0) > least).any()) for r in case.recordings]
    if resting(case.recordings, case.arm.per_radian).all():
        raise InputError(
            f"the arm stands still: no joint moves by {STILL:g} rad within a recording, and without a motion no effect "
            "can be told from another",
            "record a motion of all joints; or check the columns q1.. and their unit in import: {q: ...}",
            file=", ".join(recording.name for recording in case.recordings),
            where="columns q",
        )
    # the largest deviation of a joint's torque [N m]
    changes = [
        0.0 if r.tau is None else float(r.tau.std(axis=0).max())
        for r in case.recordings
    ]
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
    still = resting(case.recordings, case.arm.per_radian)
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
    # from one row to the next noise looks like speed
    every = max(1, round(LOOK * recording.rate))
    steps = np.abs(np.diff(recording.q[::every], axis=0))
    spans = np.diff(recording.t[::every])
    moves = (steps > STICKING_SPEED * per_radian * spans[:, None]).any(axis=1)
    # a gap in time counts as one step
    return float(np.minimum(spans[moves], 2 * LOOK).sum())


def _check_lone_positions(recording: Recording) -> None:
    """Check that no few samples of a joint lie many times further out than all of its others.

    A joint that moves passes through what lies between. A torque may do so, in an impact.

    Raises:
        InputError: some do.
    """
    series, few = recording.q, LONE_SAMPLES
    if len(series) <= 4 * few:
        return
    # what is left without so many samples at either end
    low, high = np.partition(series, (few, len(series) - 1 - few), axis=0)[
        [few, -1 - few]
    ]
    span = high - low
    beyond = np.maximum(series - high, low - series)
    # one that stands still has no span: then a share of the widest joint's
    allowed = LONE_POSITION * np.maximum(span, MIN_MOTION_SHARE * span.max())

    if not (beyond > allowed).any() or not span.max():
        return
    row, joint = np.unravel_index((beyond - allowed).argmax(), series.shape)
    raise InputError(
        f"{series[row, joint]:.4g} lies alone: all but {few} samples are from {low[joint]:.4g} to {high[joint]:.4g}",
        "drop or repair the row (a gap in time is understood); no arm jumps there and back",
        file=recording.name,
        where=f"row {int(row) + 1}, column q{int(joint) + 1}",
    )


# Whether the recordings of a case hold what an arm can have: numbers beyond every unit are an error of the input.


def check_stamps(case: Case) -> None:
    """Check that the stamps of most samples run forward, in s or ms.

    Raises:
        InputError: those of a recording stand still, jump back, or are too far apart for any robot log.
    """
    slowest = PLAUSIBLE_RATES[0] / 1e3  # stamps in ms are repaired
    for recording in (*case.recordings, *case.judged):
        step = float(np.median(np.diff(recording.t))) if len(recording.t) > 1 else 0.0
        if not 0 < step <= 1.01 / slowest:
            raise InputError(
                f"time does not run as in a log of a robot: steps of {step:.3g} s",
                "give the unit of the time stamps in import: {time: {unit: ...}}, or their rate:; "
                + DIAGNOSE_FIRST,
                file=recording.name,
                where="column t",
            )


def check_torque(case: Case) -> None:
    """Check that a case has a torque that says something, and positions and torques of some unit.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, or none that changes.
        InputError: a position or torque is larger than in any unit.
    """
    carrying = [r for r in case.recordings if r.tau is not None]
    if not carrying:
        raise no_torque(case)
    for recording in (*case.recordings, *case.judged):
        _check_size(recording, "q", LARGEST_POSITION, "rad")
        _check_size(recording, "tau", LARGEST_TORQUE, "N m")
        _check_size(recording, "tau_sensor", LARGEST_TORQUE, "N m")
    torques = [r.tau for r in carrying if r.tau is not None]
    if max(np.ptp(tau, axis=0).max() for tau in torques) < MIN_FLOOR:
        names = ", ".join(r.name for r in carrying)
        raise GapscopeError(
            f"{case.name}: the torque of no joint changes ({names})",
            "check the columns tau1.. or import: {tau: ...}, its unit included; record a motion of all joints",
        )


def check_rates(case: Case) -> None:
    """Check that recordings, their time stamps put right, run forward at a rate at which robots are logged.

    Raises:
        InputError: one does not.
    """
    low, high = PLAUSIBLE_RATES
    for recording in (*case.recordings, *case.judged):
        # stamps of 0.1 s round to a little more
        if not 0.99 * low <= recording.rate <= 1.01 * high:
            raise InputError(
                f"the rate is {recording.rate:.3g} Hz, expected {low:g} to {high:g} Hz",
                "log at a higher rate; or, if this is none, give the unit of the time stamps in import: {time: {unit: "
                "...}}, or their rate:",
                file=recording.name,
                where="column t",
            )
        back = np.flatnonzero(np.diff(recording.t) <= 0)
        if len(back):
            raise InputError(
                "time stands still or jumps back",
                "drop rows that repeat a time stamp, and split the log if it jumps back",
                file=recording.name,
                where=f"row {int(back[0]) + 2}, column t",
            )


def no_torque(case: Case) -> GapscopeError:
    """The error on a case without torque, with the reasons that were noted as it was read."""
    notes = [note for recording in case.recordings for note in recording.notes]
    reasons = dict.fromkeys((*case.warnings, *notes))
    why = "; ".join(reasons) or "none has a torque column"
    return GapscopeError(
        f"{case.name}: no recording carries a torque that can be trusted ({why})",
        "give torque with its sign in column tau1.., or map it in the case's import: section; positions are enough "
        "where controller: is known and the recordings have its reference in columns q_ref1..",
    )


def _check_size(recording: Recording, channel: str, largest: float, unit: str) -> None:
    """Check that no value of a channel is beyond what it can be in any unit."""
    series = getattr(recording, channel)
    if series is None or not len(series):
        return
    row, column = np.unravel_index(np.abs(series).argmax(), series.shape)
    value = float(series[row, column])
    if abs(value) > largest:
        raise InputError(
            f"{value:.3g} {unit} is beyond what an arm has in any unit ({largest:g} {unit})",
            f"drop or repair the row, or give the unit in import: {{{channel}: {{column: ..., unit: ...}}}}",
            file=recording.name,
            where=f"row {int(row) + 1}, column {channel}{int(column) + 1}",
        )


# What is looked at of long recordings: windows spread evenly over them, so that an hour costs what minutes cost.
#
# Recordings that last longer in all than ``LONG_RECORDINGS`` are cut into windows of the same length, one in the
# middle of each of equal parts, ``EXAMINED`` seconds in all. Every part of a log has its window: an effect that is
# always there shows in them as in the whole, and one that comes and goes is seen where it lasts longer than the
# distance between two windows. Nothing is drawn at random: the same log has the same windows.


def select_windows(case: Case) -> Case:
    """The case with windows of its recordings, fitted and set aside apart, each if they are long; else as it is.

    The windows are the pieces of a recording between gaps in time. A note on the recording says what is looked at.
    """
    fitted, judged = _windows(case.recordings), _windows(case.judged)
    if fitted is case.recordings and judged is case.judged:
        return case
    return replace(case, recordings=fitted, judged=judged)


def _windows(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """Windows of recordings that are long in all; others as they are, and those whose time has no usual unit."""
    slowest = min((r.rate for r in recordings), default=0.0)
    seconds = sum(_seconds(r) for r in recordings)
    if seconds <= LONG_RECORDINGS or not slowest >= PLAUSIBLE_RATES[0]:
        return recordings
    # of many short recordings some, spread evenly, so that a window is never shorter than the filters need
    most = int(EXAMINED / MIN_WINDOW)
    if len(recordings) > most:
        chosen = np.linspace(0, len(recordings) - 1, most).round().astype(int)
        recordings = tuple(recordings[k] for k in chosen)
        seconds = sum(_seconds(r) for r in recordings)
    share = min(1.0, EXAMINED / seconds)
    return tuple(_windows_of(r, share) for r in recordings)


def _seconds(recording: Recording) -> float:
    """Time over which there are samples [s]."""
    return len(recording.t) / recording.rate


def _windows_of(recording: Recording, share: float) -> Recording:
    """A share of a recording [1], in windows in the middle of equal parts of its rows."""
    rows, rate = len(recording.t), recording.rate
    examined = max(share * _seconds(recording), MIN_WINDOW)
    count = max(1, round(examined / WINDOW))
    length = int(examined / count * rate)
    if count * length >= rows:
        return recording
    middles = (np.arange(count) + 0.5) * rows / count
    kept = np.zeros(rows, dtype=bool)
    for start in (middles - length / 2).astype(int):
        kept[start : start + length] = True
    note = f"long: {count} windows of {length / rate:.3g} s, spread evenly over it, are looked at"
    return recording.part(kept, notes=(*recording.notes, note))


# The recordings of a case up to the first moment at which something changes.


def up_to_changes(case: Case, changes: Sequence[Change]) -> Case:
    """The case with each recording that has a change cut at the first one: the arm as it was before.

    A part of less than ``MIN_UNCHANGED`` seconds is left out. If nothing would remain to fit, the longest part
    after the last change of a recording is kept in its place; if that is as short, the recordings are kept whole.
    """
    if not changes:
        return case
    by_name: dict[str, list[Change]] = {}
    for found in sorted(changes, key=lambda found: found.time):
        by_name.setdefault(found.recording, []).append(found)
    kept = _cut(case.recordings, by_name)
    if not kept:
        longest = _longer_part(case.recordings, by_name)
        if longest.duration < MIN_UNCHANGED:
            return case
        kept = (longest,)
    return replace(case, recordings=kept, judged=_cut(case.judged, by_name))


def _cut(
    recordings: Sequence[Recording], changes: Mapping[str, list[Change]]
) -> tuple[Recording, ...]:
    """The recordings up to their first changes, those long enough."""
    kept = []
    for recording in recordings:
        if recording.name not in changes:
            kept.append(recording)
            continue
        first = changes[recording.name][0]
        # the moment itself is known to an interval: none of that is used
        if first.interval[0] - recording.t[0] >= MIN_UNCHANGED:
            before = recording.t < first.interval[0]
            note = f"used up to {first.time:.2f} s only, since it changes there"
            kept.append(recording.part(before, notes=(*recording.notes, note)))
    return tuple(kept)


def _longer_part(
    recordings: Sequence[Recording], changes: Mapping[str, list[Change]]
) -> Recording:
    """The longest part of any recording after its last change."""

    def left(recording: Recording) -> float:
        return float(recording.t[-1] - changes[recording.name][-1].ends)

    longest = max(recordings, key=left)
    last = changes[longest.name][-1]
    after = longest.t > last.ends
    note = f"used from {last.time:.2f} s on only, since it changes there"
    return longest.part(after, notes=(*longest.notes, note))
