"""The velocity that the environment's controller has: how its differentiator is set."""

from __future__ import annotations

from gapscope.arm.velocity_filter import FilterGains, bilinear

VELOCITY_CUTOFF = 80.0
"""Cut-off of the velocity estimate [Hz]; at most ``WIDEST`` of the rate at which the encoders are read."""
WIDEST = 0.4
"""Largest cut-off over that rate [1]."""
VELOCITY_DAMPING = 0.9
"""Damping ratio of the velocity estimate [1]."""


def cutoff(rate: float) -> float:
    """Cut-off [Hz] for encoders that are read at a rate [Hz]."""
    return min(VELOCITY_CUTOFF, WIDEST * rate)


def estimate_gains(rate: float) -> FilterGains:
    """Gains of the differentiator at a rate [Hz]."""
    return bilinear(rate, cutoff(rate), VELOCITY_DAMPING)
