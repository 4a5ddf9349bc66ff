"""Controllers of a joint torque: PD with or without a model's feedforward, computed torque, and a trained agent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.agents.models import AgentModel, TorqueModel
from gapscope.arm.control import Targets
from gapscope.arm.motions.motion import Motion
from gapscope.envs.actions import DAMPING, Gains, scaled
from gapscope.envs.arguments import check_values
from gapscope.envs.environment import Layout


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
    damping: float = DAMPING

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_values(vars(self), "environment", "evaluation")

    def gains(self, inertia: np.ndarray) -> Gains:
        """kp = w^2 M [N m/rad] and kd = 2 zeta w M [N m s/rad], each (n,), on inertias M [kg m^2], shape (n,)."""
        stiffness = (2 * np.pi * self.bandwidth) ** 2
        rate = 2 * self.damping * 2 * np.pi * self.bandwidth
        return Gains(stiffness * inertia, rate * inertia)

    def times(self, factor: float) -> Tuning:
        """The same with the bandwidth multiplied: kp grows with the square of the factor, kd with the factor."""
        return Tuning(self.bandwidth * factor, self.damping)


class Feedforward:
    """tau = model(q_ref, dq_ref, ddq_ref) + kp (q_ref - q) + kd (dq_ref - dq), clipped at +-limit.

    It is called at every tick, and its torque is held until the next; other controllers are kinds of it.

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
        """Start anew on a reference, given at every tick; here nothing is to be reset."""

    def plan(self, motion: Motion) -> np.ndarray:
        """Feedforward of a reference known beforehand [N m], shape (N, n); zeros if it takes none."""
        if self.model is None:
            return np.zeros_like(motion.q)
        return self.model.series(motion)

    def __call__(self, now: Targets, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque to command [N m], shape (n,).

        Args:
            now: reference, and what ``plan`` has for this tick, each (n,).
            q, dq: position of the encoders [rad], velocity estimated from them [rad/s], each (n,).
        """
        tau = self.gains.kp * (now.q - q) + self.gains.kd * (now.dq - dq)
        tau += now.torque
        return np.minimum(np.maximum(tau, -self.limit), self.limit)


class ComputedTorque(Feedforward):
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
        # nothing is planned: the model is inside the loop
        super().__init__(tuning.gains(np.ones(len(limit))), limit)
        self.inside = model

    def __call__(self, now: Targets, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque to command [N m], shape (n,)."""
        stiffness, rate = self.gains
        wanted = now.ddq + stiffness * (now.q - q) + rate * (now.dq - dq)
        tau = self.inside(q, now.dq, wanted)
        return np.minimum(np.maximum(tau, -self.limit), self.limit)


class AgentController(Feedforward):
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
        super().__init__(gains, limit, agent.model)
        self.agent = agent
        self._layout = Layout(len(limit), agent.look_ahead, agent.control.size)

    def begin(self, motion: Motion) -> None:
        """Forget earlier actions; the reference at every tick follows."""
        self._reference, self._tick = motion.q, 0
        self._action = np.zeros(self.agent.control.size)
        self._every = max(1, round(self.agent.period * motion.rate))
        self._ahead = [round(time * motion.rate) for time in self.agent.look_ahead]

    def __call__(self, now: Targets, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque to command [N m], shape (n,); ``begin`` comes before the first tick."""
        control, planned = self.agent.control, now.torque
        if self._tick % self._every == 0:
            # the end of the reference is held
            ahead = self._reference.take(
                [self._tick + steps for steps in self._ahead], axis=0, mode="clip"
            )
            row = (now.q, now.dq, (ahead - now.q).ravel(), planned / control.rated)
            measured = (q, dq, now.q - q, self._action)
            chosen = self.agent.policy(
                self._layout.assemble(measured, np.concatenate(row))
            )
            self._action = np.clip(chosen, -1.0, 1.0)
        self._tick += 1
        error, rate, (kp, kd) = now.q - q, now.dq - dq, self.gains
        if control.multiplies:
            factor, (kp, kd) = scaled(self.gains, self._action)
            tau = factor * planned + kp * error + kd * rate
        elif control.kind == "torque":
            tau = control.scale * self._action
        else:
            tau = planned + kp * error + kd * rate + control.scale * self._action
        return np.minimum(np.maximum(tau, -self.limit), self.limit)
