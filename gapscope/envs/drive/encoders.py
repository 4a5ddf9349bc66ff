"""Encoders: what is read from the true positions of motors or joints."""

from __future__ import annotations

import numpy as np

from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.sensing import quantize


class Encoders:
    """reading = round((p + delta + noise) / step) step, p the position of motor or joint; arrays (n,), the arm's order.

    Args:
        arm: an arm with effects; its effect ``encoder_quantization`` takes the place of ``step``.
        step: quantisation of the data sheet [rad], 0 for none.
        noise: standard deviation of white noise before rounding [rad], a number or shape (n,).
        rng: source of the noise.

    Attributes:
        on_motor: whether they sit on the motors.
        offset: delta [rad].
        step: quantisation step [rad], 0 for none.
    """

    def __init__(
        self,
        arm: CorrectedArm,
        step: float,
        noise: np.ndarray | float,
        rng: np.random.Generator | None,
    ) -> None:
        self.on_motor = arm.arm.encoder == "motor"
        self.offset = arm.value("encoder_offset", "offset")
        coarse = arm.value("encoder_quantization", "step")
        self.step = np.where(coarse > 0, coarse, step)
        self._noise, self._rng = noise, rng if np.any(noise) else None
        self._rounded, self._exact = bool((self.step > 0).all()), not self.step.any()

    def __call__(self, motor: np.ndarray, joint: np.ndarray) -> np.ndarray:
        """Reading [rad] for the true positions [rad] of motors and joints."""
        seen = (motor if self.on_motor else joint) + self.offset
        if self._rng is not None:
            seen += self._noise * self._rng.standard_normal(len(seen))
        if self._exact:
            return seen
        if self._rounded:  # as ``quantize``, but without a look at each step
            np.divide(seen, self.step, seen)
            np.rint(seen, seen)
            return np.multiply(seen, self.step, seen)
        return quantize(seen, self.step)
