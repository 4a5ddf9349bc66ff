"""A controller as a case states it: its law, gains, limits, and its integrator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

import numpy as np

# What keeps an integrator from winding up while the torque is at its limit.


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
            # integrating further would only push against the limit
            slope = np.where(excess * slope > 0, 0.0, slope)
        return self.bounded(z + period * slope)

    def bounded(self, z: np.ndarray) -> np.ndarray:
        """A torque [N m], (..., n), within the integrator's own limit."""
        return z if self.limit is None else np.clip(z, -self.limit, self.limit)


# The controller that a case declares, as far as it is known: what all control laws have in common.


Law = TypeVar("Law", bound="Controller")


@dataclass(frozen=True)
class Gain:
    """What a gain of a control law is.

    Attributes:
        name: key in a case file, and attribute of the controller.
        unit: of one joint's value.
        meaning: in words.
        order: a loop of twice the bandwidth and the same damping has 2^order times this gain [1].
    """

    name: str
    unit: str
    meaning: str
    order: int


@dataclass(frozen=True, kw_only=True)
class Controller(ABC):
    """tau = feedforward(q_ref, dq_ref, ddq_ref) + feedback(q_ref - q, dq_ref - dq), clipped at the torque limit.

    A law is a subclass, whose gains are attributes of shape (n,). Errors and torques may have any shape (..., n).

    Attributes:
        kind: name of the law in a case file.
        gains: its gains.
        through_model: whether the feedback is an acceleration that goes through the nominal arm's inverse dynamics,
            in place of a torque beside a feedforward.
        integrates: whether it has an integrator.
        rate: control frequency [Hz]; the torque is held until the next tick.
        feedforward: ``none``, ``gravity`` or ``nominal``.
        velocity_cutoff: cut-off of the second-order velocity filter [Hz], or ``None`` for no filter.
        velocity_damping: its damping ratio [1].
        integrator: bounds of the integrator; ``None`` for a law without one.
    """

    kind: ClassVar[str]
    gains: ClassVar[tuple[Gain, ...]]
    through_model: ClassVar[bool] = False
    integrates: ClassVar[bool] = False
    rate: float
    feedforward: str = "none"
    velocity_cutoff: float | None = None
    velocity_damping: float = 0.9
    integrator: Integrator | None = None

    @property
    def estimate(self) -> tuple[float, float | None, float]:
        """Rate [Hz], cut-off [Hz] and damping [1] of its velocity filter."""
        return self.rate, self.velocity_cutoff, self.velocity_damping

    @abstractmethod
    def proportional(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Feedback without memory: torque [N m], or acceleration [rad/s^2] if it goes through the model.

        Args:
            error: q_ref - q [rad].
            rate: dq_ref - dq [rad/s].
        """

    def integration(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray | float:
        """Slope of the integrator's torque [N m/s]; 0 for a law without one."""
        return 0.0

    @property
    def velocity_gain(self) -> np.ndarray | None:
        """Torque over the velocity's error [N m s/rad], (n,); ``None`` if it depends on the posture."""
        return None

    def times(self: Law, share: float) -> Law:
        """The same law with a bandwidth ``share`` times as large and the same damping."""
        # each gain by its power of the bandwidth
        scaled = {
            gain.name: share**gain.order * getattr(self, gain.name)
            for gain in self.gains
        }
        return replace(self, **scaled)
