"""A recording of the true arm: the sampled controller and the joints around MuJoCo's rigid bodies."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.blind_check.generator import joint, loop
from gapscope.blind_check.generator.motions import Motion
from gapscope.blind_check.generator.plant import Columns, TrueArm
from gapscope.blind_check.generator.rigid import (
    inverse_dynamics,
    model_of,
    mujoco,
    tip_body,
)
from gapscope.blind_check.generator.urdf import text_of

SETTLES = 0.4
"""Time after which a command that is clipped counts [s]."""
LOST = 0.7
"""Distance from the reference at which a run is given up [rad]."""


def simulate(
    plant: TrueArm, motion: Motion, ahead: np.ndarray, noise: np.ndarray
) -> Columns | None:
    """Run the true arm along a motion; one row per tick of the controller.

    Args:
        plant: the true arm.
        motion: reference, sampled at the controller's rate.
        ahead: feedforward [N m], (N, n).
        noise: of the encoders [rad], (N, n).

    Returns:
        t, q, dq, tau, q_ref, dq_ref; ``None`` where the loop is unstable or the controller's limit was reached.

    Raises:
        GapscopeError: MuJoCo or numba is not installed.
    """
    if not joint.COMPILED:
        raise GapscopeError(
            "the blind check's generator needs numba", "pip install 'gapscope[blind]'"
        )
    model = model_of(text_of(plant.root))
    model.opt.timestep = plant.healthy.step
    model.opt.gravity[:] = plant.gravity
    data, par, state = (
        mujoco.MjData(model),
        plant.record(),
        np.zeros(1, dtype=joint.STATE),
    )
    _start(plant, model, data, state, motion.q[0])
    n, count, every = (
        plant.arm.n,
        len(motion.t),
        round(1 / plant.loop.rate / plant.healthy.step),
    )
    memory, filt = np.zeros(1, dtype=loop.FILTER), plant.loop.coefficients()
    ring, out = np.zeros((joint.RING, n)), np.zeros((count, 3, n))
    soft = par["stiffness"][0, :n] > 0
    model.dof_armature[:] = np.where(soft, 0.0, par["armature"][0, :n])
    q, dq, damping, force = data.qpos, data.qvel, model.dof_damping, data.qfrc_applied
    outer = _Outer(plant, model, data)
    clipped, step = 0, 0
    for k in range(count):
        clip = loop.command(
            par,
            state,
            memory,
            filt,
            q,
            noise[k],
            motion.q[k],
            motion.dq[k],
            ahead[k],
            out[k],
            k == 0,
        )
        clipped += clip if motion.t[k] > SETTLES else 0
        if clipped or not np.abs(out[k, 0] - motion.q[k]).max() < LOST:
            return None
        for _ in range(every):
            joint.advance(par, state, ring, out[k, 2], step, q, dq, damping, force)
            if outer.acts:
                outer(step * plant.healthy.step)
            mujoco.mj_step(model, data)
            step += 1
    return {
        "t": motion.t,
        "q": out[:, 0],
        "dq": out[:, 1],
        "tau": out[:, 2],
        "q_ref": motion.q,
        "dq_ref": motion.dq,
    }


def _start(
    plant: TrueArm, model: Any, data: Any, state: np.ndarray, q: np.ndarray
) -> None:
    """Begin at rest where the encoders read the reference, soft joints deflected by gravity, joints cold."""
    n, v = plant.arm.n, plant.values
    motor = q - v["encoder"]
    gravity = inverse_dynamics(model, motor[None], np.zeros((1, n)), np.zeros((1, n)))[
        0
    ]
    give = np.where(
        v["stiffness"] > 0,
        gravity / np.maximum(v["stiffness"], 1e-9) + v["play"] * np.sign(gravity),
        0.0,
    )
    data.qpos[:] = motor - give
    state["theta"][0, :n] = motor
    state["cold"] = 1.0
    for name in ("first", "second"):
        state[name][0, :n] = gravity


class _Outer:
    """Forces on the tip and motion of the base, where the plant has them."""

    def __init__(self, plant: TrueArm, model: Any, data: Any) -> None:
        self.plant, self.model, self.data, self.tip = (
            plant,
            model,
            data,
            tip_body(model),
        )
        self.acts = plant.push is not None or plant.shaken is not None
        self._last: np.ndarray | None = None

    def __call__(self, t: float) -> None:
        """Set what acts in the step that begins at t [s]."""
        if self.plant.shaken is not None:
            size, frequency, phase = self.plant.shaken
            self.model.opt.gravity[:] = self.plant.gravity + size * np.sin(
                2 * np.pi * frequency * t + phase
            )
        if self.plant.push is not None:
            here = self.data.xipos[self.tip].copy()
            before = here if self._last is None or t == 0.0 else self._last
            speed = (here - before) / self.plant.healthy.step
            self._last = here
            self.data.xfrc_applied[self.tip, :3] = self.plant.push(t, here, speed)
