"""What changed during a recording, a load picked up or put down, or friction; and the recordings up to that moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import LEAST_UNCHANGED
from gapscope.ident.kalman.changes import (
    RecordingChange,
    find_changes,
    samples_of_each,
)
from gapscope.ident.model.base_parameters import base_parameters
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF
from gapscope.ident.signals.samples import Band


def changes_during(case: Case, cutoff: float) -> tuple[RecordingChange, ...]:
    """At most one change in each recording (``gapscope.ident.kalman.changes``); all base parameters are unknown.

    What is wrong from the first to the last sample is no change: it is among the unknown parameters.

    Args:
        case: with a torque in its recordings.
        cutoff: of the positions [Hz]; torque is compared below that of the torque gap.
    """
    columns, law = ModelColumns(case.arm), FrictionLaw()
    band = Band(min(TORQUE_CUTOFF, cutoff))
    found = samples_of_each((*case.recordings, *case.judged), columns, band)
    matrix = np.concatenate([each.samples.matrix(law) for each in found])
    names = columns.names(law)
    rows = matrix.reshape(-1, len(names))
    # too short to determine the parameters once, let alone twice
    if len(rows) < len(names):
        return ()
    return find_changes(found, law, base_parameters(rows, names))


def up_to_changes(case: Case, changes: Sequence[RecordingChange]) -> Case:
    """The case with each recording that has a change cut at its moment: the arm as it was before.

    A part of less than ``LEAST_UNCHANGED`` seconds is left out. If nothing would remain to fit, the longest part
    after a change is kept in its place.
    """
    if not changes:
        return case
    moments = {found.recording: found for found in changes}
    kept = _cut(case.recordings, moments)
    if not kept:
        kept = (_longer_part(case.recordings, moments),)
    return replace(case, recordings=kept, judged=_cut(case.judged, moments))


def _cut(
    recordings: Sequence[Recording], moments: dict[str, RecordingChange]
) -> tuple[Recording, ...]:
    """The recordings up to their changes, those long enough."""
    kept = []
    for recording in recordings:
        found = moments.get(recording.name)
        if found is None:
            kept.append(recording)
        elif found.change.time - recording.t[0] >= LEAST_UNCHANGED:
            before = recording.t < found.change.interval[0]
            note = f"used up to {found.change.time:.2f} s only, since it changes there"
            kept.append(recording.part(before, notes=(*recording.notes, note)))
    return tuple(kept)


def _longer_part(
    recordings: Sequence[Recording], moments: dict[str, RecordingChange]
) -> Recording:
    """The longest part of any recording after its change."""

    def left(recording: Recording) -> float:
        return float(recording.t[-1] - moments[recording.name].change.time)

    longest = max(recordings, key=left)
    found = moments[longest.name]
    after = longest.t > found.change.interval[1]
    note = f"used from {found.change.time:.2f} s on only, since it changes there"
    return longest.part(after, notes=(*longest.notes, note))
