"""What looks wrong in recordings as they are read: rates, copies, velocities and references that are none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from gapscope.arm.recording import STILL, Recording, slow_words
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.set_up import Remark, numbers

# Thresholds, each with its meaning, its unit in brackets and its origin in parentheses: ``physical`` follows from what
# arms, drives and logs are; ``hand`` was set by hand, and only decides about a remark.


# fmt: off
VELOCITY_GAIN = 0.1  # A recorded velocity differs from that of the positions by less than this share [1]. (hand)
REFERENCE_ERROR = 0.5  # A reference follows the position to this share of the joint's range at least [1]. (hand)
FOLLOWED = 0.1  # A joint that moves less may be held off its reference by its load [rad]. (hand)
SAME = 1e-9  # Series that differ by less are the same [rad or N m]. (physical)
# fmt: on


def remark(topic: str, place: str, said: str, remedy: str = "") -> Remark:
    """What is as it should be, or with a remedy a warning."""
    return Remark("warn" if remedy else "ok", topic, place, said, remedy)


def joints_of(mask: np.ndarray) -> str:
    """Numbers of the joints of a mask, in words."""
    return numbers((np.flatnonzero(mask) + 1).tolist())


def check_rest(still: np.ndarray) -> Iterator[Remark]:
    """Joints that rest in every recording, mask (n,)."""
    if still.any():
        yield Remark(
            "warn",
            "excitation",
            joints_of(still),
            "at rest: nothing can be told of friction and rotor",
            "record a motion to and fro",
        )


def remarks_on(recordings: Sequence[Recording]) -> Iterator[Remark]:
    """Time stamps, notes of the reader, copies, velocities and references of recordings of one arm."""
    for recording in recordings:
        slow, remedy = slow_words(recording)
        said = f"{recording.duration:.1f} s at {recording.rate:.4g} Hz"
        yield remark(
            "time", recording.name, "; ".join([said, *filter(None, [slow])]), remedy
        )
        for note in recording.notes:
            yield Remark("warn", "recordings", recording.name, note)
        # joints whose columns are the very same
        for name in ("q", "tau"):
            columns = getattr(recording, name)
            numbered = enumerate(() if columns is None else columns.T, 1)
            for (j, first), (k, second) in combinations(numbered, 2):
                if np.abs(first - second).max() < SAME < np.ptp(first):
                    yield remark(
                        "channels",
                        recording.name,
                        f"{name}{j} and {name}{k} are the same column",
                        f"correct import: {{{name}: ...}}",
                    )
        yield from _copied(recording)
        yield from _velocity(recording)
        yield from _reference(recording)
    for one, other in combinations(recordings, 2):
        count = min(len(one.t), len(other.t))
        if np.abs(one.q[:count] - other.q[:count]).max() < SAME:
            yield remark(
                "recordings",
                f"{one.name}, {other.name}",
                f"hold the same {count} positions",
                "remove one: effects are confirmed on data that was not fitted, and a copy was",
            )


def _copied(recording: Recording) -> Iterator[Remark]:
    """A reference that is a copy of what was measured."""
    channels = recording.channels
    for name in ("q", "dq"):
        own, other = channels.get(name), channels.get(f"{name}_ref")
        # where the arm stands a copy says nothing
        if own is None or other is None or not np.ptp(own, axis=0).any():
            continue
        if np.abs(own - other).max() < SAME:
            yield remark(
                "channels",
                recording.name,
                f"{name} and {name}_ref are the same numbers: one of them is a copy",
                f"a copied reference says nothing of the arm: import: {{{name}_ref: null}}",
            )


def _velocity(recording: Recording) -> Iterator[Remark]:
    """A recorded velocity that is not that of the positions."""
    if recording.dq is None or len(recording.t) < 3:
        return
    rate = np.gradient(recording.q, recording.t, axis=0)
    moving = np.ptp(recording.q, axis=0) > STILL
    power = np.where(moving, (rate**2).sum(axis=0), 1.0)
    gain = (recording.dq * rate).sum(axis=0) / power
    size = np.sqrt((recording.dq**2).sum(axis=0) / power)
    # noise of a differentiated encoder lowers the gain, not the size of a velocity in another unit
    off = np.abs([size - 1, gain - 1]).min(axis=0)
    # of the opposite sign it may have the right size
    off = np.where(gain < 0, 1 - gain, off)
    other = moving & (off > VELOCITY_GAIN)
    if other.any():
        worst = int(np.where(other, off, 0.0).argmax())
        times = np.copysign(size, gain)[worst]
        yield Remark(
            "warn",
            "channels",
            recording.name,
            f"dq of {joints_of(other)} is not the velocity of q: "
            f"{times:.3g} times it on joint {worst + 1}",
            "check unit, order and transmission of import: {dq: ...}, or set it to null: it is then derived from q",
        )


def _reference(recording: Recording) -> Iterator[Remark]:
    """A reference that the joint does not follow."""
    if recording.q_ref is None:
        return
    # over the joint's own range: a short motion is held to a short error
    range_ = np.ptp(recording.q, axis=0)
    error = rms(recording.q_ref - recording.q)
    off = (range_ > FOLLOWED) & (error > REFERENCE_ERROR * range_)
    if off.any():
        yield Remark(
            "warn",
            "controller",
            recording.name,
            f"{joints_of(off)} far from q_ref: they differ by more than half of "
            "the joint's range",
            "check unit and order of import: {q_ref: ...}",
        )
