"""Where a gap lies: by regime of motion, by position, in time and by frequency, cut in advance.

``gapscope.diagnosis.localisation`` learns from the gap itself what such cuts are too coarse for.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.signal import welch

from gapscope.diagnosis.localisation.locate import locate
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.stacked_rows import Rows
from gapscope.diagnosis.thresholds import (
    BANDS,
    JOINTS_IN_DEPTH,
    LEAST_BAND_POWER,
    REGION_ENRICHMENT,
    REGION_SHARE,
)


def located(
    error: np.ndarray,
    rows: Rows,
    load: np.ndarray,
    floor: np.ndarray,
    joints: list[int],
) -> list[Region]:
    """All that is said of where the gap of some joints lies, joint by joint in the order given.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves [N m], (n,).
        joints: from 1, the worst first; only the first ``JOINTS_IN_DEPTH`` are looked at in depth.
    """
    out = []
    deep = {
        place.joint: place.regions
        for place in locate(error, rows, load, floor, joints[:JOINTS_IN_DEPTH])
    }
    for joint in joints:
        out += [*regions(error, rows, load, [joint]), *deep.get(joint, ())]
    return out


def regions(
    error: np.ndarray, rows: Rows, load: np.ndarray, joints: list[int], most: int = 2
) -> list[Region]:
    """The regions where the gap of some joints is concentrated, the strongest first.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        joints: joints to look at, from 1.
        most: regions per joint.
    """
    found = []
    for joint in joints:
        square = error[:, joint - 1] ** 2
        if square.sum() == 0:
            continue
        candidates = [
            Region(
                joint,
                kind,
                text,
                float(square[mask].sum() / square.sum()),
                float(mask.mean()),
            )
            for kind, text, mask in _masks(rows, load, joint - 1)
        ]
        candidates += _bands(error[:, joint - 1], load[:, joint - 1], rows, joint)
        named = [
            r
            for r in candidates
            if r.share >= REGION_SHARE and r.enrichment >= REGION_ENRICHMENT
        ]
        found += sorted(
            named, key=lambda r: r.share * np.log(r.enrichment), reverse=True
        )[:most]
    return found


def _masks(rows: Rows, load: np.ndarray, j: int) -> list[tuple[str, str, np.ndarray]]:
    """Regions of joint j (from 0) as kind, words and mask over the rows."""
    q, v, a, torque = (
        rows.q[:, j],
        np.abs(rows.dq[:, j]),
        np.abs(rows.ddq[:, j]),
        np.abs(load[:, j]),
    )
    speed, slow = np.quantile(v, 0.8), np.quantile(v, 0.2)
    strong, heavy = np.quantile(a, 0.8), np.quantile(torque, 0.8)
    masks = [
        ("regime", f"near velocity reversal, |dq| below {slow:.2g} rad/s", v <= slow),
        ("regime", f"high speed, |dq| above {speed:.2g} rad/s", v >= speed),
        ("regime", f"high acceleration, |ddq| above {strong:.2g} rad/s²", a >= strong),
        ("regime", f"high load, nominal torque above {heavy:.2g} N m", torque >= heavy),
        ("regime", "moving forward", rows.dq[:, j] > slow),
        ("regime", "moving backward", rows.dq[:, j] < -slow),
    ]
    edges = np.linspace(q.min(), q.max(), 6)
    for low, high in itertools.pairwise(edges):
        masks.append(
            (
                "position",
                f"position {low:.2f} to {high:.2f} rad",
                (q >= low) & (q <= high),
            )
        )
    for segment in np.unique(rows.segment):
        inside = rows.segment == segment
        t = rows.clock[inside]
        cuts = np.linspace(t[0], t[-1], 6)
        for low, high in itertools.pairwise(cuts):
            text = f"{rows.recording(segment)}, {low:.1f} to {high:.1f} s"
            masks.append(
                ("time", text, inside & (rows.clock >= low) & (rows.clock <= high))
            )
    return [m for m in masks if m[2].any()]


def _bands(error: np.ndarray, load: np.ndarray, rows: Rows, joint: int) -> list[Region]:
    """Frequency bands of one joint; what a band covers is its share of the power of the nominal torque."""
    gap, expected = (band_powers(series, rows) for series in (error, load))
    return [
        Region(
            joint,
            "frequency",
            f"{low:g} to {high:g} Hz",
            float(share),
            max(float(coverage), LEAST_BAND_POWER),
        )
        for (low, high), share, coverage in zip(BANDS, gap, expected, strict=True)
    ]


def band_powers(series: np.ndarray, rows: Rows) -> np.ndarray:
    """Share of the power of a series (M,) in each of ``BANDS``, over all segments; shape (len(BANDS),)."""
    powers = np.zeros(len(BANDS))
    for segment, rate in enumerate(rows.rates):
        part = series[rows.segment == segment]
        frequency, density = welch(part, rate, nperseg=min(len(part), int(4 * rate)))
        for k, (low, high) in enumerate(BANDS):
            band = (frequency >= low) & (frequency < high)
            powers[k] += (
                density[band].sum() * (frequency[1] - frequency[0]) * len(part) / rate
            )
    return powers / max(powers.sum(), 1e-300)
