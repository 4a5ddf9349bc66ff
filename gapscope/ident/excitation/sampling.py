"""Whether a sampling rate is high enough for a trajectory."""

from __future__ import annotations

from gapscope.arm.errors import InputError

LEAST_RATIO = 10.0
"""Samples per period of the highest frequency, at least [1]."""


def check_sampling(rate: float, highest: float) -> None:
    """Check that there are at least ten samples per period of the highest frequency.

    Args:
        rate: sampling rate [Hz].
        highest: highest frequency of the trajectory [Hz].

    Raises:
        InputError: the rate is too low.
    """
    if not rate >= LEAST_RATIO * highest * (1 - 1e-9):
        raise InputError(
            f"{rate:g} samples per second are fewer than {LEAST_RATIO:g} times the highest frequency, {highest:g} Hz",
            f"sample at {LEAST_RATIO * highest:g} Hz or more, or lower the base frequency or the order",
            where="rate",
        )
