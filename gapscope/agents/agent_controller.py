"""A trained agent as a controller: every few ticks it acts on top of PD and a model's feedforward."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gapscope.agents.controllers import Feedforward
from gapscope.agents.torque_model import TorqueModel
from gapscope.arm.motions.motion import Motion
from gapscope.envs.actions import Control, Gains, scaled
from gapscope.envs.episode import Layout


@dataclass(frozen=True, eq=False)
class AgentModel:
    """A trained agent beside models: a policy, and the model that it was trained on top of.

    Attributes:
        policy: action in -1 .. 1 of an observation of the environment.
        model: whose feedforward it acts on, ``None`` for PD alone.
        control: how its actions become torque.
        look_ahead: how far ahead it observes the reference [s].
        period: between its actions [s].
        digest: of its files.
    """

    policy: Callable[[np.ndarray], np.ndarray]
    model: TorqueModel | None
    control: Control
    look_ahead: tuple[float, ...]
    period: float
    digest: str


Candidate = TorqueModel | AgentModel | None
"""What is evaluated: a model, an agent on top of one, or PD alone."""


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
