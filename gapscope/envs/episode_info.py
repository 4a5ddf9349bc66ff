"""Information about an episode: how it ended, its title, and the hidden state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.divergence import explain
from gapscope.envs.episode import Setup


def title(arm: NominalArm, effects: Sequence[AppliedEffect]) -> str:
    """The arm with the names of its effects."""
    names = ", ".join(applied.name.replace("_", " ") for applied in effects)
    return f"{arm.name}: {names or 'no effects'}"


def divergence_info(
    setup: Setup,
    steps: int,
    q: np.ndarray,
    dq: np.ndarray,
    effects: tuple[AppliedEffect, ...],
    acted: bool,
) -> dict[str, Any]:
    """``divergence``: why the arm diverged after some steps of the episode.

    Args:
        setup: of the environment.
        steps: of the simulation.
        q: last reading of the encoders [rad], shape (n,).
        dq: true velocity [rad/s], shape (n,).
        effects: of the episode.
        acted: whether one of its actions was other than zero.
    """
    dt = setup.timing.dt
    arm, body, control = setup.arm, setup.body, setup.control
    divergence = explain(arm, body, control, dt, steps * dt, q, dq, effects, acted)
    return {"divergence": divergence.as_info()}


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


def truth(
    q: np.ndarray,
    dq: np.ndarray,
    commanded: np.ndarray,
    applied: np.ndarray,
    effects: Sequence[AppliedEffect],
) -> dict[str, Any]:
    """The true motion [rad], [rad/s] and torque [N m], each (n,), and the effects: hidden from controllers."""
    return {
        "q_true": q.copy(),
        "dq_true": dq.copy(),
        "torque_commanded": commanded.copy(),
        "torque_applied": applied.copy(),
        "effects": [described(applied) for applied in effects],
    }


def described(applied: AppliedEffect) -> dict[str, Any]:
    """An effect as in ``corrected.yaml``: plain data."""
    values = {name: value.tolist() for name, value in applied.parameters.items()}
    return {
        "effect": applied.name,
        "joints": list(applied.joints),
        "parameters": values,
    }
