"""Where a gap lies in frequency: lines of its own, and bands in which it follows the joint's own signals."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.display import significant
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
    f, whole = found.frequency, found.gap.sum()
    candidates = f >= LINE_LOWEST
    if whole <= 0 or not candidates.any():
        return None
    peak = float(f[candidates][int(found.gap[candidates].argmax())])
    near = np.abs(f - peak) <= LINE_WIDTH
    share = float(found.gap[near].sum() / whole)
    coverage = max(
        float(found.signals[0][near].sum() / max(found.signals[0].sum(), 1e-300)),
        LEAST_BAND_POWER,
    )
    if (
        share < LINE_SHARE
        or share < LINE_ENRICHMENT * coverage
        or share < 2 * near.mean()
    ):
        return None
    centre = float((f[near] * found.gap[near]).sum() / found.gap[near].sum())
    words = f"line at {significant(centre, 2)} Hz"
    return Region(
        joint, "line", words, min(share, 1.0), min(coverage, 1.0), {"frequency": centre}
    )


def coherent(found: Spectra, joint: int) -> list[Region]:
    """Bands in which the gap follows the joint's own torque, velocity or acceleration; the largest share first."""
    whole = found.gap.sum()
    out = []
    for low, high in BANDS:
        mask = (found.frequency >= low) & (found.frequency < high)
        share = float(found.gap[mask].sum() / max(whole, 1e-300))
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
        coverage = float(
            found.signals[0][mask].sum() / max(found.signals[0].sum(), 1e-300)
        )
        detail = {
            "band": [low, high],
            "signal": drive.name,
            "coherence": float(coherence[best]),
            "gain": gain,
            "unit": drive.unit,
            "phase": phase,
        }
        out.append(
            Region(
                joint,
                "coherence",
                words,
                share,
                min(max(coverage, LEAST_BAND_POWER), 1.0),
                detail,
            )
        )
    return sorted(out, key=lambda region: -region.share)


def _plainest(coherence: np.ndarray, transfer: np.ndarray) -> int:
    """Of the signals that the gap follows about as well as any, the one that it is most in step with.

    In a narrow band velocity and acceleration are the same but for a quarter of a period.
    """
    as_good = coherence > coherence.max() - EQUAL_COHERENCE
    return int(np.where(as_good, np.abs(np.cos(np.angle(transfer))), -1.0).argmax())


def _phase(phase: float) -> str:
    """A phase [rad] in words; positive if the gap is ahead."""
    if abs(phase) < np.pi / 6:
        return "in step"
    if abs(phase) > 5 * np.pi / 6:
        return "with the sign reversed"
    degrees = f"{abs(np.rad2deg(phase)):.0f}°"
    return f"{degrees} {'ahead' if phase > 0 else 'behind'}"
