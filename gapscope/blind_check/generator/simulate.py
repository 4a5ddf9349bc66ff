"""A recording of the true arm: the sampled controller and the joints around MuJoCo's rigid bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.blind_check.generator import joint, loop
from gapscope.blind_check.generator.motions import Motion
from gapscope.blind_check.generator.rigid import (
    inverse_dynamics,
    model_of,
    mujoco,
    tip_body,
)
from gapscope.blind_check.generator.true_arm import Columns, TrueArm
from gapscope.blind_check.generator.urdf import text_of

SETTLING = 0.4
"""Time after which a command that is clipped counts [s]."""
MAX_ERROR = 0.7
"""Distance from the reference at which a run is given up [rad]."""

Steer = Callable[[int, np.ndarray], np.ndarray]
"""Torque fed forward [N m], (n,), from the number of the tick and the encoders' last reading [rad], (n,)."""


def simulate(
    plant: TrueArm,
    motion: Motion,
    ahead: np.ndarray,
    noise: np.ndarray,
    steer: Steer | None = None,
    later: tuple[float, TrueArm] | None = None,
) -> Columns | None:
    """Run the true arm along a motion; one row per tick of the controller.

    Args:
        plant: the true arm.
        motion: reference, sampled at the controller's rate.
        ahead: feedforward [N m], (N, n).
        noise: of the encoders [rad], (N, n).
        steer: what is fed forward at each tick in place of ``ahead``, such as an agent's torque on top of it.
        later: a time [s], and the arm that goes on in its place from then on, as when a load is picked up.

    Returns:
        t, q, dq, tau, q_ref, dq_ref; ``None`` if the loop is unstable or the controller's limit was reached.

    Raises:
        GapscopeError: MuJoCo or numba is not installed.
    """
    if not joint.COMPILED:
        raise GapscopeError(
            "the blind check's generator needs numba", "pip install 'gapscope[blind]'"
        )
    simulation = _Simulation(plant, motion.q[0])
    out = np.zeros((len(motion.t), 3, plant.arm.n))
    change = np.inf if later is None else later[0]
    settled = SETTLING
    for k in range(len(motion.t)):
        fed = ahead[k]
        if steer is not None:
            fed = steer(k, motion.q[0] if k == 0 else out[k - 1, 0])
        if later is not None and motion.t[k] >= change:
            simulation = simulation.taken_over_by(later[1])
            change, settled = np.inf, motion.t[k] + SETTLING
        clipped = simulation.command(
            noise[k], motion.q[k], motion.dq[k], fed, out[k], k == 0
        )
        if clipped and motion.t[k] > settled:
            return None
        # written so that a position that is not a number counts as lost
        if not np.abs(out[k, 0] - motion.q[k]).max() < MAX_ERROR:
            return None
        simulation.advance(out[k, 2])
    return {
        "t": motion.t,
        "q": out[:, 0],
        "dq": out[:, 1],
        "tau": out[:, 2],
        "q_ref": motion.q,
        "dq_ref": motion.dq,
    }


class _Simulation:
    """Rigid bodies of MuJoCo, the compiled joints and the sampled controller, at rest at the start.

    Args:
        plant: the true arm.
        start: position that the encoders read at the start [rad], (n,).
    """

    def __init__(self, plant: TrueArm, start: np.ndarray) -> None:
        n = plant.arm.n
        self._dt = plant.healthy.step
        self._steps_per_tick = round(1 / plant.loop.rate / self._dt)
        self._steps_done = 0
        self._model = model_of(text_of(plant.root))
        self._model.opt.timestep = self._dt
        self._model.opt.gravity[:] = plant.gravity
        self._data = mujoco.MjData(self._model)
        # views into MuJoCo's memory: what is written there acts in the next step
        self._q, self._dq = self._data.qpos, self._data.qvel
        self._damping = self._model.dof_damping
        self._force = self._data.qfrc_applied
        self._joints = plant.record()
        self._state = np.zeros(1, dtype=joint.STATE)
        _start(plant, self._model, self._data, self._state, start)
        self._memory = np.zeros(1, dtype=loop.FILTER)
        self._filter = plant.loop.coefficients()
        self._history = np.zeros((joint.HISTORY, n))
        # a compliant joint has its rotor as a mass of its own, a rigid one on the diagonal
        compliant = self._joints["stiffness"][0, :n] > 0
        rotors = self._joints["armature"][0, :n]
        self._model.dof_armature[:] = np.where(compliant, 0.0, rotors)
        self._outer = _OuterForces(plant, self._model, self._data, self._state)

    def taken_over_by(self, plant: TrueArm) -> _Simulation:
        """Another arm in the state of this one: its motion, joints, controller and clock."""
        other = _Simulation(plant, self._q.copy())
        other._q[:], other._dq[:] = self._q, self._dq
        other._state, other._memory = self._state, self._memory
        other._history, other._steps_done = self._history, self._steps_done
        return other

    def command(
        self,
        noise: np.ndarray,
        q_ref: np.ndarray,
        dq_ref: np.ndarray,
        ahead: np.ndarray,
        out: np.ndarray,
        first: bool,
    ) -> int:
        """One tick of the controller; see ``loop.command``."""
        clipped: int = loop.command(
            self._joints,
            self._state,
            self._memory,
            self._filter,
            self._q,
            noise,
            q_ref,
            dq_ref,
            ahead,
            out,
            first,
        )
        return clipped

    def advance(self, command: np.ndarray) -> None:
        """The steps until the next tick, under a command that is held [N m], (n,)."""
        for _ in range(self._steps_per_tick):
            joint.advance(
                self._joints,
                self._state,
                self._history,
                command,
                self._steps_done,
                self._q,
                self._dq,
                self._damping,
                self._force,
            )
            if self._outer.active:
                self._outer.apply(self._steps_done * self._dt)
            mujoco.mj_step(self._model, self._data)
            self._steps_done += 1


def _start(
    plant: TrueArm, model: Any, data: Any, state: np.ndarray, q: np.ndarray
) -> None:
    """Begin at rest at the encoders' reading q [rad]: compliant joints deflected by gravity, joints cold."""
    n, values = plant.arm.n, plant.values
    motor = q - values["encoder"]
    still = np.zeros((1, n))
    gravity = inverse_dynamics(model, motor[None], still, still)[0]
    stiffness = values["stiffness"]
    twist = gravity / np.maximum(stiffness, 1e-9) + values["play"] * np.sign(gravity)
    data.qpos[:] = motor - np.where(stiffness > 0, twist, 0.0)
    state["theta"][0, :n] = motor
    state["cold"] = 1.0
    for name in ("first", "second"):
        state[name][0, :n] = gravity


class _OuterForces:
    """Force on the tip, motion of the base and further torques on the joints, if the arm has them."""

    def __init__(
        self, plant: TrueArm, model: Any, data: Any, state: np.ndarray
    ) -> None:
        self.plant = plant
        self.model = model
        self.data = data
        self.tip = tip_body(model)
        self.drive = state["drive"][0, : plant.arm.n]
        moved = plant.push is not None or plant.shaken is not None
        self.active = moved or bool(plant.resisting)
        self._last: np.ndarray | None = None

    def apply(self, t: float) -> None:
        """Set what acts in the step that begins at t [s]."""
        plant = self.plant
        for resisting in plant.resisting:
            q, dq = self.data.qpos, self.data.qvel
            self.data.qfrc_applied[:] -= resisting(t, q, dq, self.drive)
        if plant.shaken is not None:
            size, frequency, phase = plant.shaken
            swing = np.sin(2 * np.pi * frequency * t + phase)
            self.model.opt.gravity[:] = plant.gravity + size * swing
        if plant.push is not None:
            here = self.data.xipos[self.tip].copy()
            before = here if self._last is None or t == 0.0 else self._last
            velocity = (here - before) / plant.healthy.step
            self._last = here
            self.data.xfrc_applied[self.tip, :3] = plant.push(t, here, velocity)
