"""What keeps an integrator from winding up while the torque is at its limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ANTI_WINDUP = ("clamping", "back_calculation", "none")
"""What ``Integrator.anti_windup`` may be."""


@dataclass(frozen=True)
class Integrator:
    """An integrator whose torque z grows with slope s, for n joints.

    At each tick of period h, with u the torque wanted and v what the torque limit lets through,

        clamping:          z += h s, unless u is beyond the limit and s pushes it further;
        back_calculation:  z += h (s + (v - u) / T_t);
        none:              z += h s.

    The torque of a tick has the z from before it (forward Euler). Source: astrom2006, section 3.5.

    Attributes:
        limit: largest size of z [N m], shape (n,), or ``None`` for no bound of its own.
        anti_windup: one of ``ANTI_WINDUP``.
        tracking_time: T_t [s], of back-calculation.
    """

    limit: np.ndarray | None = None
    anti_windup: str = "clamping"
    tracking_time: float | None = None

    def after(
        self,
        z: np.ndarray,
        slope: np.ndarray | float,
        wanted: np.ndarray,
        applied: np.ndarray,
        period: float,
    ) -> np.ndarray:
        """The integrator's torque after a tick [N m], of the shape of z.

        Args:
            z: its torque before [N m], shape (..., n).
            slope: s [N m/s].
            wanted, applied: torque before and after the torque limit [N m].
            period: h [s].
        """
        excess = wanted - applied
        if self.anti_windup == "back_calculation":
            assert self.tracking_time is not None
            slope = slope - excess / self.tracking_time
        elif self.anti_windup == "clamping":
            slope = np.where(excess * slope > 0, 0.0, slope)
        return self.bounded(z + period * slope)

    def bounded(self, z: np.ndarray) -> np.ndarray:
        """A torque [N m], (..., n), within the integrator's own limit."""
        return z if self.limit is None else np.clip(z, -self.limit, self.limit)
