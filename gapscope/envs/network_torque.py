"""The torque of a residual network in the simulated arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual.inputs import channels, channels_with
from gapscope.effects.residual.memory import Memory
from gapscope.effects.residual.model import ResidualNetwork

SPACING = 5
"""Steps between values on the reference."""


class NetworkTorque:
    """What a residual network says of an arm that moves near its reference, n joints.

    The network adds to the torque that must be commanded, so its torque is taken off what is commanded before it
    reaches the arm: r(t) = R(reference)(t) + R(measured) - R(reference). The first is computed every ``SPACING``
    steps with lines between, the difference at every action and held. The measured motion is that of the encoders at
    the actions before, with the acceleration of the reference and the load that the arm without network would need.

    Args:
        corrected: the arm with its network, and with the effects of this episode.
        motion: the reference at every step of the simulation.
        sub_steps: steps per action.
        payload: known body on the last link, or ``None``.
    """

    def __init__(
        self,
        corrected: CorrectedArm,
        motion: Motion,
        sub_steps: int,
        payload: KnownLoad | None = None,
    ) -> None:
        assert corrected.residual is not None
        self._residual = corrected.residual
        load = replace(corrected, residual=None).predict(
            RigidBody(corrected.arm).carrying(payload), motion
        )
        self._planned = _on_lines(self._residual, motion, load)
        rows = slice(None, None, sub_steps)
        coarse = Motion(
            motion.t[rows], motion.q[rows], motion.dq[rows], motion.ddq[rows]
        )
        self._load, self._ddq = load[rows], coarse.ddq
        self._rate = coarse.rate
        self._on_reference = self._residual.torque(coarse, self._load)
        # what is not yet measured is never looked at
        self._seen = channels(coarse, self._load)
        self._memory = Memory(coarse.q[0])
        self._off = np.zeros(motion.q.shape[1])

    def see(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Take note of position [rad] and velocity [rad/s], each (n,), before an action, numbered from 0."""
        load, ddq = self._load[number], self._ddq[number]
        if number == 0:
            self._memory = Memory(q)
        memory = self._memory.advance(q, load, 1.0 / self._rate)
        now = channels_with(memory[:, None], q[None], dq[None], ddq[None], load[None])
        self._seen[:, number] = now[:, 0]
        windows = self._residual.inputs.windows_of(
            self._seen, self._rate, np.array([number])
        )
        torque = self._residual.of_windows(windows).torque[0]
        self._off = torque - self._on_reference[number]

    def torque(self, step: int) -> np.ndarray:
        """The network's torque at a step of the simulation [N m], shape (n,)."""
        return np.asarray(self._planned[step] + self._off)


def _on_lines(
    residual: ResidualNetwork, motion: Motion, load: np.ndarray
) -> np.ndarray:
    """Residual torque at every step [N m], shape (N, n), on lines between every ``SPACING``-th step."""
    rows = np.append(np.arange(0, len(motion.t) - 1, SPACING), len(motion.t) - 1)
    said = residual.of_windows(residual.inputs.windows(motion, load, rows)).torque
    place = np.searchsorted(rows, np.arange(len(motion.t)), side="right").clip(
        1, len(rows) - 1
    )
    part = (
        (np.arange(len(motion.t)) - rows[place - 1]) / (rows[place] - rows[place - 1])
    )[:, None]
    return np.asarray((1 - part) * said[place - 1] + part * said[place])
