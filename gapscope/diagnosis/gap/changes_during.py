"""What changes during recordings of a case, by their own clocks; and the recordings up to the first moment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import LEAST_UNCHANGED
from gapscope.model.changes import Change, changes_of
from gapscope.model.rows import comparable


@dataclass(frozen=True)
class RecordingChange:
    """A change during a recording.

    Attributes:
        recording: its name.
        start: first time of its clock [s].
        change: what changed, when, and by how much.
    """

    recording: str
    start: float
    change: Change

    @property
    def time(self) -> float:
        """Likeliest moment, by the clock of the recording [s]."""
        return self.start + self.change.moment.time

    @property
    def interval(self) -> tuple[float, float]:
        """Times between which it lies with 95 % confidence, by the same clock [s]."""
        low, high = self.change.moment.interval
        return self.start + low, self.start + high

    def __str__(self) -> str:
        """What changes when, in words."""
        where = f" of joint {self.change.term.joint}" * bool(self.change.term.joint)
        return (
            f"{self.change.term.effect}{where} at {self.time:.2f} s of {self.recording}"
        )


def changes_during(
    case: Case, progress: Callable[[str], None] = lambda message: None
) -> tuple[RecordingChange, ...]:
    """What changes during recordings (``gapscope.model.changes``), whatever the arm is that they share.

    What is wrong from the first to the last sample is no change.
    """
    recordings = comparable((*case.recordings, *case.judged))
    if not recordings:
        return ()
    changed = [
        (recordings[change.moment.recording], change)
        for change in changes_of(recordings, case.arm, progress)
    ]
    return tuple(RecordingChange(r.name, float(r.t[0]), one) for r, one in changed)


def up_to_changes(case: Case, changes: Sequence[RecordingChange]) -> Case:
    """The case with each recording that has a change cut at the first one: the arm as it was before.

    A part of less than ``LEAST_UNCHANGED`` seconds is left out. If nothing would remain to fit, the longest part
    after the last change of a recording is kept in its place.
    """
    if not changes:
        return case
    by_name: dict[str, list[RecordingChange]] = {}
    for found in sorted(changes, key=lambda found: found.time):
        by_name.setdefault(found.recording, []).append(found)
    kept = _cut(case.recordings, by_name)
    if not kept:
        kept = (_longer_part(case.recordings, by_name),)
    return replace(case, recordings=kept, judged=_cut(case.judged, by_name))


def _cut(
    recordings: Sequence[Recording], changes: Mapping[str, list[RecordingChange]]
) -> tuple[Recording, ...]:
    """The recordings up to their first changes, those long enough."""
    kept = []
    for recording in recordings:
        if recording.name not in changes:
            kept.append(recording)
            continue
        first = changes[recording.name][0]
        if first.time - recording.t[0] >= LEAST_UNCHANGED:
            before = recording.t < first.interval[0]
            note = f"used up to {first.time:.2f} s only, since it changes there"
            kept.append(recording.part(before, notes=(*recording.notes, note)))
    return tuple(kept)


def _longer_part(
    recordings: Sequence[Recording], changes: Mapping[str, list[RecordingChange]]
) -> Recording:
    """The longest part of any recording after its last change."""

    def left(recording: Recording) -> float:
        return float(recording.t[-1] - changes[recording.name][-1].time)

    longest = max(recordings, key=left)
    last = changes[longest.name][-1]
    after = longest.t > last.interval[1]
    note = f"used from {last.time:.2f} s on only, since it changes there"
    return longest.part(after, notes=(*longest.notes, note))
