"""Divergence: a simulated arm that runs away, noticed at once and explained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from arm.dynamics import RigidBody
from arm.nominal import NominalArm
from envs.actions import Control, Gains
from envs.observation import FASTEST


@dataclass(frozen=True)
class Divergence:
    """That the arm ran away, and what to change.

    Attributes:
        joint: the fastest joint, counted from 1.
        time: until which all was well, since the start of the episode [s].
        speed: of that joint [rad/s].
        causes: what lets it run away, the most likely first, each with what to change.
    """

    joint: int
    time: float
    speed: float
    causes: tuple[str, ...]

    def as_info(self) -> dict[str, Any]:
        """As plain data, with all in one ``message``."""
        what = f"joint {self.joint} ran away: {self.speed:.3g} rad/s after {self.time:.4g} s"
        return {
            "joint": self.joint,
            "time": self.time,
            "speed": self.speed,
            "message": "\n  ".join([what, *self.causes]),
        }


def diverged(dq: np.ndarray) -> bool:
    """Whether velocities [rad/s], shape (n,), are not those of an arm: beyond ``FASTEST`` together, or not finite."""
    return not dq.dot(dq) <= FASTEST**2


def explain(
    arm: NominalArm,
    body: RigidBody,
    control: Control,
    dt: float,
    time: float,
    q: np.ndarray,
    dq: np.ndarray,
) -> Divergence:
    """Why the arm ran away.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        control: how actions become torque.
        dt: step of the simulation [s].
        time: since the start of the episode [s].
        q, dq: last position that made sense [rad], and velocity [rad/s], each (n,).
    """
    joint = int(np.argmax(np.where(np.isfinite(dq), np.abs(dq), np.inf)))
    causes, gains = [], control.gains
    longest = None if gains is None else longest_step(body.mass_matrix(q) + np.diag(arm.armature), arm, gains, dt)
    if longest is not None:
        causes.append(
            f"too large a step: the PD loop is unstable at {dt:.3g} s; time_step below {0.5 * longest:.2g} s, "
            "or a lower bandwidth"
        )
    if not np.isfinite(control.limit[joint]):
        causes.append("no torque limit: give sheet={'torque_limit': [...]} in N m, one number per joint")
    if arm.viscous[joint] == 0:
        causes.append(
            f"no damping: joint {joint + 1} has no viscous friction; give sheet={{'viscous': [...]}} in N m s/rad"
        )
    causes.append("actions or effects drive it: smaller actions, or milder effects")
    return Divergence(joint + 1, float(time), float(abs(dq[joint])), tuple(causes))


def longest_step(mass: np.ndarray, arm: NominalArm, gains: Gains, dt: float) -> float | None:
    """Longest stable step of the sampled PD loop [s], or ``None`` where ``dt`` is stable.

    The loop is (M + dt B) dq[k+1] = M dq[k] - dt (Kp q[k] + Kd dq[k]), q[k+1] = q[k] + dt dq[k+1], without the lag of
    the velocity estimate. It is stable if all eigenvalues lie within the unit circle.

    Args:
        mass: M with armature [kg m^2], shape (n, n).
        arm: its viscous friction is B [N m s/rad].
        gains: Kp and Kd.
        dt: [s].
    """

    def stable(step: float) -> bool:
        n = len(mass)
        to_velocity = np.linalg.solve(
            mass + step * np.diag(arm.viscous), np.hstack([-step * np.diag(gains.kp), mass - step * np.diag(gains.kd)])
        )
        to_position = np.hstack([np.eye(n), np.zeros((n, n))]) + step * to_velocity
        return bool(np.abs(np.linalg.eigvals(np.vstack([to_position, to_velocity]))).max() < 1.0)

    if stable(dt):
        return None
    low, high = 1e-3 * dt, dt
    for _ in range(20):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)
