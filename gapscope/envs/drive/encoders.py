"""Encoders: what is read from the true positions of motors or joints."""

from __future__ import annotations

import numpy as np

from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Sensing
from gapscope.effects.sensing import quantize
from gapscope.envs.drive.repeated import Repeated
from gapscope.envs.drive.rows import Laws, Rows


class Encoders(Rows):
    """Reading = round((p' + noise) / step) step, p' what effects make of the position p of motor or joint; (n,).

    Args:
        arm: an arm with effects, in whose order the joints are; an effect with a resolution takes the place of
            ``step``, all others act on the position.
        step: quantisation of the data sheet [rad], 0 for none.

    Attributes:
        on_motor: whether they sit on the motors.
    """

    ROWS = ("_laws", "_step")

    def __init__(self, arm: CorrectedArm, step: float) -> None:
        self.on_motor = arm.arm.encoder == "motor"
        laws = [
            (law, values)
            for law, values in arm.of_kind(Sensing)
            if "resolution" not in law.quantities.values()
        ]
        self._laws = Laws(laws, np.arange(arm.arm.n_joints))
        coarse = arm.quantity("resolution")
        self._step = np.where(coarse > 0, coarse, step)
        self.note()

    def note(self) -> None:
        """Note what makes a reading."""
        self._quiet = np.zeros(len(self._step))
        self._seen = Repeated(self._read, 2, len(self._step))

    def undone(self, reading: np.ndarray) -> np.ndarray:
        """Position [rad] at which they, but for rounding and noise, read ``reading`` [rad]."""
        for law, values in reversed(self._laws.acting):
            reading = law.true(reading, *values)
        return reading

    def __call__(
        self, position: np.ndarray, noise: np.ndarray | None = None
    ) -> np.ndarray:
        """Reading [rad] for true positions [rad] and what is added before rounding [rad]."""
        return np.array(self._seen(position, self._quiet if noise is None else noise))

    def _read(self, position: np.ndarray, noise: np.ndarray) -> np.ndarray:
        seen = position
        for law, values in self._laws.acting:
            seen = law.recorded(seen, *values)
        seen = seen + noise
        return quantize(seen, self._step) if self._step.any() else seen
