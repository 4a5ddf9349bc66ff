"""Recordings of a case: how many, how long, which channels, time stamps, copies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.case_check.remark import Remark, numbers
from gapscope.case_check.thresholds import (
    FOLLOWED,
    REFERENCE_ERROR,
    SAME,
    SHORT_DURATION,
    SLOW_RATE,
    STAMP_JITTER,
    STILL,
    VELOCITY_GAIN,
)


def check_recordings(case: Case) -> Iterator[Remark]:
    """Number, length, channels, time stamps and copies of the recordings."""
    every = [*case.recordings, *case.judged]
    yield from _amount(case)
    yield from _channels(case, every)
    for recording in every:
        yield from _stamps(recording)
        for note in recording.notes:
            yield Remark("warn", "recordings", recording.name, note)
        yield from _copied_columns(recording)
        yield from _velocity(recording)
        yield from _reference(recording)
    yield from _copies(every)


def _amount(case: Case) -> Iterator[Remark]:
    seconds = sum(recording.duration for recording in case.recordings)
    said = f"{len(case.recordings)} to fit, {seconds:.0f} s in all; {len(case.judged)} held out"
    if seconds < SHORT_DURATION:
        remedy = "record at least a minute in which all joints move, slowly and fast"
        yield Remark("warn", "recordings", "", said, remedy)
    elif len(case.recordings) == 1 and not case.judged:
        yield Remark(
            "warn",
            "recordings",
            "",
            f"{said}: parts of the one recording are predicted from the others",
            "add a recording of another motion, or name one in judge:, so that effects are confirmed on other data",
        )
    else:
        yield Remark("ok", "recordings", "", said)


def _channels(case: Case, every: Sequence[Recording]) -> Iterator[Remark]:
    present = {
        name: sum(getattr(recording, name) is not None for recording in every)
        for name in CHANNELS
    }
    parts = [
        name if count == len(every) else f"{name} (in {count} of {len(every)})"
        for name, count in present.items()
        if count
    ]
    said = f"read: t, {', '.join(parts)}"
    with_torque = sum(recording.tau is not None for recording in case.recordings)
    if with_torque == len(case.recordings):
        yield Remark("ok", "channels", "", said)
    elif with_torque:
        yield Remark(
            "warn",
            "channels",
            "",
            f"{said}; recordings without torque are not fitted",
            "name their torque columns in import: {tau: ...}",
        )
    elif case.controller is not None and present["q_ref"]:
        yield Remark(
            "warn",
            "channels",
            "",
            f"{said}; no torque: it is worked out as what the controller must have commanded",
            "record torque or motor current if you can: noise and wrong gains pass into what is worked out",
        )


def _stamps(recording: Recording) -> Iterator[Remark]:
    steps = np.diff(recording.t)
    jitter = float(steps.std() / np.median(steps)) if len(steps) else 0.0
    said = f"{recording.duration:.1f} s at {recording.rate:.4g} Hz"
    remedies = []
    if recording.rate < SLOW_RATE:
        remedies.append(
            f"log at {SLOW_RATE:g} Hz or more: delays, elasticity and ripple are hardly seen below"
        )
    if jitter > STAMP_JITTER:
        said += f", steps of time vary by {jitter:.0%}"
        remedies.append(
            "log the controller's own time; if rows are evenly spaced in truth, say import: {time: {rate: ...}}"
        )
    level = "warn" if remedies else "ok"
    yield Remark(level, "time", recording.name, said, "; ".join(remedies))


def _copied_columns(recording: Recording) -> Iterator[Remark]:
    """Joints whose columns are the very same."""
    for name in ("q", "tau"):
        series = getattr(recording, name)
        if series is None:
            continue
        for first, second in combinations(range(recording.n_joints), 2):
            same = np.abs(series[:, first] - series[:, second]).max() < SAME
            if same and np.ptp(series[:, first]) > SAME:
                yield Remark(
                    "warn",
                    "channels",
                    recording.name,
                    f"{name}{first + 1} and {name}{second + 1} are the same column",
                    f"correct import: {{{name}: ...}}",
                )


def _velocity(recording: Recording) -> Iterator[Remark]:
    """A recorded velocity that is not that of the positions."""
    if recording.dq is None or len(recording.t) < 3:
        return
    rate = np.gradient(recording.q, recording.t, axis=0)
    power = (rate**2).sum(axis=0)
    moving = np.ptp(recording.q, axis=0) > STILL
    gain = (recording.dq * rate).sum(axis=0) / np.where(moving, power, 1.0)
    size = np.sqrt((recording.dq**2).sum(axis=0) / np.where(moving, power, 1.0))
    # noise of a differentiated encoder lowers the gain, not the size of a velocity in another unit
    other = (
        moving & (np.abs(size - 1) > VELOCITY_GAIN) & (np.abs(gain - 1) > VELOCITY_GAIN)
    )
    if other.any():
        worst = int(np.abs(np.where(other, size - 1, 0.0)).argmax())
        yield Remark(
            "warn",
            "channels",
            recording.name,
            f"dq of {numbers((np.flatnonzero(other) + 1).tolist())} is not the velocity of q: "
            f"{size[worst]:.3g} times it on joint {worst + 1}",
            "check unit, order and transmission of import: {dq: ...}, or set it to null: it is then derived from q",
        )


def _reference(recording: Recording) -> Iterator[Remark]:
    """A reference that the joint does not follow."""
    if recording.q_ref is None:
        return
    range_ = np.ptp(recording.q, axis=0)
    error = np.sqrt(np.mean((recording.q_ref - recording.q) ** 2, axis=0))
    off = (range_ > FOLLOWED) & (error > REFERENCE_ERROR * range_)
    if off.any():
        yield Remark(
            "warn",
            "controller",
            recording.name,
            f"{numbers((np.flatnonzero(off) + 1).tolist())} far from q_ref: they differ by more than half of "
            "the joint's range",
            "check unit and order of import: {q_ref: ...}",
        )


def _copies(every: Sequence[Recording]) -> Iterator[Remark]:
    """Recordings that hold the same data: what is confirmed on a copy is not confirmed."""
    for first, second in combinations(every, 2):
        count = min(len(first.t), len(second.t))
        if np.abs(first.q[:count] - second.q[:count]).max() < SAME:
            yield Remark(
                "warn",
                "recordings",
                f"{first.name}, {second.name}",
                f"hold the same {count} positions",
                "remove one: effects are confirmed on data that was not fitted, and a copy was",
            )
