"""What is looked at of long recordings: windows spread evenly over them, so that an hour costs what minutes cost.

Recordings that last longer in all than ``LONG_RECORDINGS`` are cut into windows of the same length, one in the middle
of each of equal parts, ``EXAMINED`` seconds in all. Every part of a log has its window: an effect that is always there
shows in them as in the whole, and one that comes and goes is seen where it lasts longer than the distance between two
windows. Nothing is drawn at random: the same log has the same windows.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.io.plausibility import PLAUSIBLE_RATES
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    EXAMINED,
    LEAST_WINDOW,
    LONG_RECORDINGS,
    MOST_FOLDS,
    SINGLE_RECORDING_FOLDS,
    WINDOW,
)
from gapscope.model.conditioning import Segment, blocks


def excerpt(case: Case) -> Case:
    """The case with windows of its recordings, fitted and set aside apart, each if they are long; else as it is.

    The windows are the pieces of a recording between gaps in time. A note on the recording says what is looked at.
    """
    fitted, judged = _windows(case.recordings), _windows(case.judged)
    if fitted is case.recordings and judged is case.judged:
        return case
    return replace(case, recordings=fitted, judged=judged)


def folds_of(recordings: Sequence[list[Segment]]) -> list[list[Segment]]:
    """Folds of the segments of each recording: a recording each, or the blocks of a single one.

    Their equations are kept one by one: of more than ``MOST_FOLDS`` neighbours are joined, and of a single recording
    in many pieces those that make up ``SINGLE_RECORDING_FOLDS`` parts of it.
    """
    if len(recordings) > 1:
        return _joined(recordings, MOST_FOLDS)
    segments = recordings[0]
    if len(segments) > SINGLE_RECORDING_FOLDS:
        return _joined([[segment] for segment in segments], SINGLE_RECORDING_FOLDS)
    parts = [blocks(segment, SINGLE_RECORDING_FOLDS) for segment in segments]
    return _joined([[block] for cut in parts for block in cut], MOST_FOLDS)


def _joined(folds: Sequence[list[Segment]], most: int) -> list[list[Segment]]:
    """Folds, neighbours joined if there are more than so many."""
    count = min(len(folds), most)
    edges = np.linspace(0, len(folds), count + 1).astype(int)
    return [
        [segment for fold in folds[start:stop] for segment in fold]
        for start, stop in itertools.pairwise(edges)
    ]


def _windows(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """Windows of recordings that are long in all; others as they are, and those whose time has no usual unit."""
    slowest = min((r.rate for r in recordings), default=0.0)
    seconds = sum(_seconds(r) for r in recordings)
    if seconds <= LONG_RECORDINGS or not slowest >= PLAUSIBLE_RATES[0]:
        return recordings
    # of many short recordings some, spread evenly, so that a window is never shorter than the filters need
    most = int(EXAMINED / LEAST_WINDOW)
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
    examined = max(share * _seconds(recording), LEAST_WINDOW)
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
