"""How episodes and recordings of a simulated arm end before their time, noticed at once and explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.velocity_filter import filter_gains
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.actions import Gains
from gapscope.envs.episode import FASTEST_OBSERVED, Setup
from gapscope.envs.position_controller import SampledLoop, largest_stable, pd_loop

SMALLER = {
    "residual": "a smaller action_share or action_reach",
    "scale": "smaller actions",
    "gains": "smaller actions",
    "torque": "a smaller action_share",
}
"""What makes an action of 1 less, by kind of action."""

SAFE = 0.7
"""Share of the largest stable bandwidth that is advised [1]: half of kp."""


def diverged(dq: np.ndarray) -> bool:
    """Whether velocities [rad/s], shape (n,), are beyond those of an arm: above ``FASTEST_OBSERVED``, or not finite."""
    if dq.dot(dq) <= FASTEST_OBSERVED**2:  # then no joint can be
        return False
    return not np.abs(dq).max() <= FASTEST_OBSERVED


def divergence_info(
    setup: Setup,
    steps: int,
    q: np.ndarray,
    dq: np.ndarray,
    effects: tuple[AppliedEffect, ...] = (),
    acted: bool = True,
) -> dict[str, Any]:
    """``divergence``: the fastest joint, counted from 1, and why the arm diverged after some steps of the episode.

    Causes are told in the ``message``, the most likely first, each with what to change.

    Args:
        setup: of the environment.
        steps: of the simulation, after which all was well.
        q: last reading of the encoders [rad], shape (n,).
        dq: true velocity [rad/s], shape (n,).
        effects: of the episode.
        acted: whether one of its actions was other than zero.
    """
    arm, control, dt = setup.arm, setup.control, setup.timing.dt
    joint, time = fastest(dq), float(steps * dt)
    causes: list[str] = []
    if control.gains is not None:
        mass = setup.body.mass_matrix(q) + np.diag(arm.armature)
        longest = longest_step(control.gains, mass, arm.viscous, dt)
        if longest < dt:
            lower = pd_loop(control.gains, dt).stable_share([mass], arm.viscous)
            share = f" below {SAFE * lower:.2g} of what it is" if lower > 0 else ""
            ways = f"bandwidth{share}" if share else "a lower bandwidth"
            if longest > 0:
                ways = f"time_step below {0.5 * longest:.2g} s, or {ways}"
            what = f"the PD loop is unstable at {dt:.3g} s; {ways}"
            causes = [f"too large a step or gains: {what}"]
    if not np.isfinite(control.limit[joint]):
        causes.append(
            "no torque limit: give sheet={'torque_limit': [...]} in N m, one number per joint"
        )
    if arm.viscous[joint] == 0:
        causes.append(
            f"no damping: joint {joint + 1} has no viscous friction; give sheet={{'viscous': [...]}} in N m s/rad"
        )
    # actions that were zero drive nothing
    if acted:
        causes.append(f"actions drive it: {SMALLER[control.kind]}")
    if effects:
        causes.append("effects drive it: milder effects")
    if control.gains is None and not acted:
        causes.append("nothing holds the arm: the action, zero here, is all its torque")
    if not causes:
        causes.append("feedforward drives it: another model, or feedforward='none'")
    speed = float(abs(dq[joint]))
    fast = f"{speed:.3g} rad/s" if np.isfinite(speed) else "a speed that is no number"
    what = f"joint {joint + 1} diverged: {fast} after {time:.4g} s"
    return {
        "divergence": {
            "joint": joint + 1,
            "time": time,
            "speed": speed,
            "message": "\n  ".join([what, *causes]),
        }
    }


def fastest(dq: np.ndarray) -> int:
    """Index of the fastest joint; dq [rad/s], shape (n,), may hold what is no number, which counts as fastest."""
    return int(np.argmax(np.where(np.isfinite(dq), np.abs(dq), np.inf)))


def longest_step(
    gains: Gains, mass: np.ndarray, viscous: np.ndarray, dt: float
) -> float:
    """Longest stable step of the sampled PD loop up to ``dt`` [s], 0 if none is."""

    def works(step: float) -> bool:
        return pd_loop(gains, step).stable(mass, viscous)

    return dt if works(dt) else largest_stable(works, dt)


def title(arm: NominalArm, effects: Sequence[AppliedEffect]) -> str:
    """The arm with the names of its effects."""
    names = ", ".join(applied.name.replace("_", " ") for applied in effects)
    return f"{arm.name}: {names or 'no effects'}"


def stop_info(setup: Setup, q: np.ndarray, reading: np.ndarray) -> dict[str, str]:
    """``limit``: which joint came to its stop, if one did; true position and reading [rad], shape (n,)."""
    lowest, highest = setup.stops
    stopped = (q <= lowest) | (q >= highest)
    if not np.count_nonzero(stopped):
        return {}
    joint = int(stopped.argmax())
    name, read = setup.arm.joints[joint], f"{reading[joint]:.4g} rad"
    return {
        "limit": f"joint {joint + 1} ({name}) came to its stop; its encoder reads {read}"
    }


def ending(info: Mapping[str, Any]) -> str:
    """The first line of why an episode ended early; empty if it did not."""
    divergence: str = info.get("divergence", {}).get("message", "")
    return info.get("limit") or divergence.split("\n")[0]


def diverged_recording(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    controller: Controller,
    postures: np.ndarray,
    speed: np.ndarray,
    time: float,
) -> GapscopeError:
    """The error that says at which joint and when the arm diverged, and what lets it.

    Args:
        arm: the nominal arm.
        effects: what the simulated arm had beyond it.
        controller: its controller.
        postures: references before the divergence [rad], shape (K, n).
        speed: of the joints [rad/s], shape (n,).
        time: since the start of the recording [s].
    """
    joint, causes = fastest(speed), []
    estimate = filter_gains(
        controller.rate, controller.velocity_cutoff, controller.velocity_damping
    )
    loop = SampledLoop(controller, 1.0 / controller.rate, estimate)
    share = _stable_share(loop, CorrectedArm(arm), postures)
    if share < 1.0:
        lower = _lower(controller, share)
        causes.append(f"the controller's gains are too large for this arm: {lower}")
    elif effects:
        true = CorrectedArm(arm, effects)
        names = ", ".join(dict.fromkeys(effect.name for effect in effects))
        delay = float(np.max(true.quantity("delay")))
        late = loop._replace(late=round(delay / loop.dt))
        share = _stable_share(late, true, postures)
        causes.append(
            f"{names} makes a stable loop unstable: milder effects, or {_lower(controller, share)}"
            if share < 1.0
            else f"the loop is stable without {names}: milder effects, or lower gains of the controller"
        )
    if arm.torque_limit is None:
        causes.append("nothing limits the torque: give torque_limit in the data sheet")
    if arm.viscous[joint] == 0 and arm.armature[joint] == 0:
        causes.append(
            f"joint {joint + 1} has neither friction nor a rotor: give viscous and armature in the data sheet"
        )
    return GapscopeError(
        f"the simulated arm diverged at joint {joint + 1}, at t = {time:.3g} s",
        "; ".join(causes) or "lower the controller's gains",
    )


def _stable_share(loop: SampledLoop, arm: CorrectedArm, postures: np.ndarray) -> float:
    """Largest share of the loop's bandwidth that is stable at all postures [1]; 1 if the loop is."""
    nominal, body = arm.arm, RigidBody(arm.arm)
    own, rotors = np.diag(nominal.armature), np.diag(arm.quantity("rotor"))
    masses = [arm.body(body).mass_matrix(q) + rotors for q in postures]
    believed = [body.mass_matrix(q) + own for q in postures]
    return loop.stable_share(masses, nominal.viscous, believed)


def _lower(controller: Controller, share: float) -> str:
    """How much lower the gains must be."""
    names = [gain.name for gain in controller.gains]
    if share == 0.0:
        return f"no lower gains of this ratio are stable; check {', '.join(names)}, rate and velocity_filter"
    share *= SAFE
    factors = [f"{gain.name} by {share**gain.order:.2g}" for gain in controller.gains]
    return f"multiply {' and '.join(factors)}, half the stability limit"
