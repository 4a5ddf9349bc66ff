"""The recordings of a case up to the first moment at which something changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import LEAST_UNCHANGED
from gapscope.model.changes import Change


def up_to_changes(case: Case, changes: Sequence[Change]) -> Case:
    """The case with each recording that has a change cut at the first one: the arm as it was before.

    A part of less than ``LEAST_UNCHANGED`` seconds is left out. If nothing would remain to fit, the longest part
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
        if longest.duration < LEAST_UNCHANGED:
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
        if first.time - recording.t[0] >= LEAST_UNCHANGED:
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
