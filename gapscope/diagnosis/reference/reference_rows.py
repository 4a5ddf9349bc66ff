"""Samples of recordings as the torque gap sees them, with the columns of the identified model."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import LEAST_STRETCHES
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF, Segment, condition
from gapscope.ident.signals.samples import Band, Samples


@dataclass(frozen=True)
class ReferenceRows:
    """M samples of n joints, filtered at 12 Hz, trimmed and thinned.

    Attributes:
        matrix: W, (M, n, p).
        torque: recorded, less that of known loads [N m], (M, n).
        rate: of the torque [N m/s], (M, n).
        segments: that they come from.
        stretches: recordings, or parts of the only one.
        samples: that filter further series likewise.
    """

    matrix: np.ndarray
    torque: np.ndarray
    rate: np.ndarray
    segments: tuple[Segment, ...]
    stretches: tuple[slice, ...]
    samples: Samples


def stack(
    columns: ModelColumns,
    law: FrictionLaw,
    recordings: Sequence[Recording],
    cutoff: float,
) -> ReferenceRows:
    """Rows of all recordings with a torque; positions cut at ``cutoff`` [Hz]."""
    segments = [
        segment
        for recording in recordings
        if recording.tau is not None
        for segment in condition(recording, cutoff)
    ]
    band = Band(TORQUE_CUTOFF).bounded(segments)
    samples = Samples(columns, segments, band)
    slopes = [np.gradient(np.asarray(s.torque), s.motion.t, axis=0) for s in segments]
    return ReferenceRows(
        samples.matrix(law),
        samples.torque,
        _on_rows(band, segments, slopes),
        tuple(segments),
        _stretches(samples.group),
        samples,
    )


def _stretches(group: np.ndarray) -> tuple[slice, ...]:
    """Rows of each recording, by its number at every row, (M,); few recordings are cut into parts."""
    edges = np.flatnonzero(np.diff(np.concatenate([[-1], group, [group[-1] + 1]])))
    count = len(edges) - 1
    parts = 1
    if count < LEAST_STRETCHES - 1:
        parts = math.ceil(LEAST_STRETCHES / count)
    cuts: set[int] = set()
    for begin, end in itertools.pairwise(edges):
        cuts.update(int(cut) for cut in np.linspace(begin, end, parts + 1))
    return tuple(slice(a, b) for a, b in itertools.pairwise(sorted(cuts)))


def filtered(rows: ReferenceRows, series: Sequence[np.ndarray]) -> np.ndarray:
    """One series per segment, (N, ...), on the rows, (M, ...)."""
    return _on_rows(rows.samples.band, rows.segments, series)


def _on_rows(
    band: Band, segments: Sequence[Segment], series: Sequence[np.ndarray]
) -> np.ndarray:
    """Series of the segments filtered, trimmed and thinned as the rows are, (M, ...)."""
    parts = [
        band.thinned(x, segment) for x, segment in zip(series, segments, strict=True)
    ]
    return np.concatenate(parts)
