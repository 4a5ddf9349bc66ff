"""Divergence: a simulated arm that diverges, noticed at once and explained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.control.pd import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.actions import Control, Gains, slower
from gapscope.envs.observation import FASTEST_OBSERVED
from gapscope.envs.sampled_loop import SampledLoop
from gapscope.envs.velocity_estimate import estimate_gains

SMALLEST = 1e-3
"""A share of the step or of the bandwidth below this is no remedy [1]."""
SMALLER = {
    "residual": "a smaller action_share or action_reach",
    "scale": "smaller actions",
    "gains": "smaller actions",
    "torque": "a smaller action_share",
}
"""What makes an action of 1 less, by kind of action."""


@dataclass(frozen=True)
class Divergence:
    """That the arm diverged, and what to change.

    Attributes:
        joint: the fastest joint, counted from 1.
        time: until which all was well, since the start of the episode [s].
        speed: of that joint [rad/s].
        causes: what lets it diverge, the most likely first, each with what to change.
    """

    joint: int
    time: float
    speed: float
    causes: tuple[str, ...]

    def as_info(self) -> dict[str, Any]:
        """As plain data, with all in one ``message``."""
        speed = (
            f"{self.speed:.3g} rad/s"
            if np.isfinite(self.speed)
            else "a speed that is no number"
        )
        what = f"joint {self.joint} diverged: {speed} after {self.time:.4g} s"
        return {
            "joint": self.joint,
            "time": self.time,
            "speed": self.speed,
            "message": "\n  ".join([what, *self.causes]),
        }


def diverged(dq: np.ndarray) -> bool:
    """Whether velocities [rad/s], shape (n,), are beyond those of an arm: above ``FASTEST_OBSERVED``, or not finite."""
    if dq.dot(dq) <= FASTEST_OBSERVED**2:  # then no joint can be
        return False
    return not np.abs(dq).max() <= FASTEST_OBSERVED


def explain(
    arm: NominalArm,
    body: RigidBody,
    control: Control,
    dt: float,
    time: float,
    q: np.ndarray,
    dq: np.ndarray,
    effects: tuple[AppliedEffect, ...] = (),
    acted: bool = True,
) -> Divergence:
    """Why the arm diverged.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        control: how actions become torque.
        dt: step of the simulation [s].
        time: since the start of the episode [s].
        q, dq: last position that made sense [rad], and velocity [rad/s], each (n,).
        effects: what the arm has beyond the nominal one.
        acted: whether an action of the episode was other than zero.
    """
    joint = fastest(dq)
    causes = (
        []
        if control.gains is None
        else unstable_loop(body.mass_matrix(q), arm, control.gains, dt)
    )
    if not np.isfinite(control.limit[joint]):
        causes.append(
            "no torque limit: give sheet={'torque_limit': [...]} in N m, one number per joint"
        )
    if arm.viscous[joint] == 0:
        causes.append(
            f"no damping: joint {joint + 1} has no viscous friction; give sheet={{'viscous': [...]}} in N m s/rad"
        )
    causes += _drivers(control, acted, effects)
    if not causes:
        causes.append("feedforward drives it: another model, or feedforward='none'")
    return Divergence(joint + 1, float(time), float(abs(dq[joint])), tuple(causes))


def _drivers(
    control: Control, acted: bool, effects: tuple[AppliedEffect, ...]
) -> list[str]:
    """What may drive the arm, each with what to change; actions that were zero do not."""
    found = [f"actions drive it: {SMALLER[control.kind]}"] if acted else []
    if effects:
        found.append("effects drive it: milder effects")
    if control.gains is None and not acted:
        found.append("nothing holds the arm: the action, zero here, is all its torque")
    return found


def fastest(dq: np.ndarray) -> int:
    """Index of the fastest joint; dq [rad/s], shape (n,), may hold what is no number, which counts as fastest."""
    return int(np.argmax(np.where(np.isfinite(dq), np.abs(dq), np.inf)))


def unstable_loop(
    mass: np.ndarray, arm: NominalArm, gains: Gains, dt: float
) -> list[str]:
    """What to change if the PD loop is unstable; nothing if it is stable. M [kg m^2] is without armature."""
    mass = mass + np.diag(arm.armature)
    longest = longest_step(mass, arm, gains, dt)
    if longest is None:
        return []
    lower = largest_stable(
        lambda share: stable(mass, arm, slower(gains, arm.viscous, share), dt), 1.0
    )
    ways = [f"time_step below {0.5 * longest:.2g} s"] if longest > 0 else []
    ways.append(
        f"bandwidth below {0.7 * lower:.2g} of what it is"
        if lower > 0
        else "a lower bandwidth"
    )
    return [
        f"too large a step or gains: the PD loop is unstable at {dt:.3g} s; {', or '.join(ways)}"
    ]


def longest_step(
    mass: np.ndarray, arm: NominalArm, gains: Gains, dt: float
) -> float | None:
    """Longest stable step of the sampled PD loop [s]: ``None`` if ``dt`` is stable, 0 if none is; see ``stable``.

    Args:
        mass: M with armature [kg m^2], shape (n, n).
        arm: its viscous friction is B [N m s/rad].
        gains: Kp and Kd.
        dt: [s].
    """
    return (
        None
        if stable(mass, arm, gains, dt)
        else largest_stable(lambda step: stable(mass, arm, gains, step), dt)
    )


def stable(mass: np.ndarray, arm: NominalArm, gains: Gains, dt: float) -> bool:
    """Whether all eigenvalues of the sampled PD loop lie within the unit circle.

    The loop is that of ``gapscope.envs.sampled_loop``, with the environment's velocity estimate; arguments as in
    ``longest_step``.
    """
    law = PD(rate=1.0 / dt, kp=gains.kp, kd=gains.kd)
    loop = SampledLoop(law, dt, estimate_gains(1.0 / dt))
    return loop.stable(mass, arm.viscous)


def largest_stable(works: Callable[[float], bool], fails: float) -> float:
    """The largest number that works, below one that fails, by bisection; 0 if ``SMALLEST`` of that fails too."""
    low, high = SMALLEST * fails, fails
    if not works(low):
        return 0.0
    for _ in range(20):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if works(middle) else (low, middle)
    return low
