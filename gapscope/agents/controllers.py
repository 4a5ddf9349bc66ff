"""Controllers of a joint torque: PD with or without a model's feedforward, computed torque, and a trained agent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gapscope.agents.models import AgentModel, TorqueModel
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.envs.actions import Gains, scaled
from gapscope.envs.arguments import positive
from gapscope.envs.episode import Layout


@dataclass(frozen=True)
class Tuning:
    """How stiff a loop is to be.

    Attributes:
        bandwidth: w / 2 pi [Hz].
        damping: zeta [1].

    Raises:
        InputError: a number that is not above zero.
    """

    bandwidth: float = 4.0
    damping: float = 0.7

    def __post_init__(self) -> None:
        """Check the numbers."""
        positive("bandwidth", self.bandwidth, "Hz")
        positive("damping", self.damping, "1")

    @property
    def stiffness(self) -> float:
        """w^2 [1/s^2], gain from position error to acceleration."""
        return (2 * np.pi * self.bandwidth) ** 2

    @property
    def rate(self) -> float:
        """2 zeta w [1/s], gain from velocity error to acceleration."""
        return 2 * self.damping * 2 * np.pi * self.bandwidth

    def times(self, factor: float) -> Tuning:
        """The same with the bandwidth multiplied: kp grows with the square of the factor, kd with the factor."""
        return Tuning(self.bandwidth * factor, self.damping)


def own_inertia(arm: NominalArm, posture: np.ndarray) -> np.ndarray:
    """M_ii + I_i [kg m^2], shape (n,), of the nominal arm at a posture [rad], shape (n,)."""
    return np.diag(RigidBody(arm).mass_matrix(posture)) + arm.armature


def gains(inertia: np.ndarray, tuning: Tuning) -> Gains:
    """kp = w^2 M [N m/rad] and kd = 2 zeta w M [N m s/rad], each (n,), on inertias M [kg m^2], shape (n,)."""
    return Gains(tuning.stiffness * inertia, tuning.rate * inertia)


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

    Without a model it is PD alone, with ``gapscope.agents.models.Gravity`` PD with gravity, with
    ``gapscope.agents.models.ArmModel`` PD with inverse dynamics. The model is outside the loop: it changes
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
        """Stateless; nothing to reset."""

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
        """Stateless; nothing to reset."""

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


class AgentController:
    """tau = model(q_ref, dq_ref, ddq_ref) + kp (q_ref - q) + kd (dq_ref - dq) + a, clipped at +-limit.

    The action a [N m] is chosen every ``agent.period`` and held, from what the environment would let the agent observe.
    An agent with actions of the kind ``scale`` multiplies feedforward and gains instead, one of the kind ``torque``
    commands all of the torque.

    Args:
        gains: kp [N m/rad], kd [N m s/rad], each (n,).
        limit: torque limit [N m], shape (n,); infinite for none.
        agent: the agent.
    """

    def __init__(self, gains: Gains, limit: np.ndarray, agent: AgentModel) -> None:
        self.gains, self.limit, self.agent = gains, limit, agent
        self._layout = Layout(len(limit), agent.look_ahead, agent.control.size)
        self._motion: Motion | None = None

    def begin(self, motion: Motion) -> None:
        """Forget earlier actions; the reference at every tick follows."""
        self._motion, self._tick = motion, 0
        self._action = np.zeros(self.agent.control.size)
        self._every = max(1, round(self.agent.period * motion.rate))
        self._steps_ahead = [
            round(time * motion.rate) for time in self.agent.look_ahead
        ]

    def torque(
        self,
        q_ref: np.ndarray,
        dq_ref: np.ndarray,
        ddq_ref: np.ndarray,
        q: np.ndarray,
        dq: np.ndarray,
        planned: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque to command [N m], shape (n,); ``begin`` comes before the first tick."""
        assert self._motion is not None, "begin() comes first"
        if planned is None:
            beneath = Feedforward(self.gains, self.limit, self.agent.model)
            planned = beneath.torque(q_ref, dq_ref, ddq_ref, q_ref, dq_ref)
        if self._tick % self._every == 0:
            measured = (q, dq, q_ref - q, self._action)
            ahead = self._ahead(self._motion.q, q_ref)
            share = planned / self.agent.control.rated
            row = np.concatenate((q_ref, dq_ref, *ahead, share))
            chosen = self.agent.policy(self._layout.assemble(measured, row))
            self._action = np.clip(chosen, -1.0, 1.0)
        self._tick += 1
        tau = self._commanded(q_ref - q, dq_ref - dq, planned)
        return np.minimum(np.maximum(tau, -self.limit), self.limit)

    def plan(self, motion: Motion) -> np.ndarray | None:
        """The feedforward of the agent's model over the reference [N m], shape (N, n)."""
        return Feedforward(self.gains, self.limit, self.agent.model).plan(motion)

    def _ahead(self, q: np.ndarray, now: np.ndarray) -> list[np.ndarray]:
        """The reference at later times minus now [rad]; its end is held."""
        last = len(q) - 1
        return [q[min(self._tick + steps, last)] - now for steps in self._steps_ahead]

    def _commanded(
        self, error: np.ndarray, rate: np.ndarray, planned: np.ndarray
    ) -> np.ndarray:
        """Torque before it is clipped [N m], shape (n,)."""
        control, gains = self.agent.control, self.gains
        if control.kind == "torque":
            return control.scale * self._action
        if control.multiplies:
            factor, gains = scaled(gains, self._action)
            return factor * planned + gains.kp * error + gains.kd * rate
        added = control.scale * self._action
        return planned + gains.kp * error + gains.kd * rate + added
