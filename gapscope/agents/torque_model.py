"""Models of an arm as a controller uses them: the torque to command so that a motion comes about."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect, External, Inertial, Path, Transmission


class TorqueModel(Protocol):
    """Inverse dynamics of an arm with n joints: the torque to command [N m].

    Positions are those that the encoders read.
    """

    def __call__(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torque of one sample [N m], shape (n,); q [rad], dq [rad/s], ddq [rad/s^2] of shape (n,)."""

    def series(self, motion: Motion) -> np.ndarray:
        """Torque of a motion known beforehand [N m], shape (N, n), with delay and lag compensated."""


class Gravity:
    """The nominal arm's gravity torque g(q), whatever the motion.

    Args:
        arm: the nominal arm.
    """

    def __init__(self, arm: NominalArm) -> None:
        # a controller meets each motion once
        self._body = RigidBody(arm, most_bytes=0)
        self._still = np.zeros(arm.n_joints)

    def __call__(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """g(q) [N m], shape (n,)."""
        return self._body.bias(q, self._still)

    def series(self, motion: Motion) -> np.ndarray:
        """g(q) [N m], shape (N, n)."""
        still = np.zeros_like(motion.q)
        return self._body.inverse_dynamics(motion.q, still, still)


class ArmModel:
    """Inverse dynamics of an arm with effects: nominal, identified or corrected, with its residual network.

    With N(q, dq, ddq) = M(q) ddq + C(q, dq) dq + g(q) + I ddq + friction + springs of the arm with payload, link errors
    and tilt, at the true position q = encoder - offset, what is commanded is what the way to the joint makes N of:
    (N - ripple - offset) / (1 + scale), plus the residual network. Signs are smoothed as in ``gapscope.arm.nominal``.

    ``series`` is ``CorrectedArm.predict``: delay T and lag L are undone by N(t + T) and N + L dN/dt, an elastic joint
    to first order in its twist. One sample has neither a future nor a past: evaluate it ``ahead`` of time; elasticity
    and backlash are left out, friction that drifts is that of the start, and the network takes the past to be like the
    present. An external force is left out of both, since it belongs to the recording in which it acted.

    Args:
        corrected: the arm with its effects.

    Attributes:
        ahead: how far ahead of time a single sample must be evaluated, delay plus lag per joint [s], shape (n,).

    Raises:
        InputError: an effect on a joint that does not exist, or a network of another arm.
    """

    def __init__(self, corrected: CorrectedArm) -> None:
        corrected.check()
        lasting = tuple(
            e for e in corrected.effects if not isinstance(e.effect, External)
        )
        self._corrected = replace(corrected, effects=lasting)
        self._nominal = RigidBody(corrected.arm, most_bytes=0)
        self._body = self._corrected.body(self._nominal)
        self.ahead = corrected.quantity("delay") + corrected.quantity("lag")
        instant = tuple(e for e in lasting if _instant(e.effect))
        self._instant = replace(self._corrected, effects=instant)

    @property
    def corrected(self) -> CorrectedArm:
        """The arm with its lasting effects."""
        return self._corrected

    def __call__(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torque to command [N m], shape (n,), of one sample, each (n,)."""
        arm = self._instant
        # two equal samples: a rate exists, and what the network sees of the past is the present
        t = np.array([0.0, 1.0])
        motion = Motion(t, np.array([q, q]), np.array([dq, dq]), np.array([ddq, ddq]))
        true = arm.true_position(motion.q)[0]
        rigid = self._body.torque(true, dq, ddq)
        needed = arm.needed_torque(np.array([rigid, rigid]), motion)
        torque = arm.recorded_torque(needed, motion)
        if arm.residual is not None:
            torque = torque + arm.residual.torque(motion, torque)
        return np.asarray(torque[0])

    def series(self, motion: Motion) -> np.ndarray:
        """Torque to command [N m], shape (N, n), over a motion."""
        return self._corrected.predict(self._nominal, motion)


def _instant(effect: Effect) -> bool:
    """Whether an effect is left for a single sample to undo: those of the bodies are in the model already."""
    bodies = isinstance(effect, Inertial) and effect.scope != "joint"
    in_time = isinstance(effect, Path) and effect.varies_with == "time"
    return not (bodies or in_time or isinstance(effect, Transmission))
