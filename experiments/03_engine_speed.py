"""Speed of the simulated arm against bare engine loops, in one run: steps of 1 ms, at 20, 4 and 1 sub-steps per action.

The bare PyBullet loop sets torques, steps and reads joint states; the bare MuJoCo loop sets torque, steps and copies
the state. All loops play the torque of the same Fourier motion; a ratio is the median over
rounds in which the loops take turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np
import pybullet

from arm.dynamics import RigidBody
from arm.motion import Motion
from arm.nominal import NominalArm
from arm.robots import load_nominal_arm
from arm.trajectory import Fourier, urdf_limits
from effects.applied import AppliedEffect
from effects.corrected import CorrectedArm
from envs.engines.mujoco import MuJoCoEngine
from envs.engines.pybullet import PyBulletEngine
from envs.simulated_arm import SimulatedArm

JOINTS = (1, 2, 3, 4, 5, 6, 7)
POSTURE = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 0.8, 0.0])
DURATION, DT, ROUNDS = 2.0, 1e-3, 21
SCALE = np.array([3.0, 3.5, 2.0, 2.5, 1.2, 0.8, 0.5])
FRICTION = (
    AppliedEffect("coulomb_friction", JOINTS, {"torque": SCALE}),
    AppliedEffect("viscous_friction", JOINTS, {"coefficient": SCALE}),
    AppliedEffect("stribeck_friction", JOINTS, {"torque": 0.3 * SCALE, "velocity": np.full(7, 0.1)}),
    AppliedEffect("load_friction", JOINTS, {"coefficient": np.full(7, 0.1)}),
    AppliedEffect("friction_drift", JOINTS, {"amplitude": np.full(7, 0.3), "time_constant": np.full(7, 300.0)}),
)


def reference(arm: NominalArm) -> tuple[Fourier, np.ndarray]:
    """A Fourier motion and its times [s]."""
    limits = urdf_limits(RigidBody(arm), 6.0)._replace(velocity=np.full(7, 1.5))
    motion = Fourier.random(np.random.default_rng(0), limits, duration=DURATION, centre=POSTURE, frequency=0.2)
    return motion, np.arange(0.0, DURATION, DT)


def torques(arm: NominalArm, effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    """Torque of the motion [N m], shape (N, 7)."""
    motion, t = reference(arm)
    series = Motion(t, motion.position(t), motion.velocity(t), motion.acceleration(t))
    return CorrectedArm(arm, effects).predict(RigidBody(arm), series)


def timed(loops: list[Callable[[], None]], steps: int) -> np.ndarray:
    """Time per step of each loop in each round [us], shape (ROUNDS, loops).

    They take turns, so that a busy machine slows all of a round.
    """
    times = np.empty((ROUNDS, len(loops)))
    for i in range(ROUNDS):
        for j, loop in enumerate(loops):
            start = time.perf_counter()
            loop()
            times[i, j] = (time.perf_counter() - start) / steps
    return 1e6 * times


def bare_pybullet(simulated: SimulatedArm, torque: np.ndarray) -> Callable[[], None]:
    """A loop without anything of the project around PyBullet."""
    engine = simulated._engine
    assert isinstance(engine, PyBulletEngine)
    robot, joints, client = engine._robot, engine._joints, engine._client
    forces = torque.tolist()

    def loop() -> None:
        simulated.reset(POSTURE)
        for force in forces:
            pybullet.setJointMotorControlArray(
                robot, joints, pybullet.TORQUE_CONTROL, forces=force, physicsClientId=client
            )
            pybullet.stepSimulation(physicsClientId=client)
            pybullet.getJointStates(robot, joints, physicsClientId=client)

    return loop


def bare_mujoco(simulated: SimulatedArm, torque: np.ndarray) -> Callable[[], None]:
    """A loop without anything of the project around MuJoCo."""
    engine = simulated._engine
    assert isinstance(engine, MuJoCoEngine)
    model, data, state = engine._model, engine._data, np.empty(14)

    def loop() -> None:
        simulated.reset(POSTURE)
        for force in torque:
            data.qfrc_applied[:] = force
            mujoco.mj_step(model, data)
            state[:7], state[7:] = data.qpos, data.qvel

    return loop


def ours(simulated: SimulatedArm, torque: np.ndarray, substeps: int) -> Callable[[], None]:
    """The simulated arm, with the torque held for ``substeps`` and its state read after them.

    A weak feedback keeps the arm on its motion, away from its limits.
    """
    motion, t = reference(simulated.arm)
    rows = list(zip(torque[::substeps], *(x(t)[::substeps] for x in (motion.position, motion.velocity)), strict=True))
    gain = np.diag(simulated.body.mass_matrix(POSTURE))

    def loop() -> None:
        simulated.reset(POSTURE)
        for force, q, dq in rows:
            simulated.step(force + gain * (40.0 * (q - simulated.q) + 9.0 * (dq - simulated.dq)), substeps)

    return loop


def main() -> None:
    """Print the table."""
    arm = load_nominal_arm("kuka_iiwa", sheet={"coulomb": [0.0] * 7, "viscous": [0.0] * 7})
    print("engine    sub-steps  bare [us]  no effects [us] ratio  friction family [us] ratio")
    for name, bare in (("pybullet", bare_pybullet), ("mujoco", bare_mujoco)):
        free, rough = torques(arm, ()), torques(arm, FRICTION)
        for substeps in (20, 4, 1):
            with SimulatedArm(arm, engine=name) as simple, SimulatedArm(arm, FRICTION, engine=name) as full:
                loops = [bare(simple, free), ours(simple, free, substeps), ours(full, rough, substeps)]
                times = timed(loops, len(free))
            floor, *ours_us = np.median(times, axis=0)
            ratios = np.median(times[:, :1] / times[:, 1:], axis=0)
            columns = [f"{value:16.2f} {ratio:5.2f}" for value, ratio in zip(ours_us, ratios, strict=True)]
            print(f"{name:9} {substeps:9d} {floor:10.2f} {columns[0]}      {columns[1]}", flush=True)


if __name__ == "__main__":
    main()
