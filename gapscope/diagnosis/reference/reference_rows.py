"""Samples of recordings as the torque gap sees them, with the columns of the identified model."""

from __future__ import annotations

import itertools
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
class Rows:
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
) -> Rows:
    """Rows of all recordings with a torque; positions cut at ``cutoff`` [Hz]."""
    segments = [
        s for r in recordings if r.tau is not None for s in condition(r, cutoff)
    ]
    band = Band(TORQUE_CUTOFF)
    samples = Samples(columns, segments, band)
    rates = [
        band.filtered(np.gradient(np.asarray(s.torque), s.motion.t, axis=0), s)[
            :: band.step(s)
        ]
        for s in segments
    ]
    edges = np.flatnonzero(np.diff(np.r_[-1, samples.group, samples.group[-1] + 1]))
    parts = (
        -(-LEAST_STRETCHES // (len(edges) - 1))
        if len(edges) - 1 < LEAST_STRETCHES - 1
        else 1
    )
    cuts = sorted(
        {
            int(x)
            for a, b in itertools.pairwise(edges)
            for x in np.linspace(a, b, parts + 1)
        }
    )
    return Rows(
        samples.matrix(law),
        samples.torque,
        np.concatenate(rates),
        tuple(segments),
        tuple(slice(a, b) for a, b in itertools.pairwise(cuts)),
        samples,
    )


def filtered(rows: Rows, series: Sequence[np.ndarray]) -> np.ndarray:
    """One series per segment, (N, ...), on the rows, (M, ...)."""
    band = rows.samples.band
    return np.concatenate(
        [
            band.filtered(x, s)[:: band.step(s)]
            for x, s in zip(series, rows.segments, strict=True)
        ]
    )
