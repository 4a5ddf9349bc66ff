"""How many samples a motion may have that is computed as a whole."""

from __future__ import annotations

from gapscope.arm.errors import InputError
from gapscope.arm.io.plausibility import PLAUSIBLE_RATES

MOST_SAMPLES = 4_000_000
"""Samples in all, an hour at 1 kHz: of seven joints they take some GB while they are computed."""


def check_sample_count(duration: float, rate: float, recordings: int = 1) -> None:
    """Check that motions of a duration [s] at a rate [Hz] can be held in memory.

    Raises:
        InputError: the rate is beyond any robot's, or there are more than ``MOST_SAMPLES``.
    """
    highest = PLAUSIBLE_RATES[1]
    if rate > highest:
        raise InputError(
            f"{rate:g} Hz is beyond any robot's log",
            f"give {highest:g} Hz or less",
            where="rate",
        )
    if duration * rate * recordings > MOST_SAMPLES:
        raise InputError(
            f"{recordings} x {duration:g} s at {rate:g} Hz are {duration * rate * recordings:.3g} samples, at most "
            f"{MOST_SAMPLES:,} are made at once",
            "give a shorter duration, a lower rate or fewer recordings",
            where="duration",
        )
