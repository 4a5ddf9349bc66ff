"""Controllers of a joint torque: PD with or without a model's feedforward, and computed torque."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from gapscope.agents.gains import Tuning
from gapscope.agents.torque_model import TorqueModel
from gapscope.arm.motions.motion import Motion
from gapscope.envs.actions import Gains


class TrackingController(Protocol):
    """A controller of n joints; it is called at every tick, and its torque is held until the next."""

    def begin(self, motion: Motion) -> None:
        """Start anew on a reference, given at every tick."""

    def torque(
        self,
        q_ref: np.ndarray,
        dq_ref: np.ndarray,
        ddq_ref: np.ndarray,
        q: np.ndarray,
        dq: np.ndarray,
        planned: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque to command [N m], shape (n,).

        Args:
            q_ref, dq_ref, ddq_ref: reference now [rad], [rad/s], [rad/s^2], each (n,).
            q, dq: position of the encoders [rad], velocity estimated from them [rad/s], each (n,).
            planned: a row of what ``plan`` gave; the model's torque at this sample if ``None``.
        """

    def plan(self, motion: Motion) -> np.ndarray | None:
        """Feedforward of a reference known beforehand [N m], shape (N, n), or ``None`` if it takes none."""


class Feedforward:
    """tau = model(q_ref, dq_ref, ddq_ref) + kp (q_ref - q) + kd (dq_ref - dq), clipped at +-limit.

    Without a model it is PD alone, with ``gapscope.agents.torque_model.Gravity`` PD with gravity, with
    ``gapscope.agents.torque_model.ArmModel`` PD with inverse dynamics. The model is outside the loop: it changes
    how well a reference is followed, hardly what gains are stable.

    Args:
        gains: kp [N m/rad], kd [N m s/rad], each (n,).
        limit: torque limit [N m], shape (n,); infinite for none.
        model: feedforward, or ``None``.
    """

    def __init__(
        self, gains: Gains, limit: np.ndarray, model: TorqueModel | None = None
    ) -> None:
        self.gains, self.limit, self.model = gains, limit, model

    def begin(self, motion: Motion) -> None:
        """Nothing: it remembers nothing."""

    def torque(
        self,
        q_ref: np.ndarray,
        dq_ref: np.ndarray,
        ddq_ref: np.ndarray,
        q: np.ndarray,
        dq: np.ndarray,
        planned: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque to command [N m], shape (n,)."""
        gains = self.gains
        tau = gains.kp * (q_ref - q) + gains.kd * (dq_ref - dq)
        if planned is not None:
            tau += planned
        elif self.model is not None:
            tau += self.model(q_ref, dq_ref, ddq_ref)
        return np.minimum(np.maximum(tau, -self.limit), self.limit)

    def plan(self, motion: Motion) -> np.ndarray | None:
        """The model's torque over the reference [N m], shape (N, n)."""
        if self.model is None:
            return np.zeros_like(motion.q)
        return self.model.series(motion)


class ComputedTorque:
    """tau = model(q, dq_ref, ddq_ref + w^2 (q_ref - q) + 2 zeta w (dq_ref - dq)), clipped at +-limit.

    The model is inside the loop: its inertia scales the gains, so that a wrong one shifts the bandwidth. Coriolis
    torque and friction are taken at the reference's velocity; at the measured one dry friction would chatter. No delay
    is compensated, since the state of the arm is not known beforehand.

    Args:
        tuning: w and zeta.
        limit: torque limit [N m], shape (n,); infinite for none.
        model: inverse dynamics.

    Source: siciliano2009.
    """

    def __init__(self, tuning: Tuning, limit: np.ndarray, model: TorqueModel) -> None:
        self.tuning, self.limit, self.model = tuning, limit, model

    def begin(self, motion: Motion) -> None:
        """Nothing: it remembers nothing."""

    def torque(
        self,
        q_ref: np.ndarray,
        dq_ref: np.ndarray,
        ddq_ref: np.ndarray,
        q: np.ndarray,
        dq: np.ndarray,
        planned: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque to command [N m], shape (n,)."""
        wanted = (
            ddq_ref
            + self.tuning.stiffness * (q_ref - q)
            + self.tuning.rate * (dq_ref - dq)
        )
        tau = self.model(q, dq_ref, wanted)
        return np.minimum(np.maximum(tau, -self.limit), self.limit)

    def plan(self, motion: Motion) -> np.ndarray | None:
        """Nothing."""
        return None
