"""Where a gap lies: by regime of motion, by position, in time and by frequency, cut in advance.

``gapscope.diagnosis.localisation`` learns from the gap itself what such cuts are too coarse for.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from scipy.signal import welch

from gapscope.diagnosis.localisation.locate import locate
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.diagnosis.thresholds import (
    BANDS,
    JOINTS_IN_DEPTH,
    LEAST_BAND_POWER,
    REGION_ENRICHMENT,
    REGION_SHARE,
)


def located(
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    floor: np.ndarray,
    joints: list[int],
) -> list[Region]:
    """All regions in which the gap of some joints lies, joint by joint in the order given.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves [N m], (n,).
        joints: from 1, the worst first; only the first ``JOINTS_IN_DEPTH`` are looked at in depth.
    """
    found = locate(error, rows, load, floor, joints[:JOINTS_IN_DEPTH])
    in_depth = {place.joint: place.regions for place in found}
    out = []
    for joint in joints:
        out += regions(error, rows, load, [joint])
        out += in_depth.get(joint, ())
    return out


def regions(
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    joints: list[int],
    most: int = 2,
) -> list[Region]:
    """The regions where the gap of some joints is concentrated, the strongest first.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        joints: joints to look at, from 1.
        most: regions per joint.
    """
    found: list[Region] = []
    for joint in joints:
        gap, nominal = error[:, joint - 1], load[:, joint - 1]
        if not gap.any():
            continue
        candidates = [
            _region(joint, part, gap**2) for part in _parts(rows, load, joint - 1)
        ]
        candidates += _bands(gap, nominal, rows, joint)
        named = [
            region
            for region in candidates
            if region.share >= REGION_SHARE and region.enrichment >= REGION_ENRICHMENT
        ]
        found += sorted(named, key=_strength, reverse=True)[:most]
    return found


def _strength(region: Region) -> float:
    return region.share * float(np.log(region.enrichment))


class _Part(NamedTuple):
    """A part of the rows, cut in advance: its kind, in words, and the mask over the rows, (M,)."""

    kind: str
    words: str
    mask: np.ndarray


def _region(joint: int, part: _Part, square: np.ndarray) -> Region:
    share = float(square[part.mask].sum() / square.sum())
    return Region(joint, part.kind, part.words, share, float(part.mask.mean()))


def _parts(rows: MotionRows, load: np.ndarray, j: int) -> list[_Part]:
    """Parts of the motion of joint j (from 0) that hold any rows."""
    parts = [
        *_motion_parts(rows, load[:, j], j),
        *_position_parts(rows.q[:, j]),
        *_time_parts(rows),
    ]
    return [part for part in parts if part.mask.any()]


def _motion_parts(rows: MotionRows, load: np.ndarray, j: int) -> list[_Part]:
    """The fifth of the rows at the lowest and highest speed, acceleration and load, and both directions."""
    velocity = rows.dq[:, j]
    speed, acceleration = np.abs(velocity), np.abs(rows.ddq[:, j])
    torque = np.abs(load)
    slow, fast = np.quantile(speed, [0.2, 0.8])
    strong, heavy = np.quantile(acceleration, 0.8), np.quantile(torque, 0.8)
    named = [
        (f"near velocity reversal, |dq| below {slow:.2g} rad/s", speed <= slow),
        (f"high speed, |dq| above {fast:.2g} rad/s", speed >= fast),
        (
            f"high acceleration, |ddq| above {strong:.2g} rad/s²",
            acceleration >= strong,
        ),
        (f"high load, nominal torque above {heavy:.2g} N m", torque >= heavy),
        ("moving forward", velocity > slow),
        ("moving backward", velocity < -slow),
    ]
    return [_Part("regime", words, mask) for words, mask in named]


def _position_parts(q: np.ndarray) -> list[_Part]:
    """Fifths of the range of positions."""
    parts = []
    for low, high in itertools.pairwise(np.linspace(q.min(), q.max(), 6)):
        words = f"position {low:.2f} to {high:.2f} rad"
        parts.append(_Part("position", words, (q >= low) & (q <= high)))
    return parts


def _time_parts(rows: MotionRows) -> list[_Part]:
    """Fifths of the time of each segment."""
    clock = rows.clock
    parts = []
    for segment in np.unique(rows.segment):
        inside = rows.segment == segment
        t = clock[inside]
        for low, high in itertools.pairwise(np.linspace(t[0], t[-1], 6)):
            words = f"{rows.recording(segment)}, {low:.1f} to {high:.1f} s"
            mask = inside & (clock >= low) & (clock <= high)
            parts.append(_Part("time", words, mask))
    return parts


def _bands(
    error: np.ndarray, load: np.ndarray, rows: MotionRows, joint: int
) -> list[Region]:
    """Frequency bands of one joint; what a band covers is its share of the power of the nominal torque."""
    shares = band_powers(error, rows)
    coverages = np.maximum(band_powers(load, rows), LEAST_BAND_POWER)
    return [
        Region(
            joint, "frequency", f"{low:g} to {high:g} Hz", float(share), float(coverage)
        )
        for (low, high), share, coverage in zip(BANDS, shares, coverages, strict=True)
    ]


def band_powers(series: np.ndarray, rows: MotionRows) -> np.ndarray:
    """Share of the power of a series (M,) in each of ``BANDS``, over all segments; shape (len(BANDS),)."""
    powers = np.zeros(len(BANDS))
    for segment, rate in enumerate(rows.rates):
        part = series[rows.segment == segment]
        frequency, density = welch(part, rate, nperseg=min(len(part), int(4 * rate)))
        resolution = frequency[1] - frequency[0]
        for k, (low, high) in enumerate(BANDS):
            band = (frequency >= low) & (frequency < high)
            powers[k] += density[band].sum() * resolution * len(part) / rate
    return powers / max(powers.sum(), 1e-300)
