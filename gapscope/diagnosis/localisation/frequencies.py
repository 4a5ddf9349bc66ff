"""Where a gap lies in frequency: lines of its own, and bands in which it follows the joint's own signals."""

from __future__ import annotations

import numpy as np

from gapscope.arm.display import significant
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.spectra import DRIVES, Spectra
from gapscope.diagnosis.thresholds import (
    BAND_COHERENCE,
    BAND_POWER,
    BANDS,
    EQUAL_COHERENCE,
    LEAST_BAND_POWER,
    LINE_ENRICHMENT,
    LINE_LOWEST,
    LINE_SHARE,
    LINE_WIDTH,
)


def line(found: Spectra, joint: int) -> Region | None:
    """A narrow line in the spectrum of the gap that the torque does not have."""
    frequency, gap, torque = found.frequency, found.gap, found.signals[0]
    candidates = frequency >= LINE_LOWEST
    if gap.sum() <= 0 or not candidates.any():
        return None
    peak = float(frequency[candidates][int(gap[candidates].argmax())])
    near = np.abs(frequency - peak) <= LINE_WIDTH
    share = float(gap[near].sum() / gap.sum())
    coverage = _power_share(torque, near)
    # White noise would hold near.mean() of its power there.
    least = max(LINE_SHARE, LINE_ENRICHMENT * coverage, 2 * float(near.mean()))
    if share < least:
        return None
    centre = float((frequency[near] * gap[near]).sum() / gap[near].sum())
    words = f"line at {significant(centre, 2)} Hz"
    detail = {"frequency": centre}
    return Region(joint, "line", words, min(share, 1.0), min(coverage, 1.0), detail)


def _power_share(power: np.ndarray, mask: np.ndarray) -> float:
    """Share of a power density in some of its frequencies, at least ``LEAST_BAND_POWER``."""
    share = float(power[mask].sum() / max(power.sum(), 1e-300))
    return max(share, LEAST_BAND_POWER)


def coherent(found: Spectra, joint: int) -> list[Region]:
    """Bands in which the gap follows the joint's own torque, velocity or acceleration; the largest share first."""
    whole = max(found.gap.sum(), 1e-300)
    out = []
    for low, high in BANDS:
        mask = (found.frequency >= low) & (found.frequency < high)
        share = float(found.gap[mask].sum() / whole)
        if share < BAND_POWER:
            continue
        coherence, transfer = found.band(mask)
        best = _plainest(coherence, transfer)
        if coherence[best] < max(BAND_COHERENCE, found.chance(int(mask.sum()))):
            continue
        gain, phase = float(np.abs(transfer[best])), float(np.angle(transfer[best]))
        drive = DRIVES[best]
        words = (
            f"{low:g} to {high:g} Hz, follows the joint's {drive.name} {_phase(phase)}: {significant(gain, 2)} "
            f"{drive.unit}, coherence {coherence[best]:.2f}"
        )
        detail = {
            "band": [low, high],
            "signal": drive.name,
            "coherence": float(coherence[best]),
            "gain": gain,
            "unit": drive.unit,
            "phase": phase,
        }
        coverage = min(_power_share(found.signals[0], mask), 1.0)
        out.append(Region(joint, "coherence", words, share, coverage, detail))
    return sorted(out, key=lambda region: -region.share)


def _plainest(coherence: np.ndarray, transfer: np.ndarray) -> int:
    """Of the signals that the gap follows about as well as any, the one that it is most in step with.

    In a narrow band velocity and acceleration are the same but for a quarter of a period.
    """
    as_good = coherence > coherence.max() - EQUAL_COHERENCE
    in_step = np.abs(np.cos(np.angle(transfer)))
    return int(np.where(as_good, in_step, -1.0).argmax())


def _phase(phase: float) -> str:
    """A phase [rad] in words; positive if the gap is ahead."""
    if abs(phase) < np.pi / 6:
        return "in step"
    if abs(phase) > 5 * np.pi / 6:
        return "with the sign reversed"
    degrees = f"{abs(np.rad2deg(phase)):.0f}°"
    return f"{degrees} {'ahead' if phase > 0 else 'behind'}"
