"""Why a simulated arm diverged while it was recorded: its gains, its effects, or what its data sheet lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.velocity_filter import filter_gains
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.divergence import fastest, largest_stable
from gapscope.envs.sampled_loop import SampledLoop

SAFE = 0.7
"""Share of the largest stable bandwidth that is advised [1]: half of kp."""


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
    joint = fastest(speed)
    estimate = filter_gains(
        controller.rate, controller.velocity_cutoff, controller.velocity_damping
    )
    loop = SampledLoop(controller, 1.0 / controller.rate, estimate)
    share = _stable_share(loop, CorrectedArm(arm), postures)
    if share < 1.0:
        causes = [
            f"the controller's gains are too large for this arm: {_lower(controller, share)}"
        ]
    elif effects:
        causes = [_effects_at_work(loop, CorrectedArm(arm, effects), postures)]
    else:
        causes = []
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


def _effects_at_work(
    loop: SampledLoop, true: CorrectedArm, postures: np.ndarray
) -> str:
    """What the effects do to a loop that is stable without them."""
    names = ", ".join(dict.fromkeys(effect.name for effect in true.effects))
    delay = float(np.max(true.quantity("delay")))
    late = replace(loop, late=round(delay / loop.dt))
    share = _stable_share(late, true, postures)
    if share < 1.0:
        return f"{names} makes a stable loop unstable: milder effects, or {_lower(loop.controller, share)}"
    return f"the loop is stable without {names}: milder effects, or lower gains of the controller"


def _stable_share(loop: SampledLoop, arm: CorrectedArm, postures: np.ndarray) -> float:
    """Largest share of the loop's bandwidth that is stable at all postures [1]; 1 if the loop is."""
    nominal = arm.arm
    body = arm.body(RigidBody(nominal))
    rotors = arm.quantity("rotor")
    masses = [body.mass_matrix(q) + np.diag(rotors) for q in postures]
    believed_body, own = RigidBody(nominal), np.diag(nominal.armature)
    believed = [believed_body.mass_matrix(q) + own for q in postures]

    def stable(share: float) -> bool:
        slower = loop.times(share)
        pairs = zip(masses, believed, strict=True)
        return all(
            slower.stable(m, nominal.viscous, nominal_m) for m, nominal_m in pairs
        )

    return 1.0 if stable(1.0) else largest_stable(stable, 1.0)


def _lower(controller: Controller, share: float) -> str:
    """How much lower the gains must be."""
    names = [gain.name for gain in controller.gains]
    if share == 0.0:
        return f"no lower gains of this ratio are stable; check {', '.join(names)}, rate and velocity_filter"
    share *= SAFE
    factors = [f"{gain.name} by {share**gain.order:.2g}" for gain in controller.gains]
    return f"multiply {' and '.join(factors)}, half the stability limit"
