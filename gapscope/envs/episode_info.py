"""Information about an episode: how it ended, its title, and the hidden state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.actions import Control
from gapscope.envs.divergence import explain
from gapscope.envs.plant import ControlledArm


def title(arm: NominalArm, effects: Sequence[AppliedEffect]) -> str:
    """The arm with the names of its effects."""
    names = ", ".join(applied.name.replace("_", " ") for applied in effects)
    return f"{arm.name}: {names or 'no effects'}"


def divergence_info(
    arm: NominalArm,
    body: RigidBody,
    control: Control,
    dt: float,
    steps: int,
    plant: ControlledArm,
) -> dict[str, Any]:
    """``divergence``: why the arm diverged after some steps of the episode of dt [s] each."""
    velocity = plant.simulated.dq
    time, q = steps * dt, plant.position
    divergence = explain(arm, body, control, dt, time, q, velocity, plant.effects)
    return {"divergence": divergence.as_info()}


def stop_info(
    arm: NominalArm, plant: ControlledArm, lowest: np.ndarray, highest: np.ndarray
) -> dict[str, str]:
    """``limit``: which joint came to its stop, if one lies outside these positions [rad], shape (n,)."""
    q = plant.simulated.q
    stopped = (q <= lowest) | (q >= highest)
    if not np.count_nonzero(stopped):
        return {}
    joint = int(stopped.argmax())
    read = f"its encoder reads {plant.position[joint]:.4g} rad"
    return {
        "limit": f"joint {joint + 1} ({arm.joints[joint]}) came to its stop; {read}"
    }


def ending(info: Mapping[str, Any]) -> str:
    """The first line of why an episode ended early; empty if it did not."""
    divergence: str = info.get("divergence", {}).get("message", "")
    return info.get("limit") or divergence.split("\n")[0]


def truth(plant: ControlledArm) -> dict[str, Any]:
    """The true motion and torque, and the effects: hidden from controllers."""
    simulated = plant.simulated
    return {
        "q_true": simulated.q.copy(),
        "dq_true": simulated.dq.copy(),
        "torque_commanded": plant.torque.copy(),
        "torque_applied": simulated.applied.copy(),
        "effects": [described(applied) for applied in plant.effects],
    }


def described(applied: AppliedEffect) -> dict[str, Any]:
    """An effect as in ``corrected.yaml``: plain data."""
    values = {name: value.tolist() for name, value in applied.parameters.items()}
    return {
        "effect": applied.name,
        "joints": list(applied.joints),
        "parameters": values,
    }
