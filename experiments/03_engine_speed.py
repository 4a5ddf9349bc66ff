"""Speed of the simulated arm and of the environment against bare engine loops, in one run: steps of 1 ms.

The bare PyBullet loop sets torques, steps and reads joint states; the bare MuJoCo loop sets torque, steps and copies
the state. The simulated arm is reset and stepped directly; the environment is ``gapscope/ArmTracking-v0`` as
``gymnasium.make`` gives it, with torque actions, and with residual actions, whose PD loop runs in every step. All play
the torque of the same Fourier motion, or track it, at 20, 4 and 1 sub-steps per action. Then eight environments in
vector form are compared with one. A ratio is the median over rounds in which the loops take turns; resets are not
timed. Time is that of the processor, so that other work on the machine counts little; for environments in vector
form, which have processes of their own, that of the clock.

    python experiments/03_engine_speed.py [--rounds 21] [--part loops|vector]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import NamedTuple

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

import gapscope  # noqa: F401 (makes the environment known)
from gapscope.arm.dynamics.plain_urdf import moving_links
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.engines.mujoco import arm_model
from gapscope.envs.engines.pybullet import PyBulletEngine, pybullet
from gapscope.envs.simulated_arm import SimulatedArm

JOINTS = (1, 2, 3, 4, 5, 6, 7)
POSTURE = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 0.8, 0.0])
DURATION, DT, COPIES = 2.0, 1e-3, 8
SCALE = np.array([3.0, 3.5, 2.0, 2.5, 1.2, 0.8, 0.5])
FRICTION = (
    AppliedEffect("coulomb_friction", JOINTS, {"torque": SCALE}),
    AppliedEffect("viscous_friction", JOINTS, {"coefficient": SCALE}),
    AppliedEffect(
        "stribeck_friction",
        JOINTS,
        {"torque": 0.3 * SCALE, "velocity": np.full(7, 0.1)},
    ),
    AppliedEffect("load_friction", JOINTS, {"coefficient": np.full(7, 0.1)}),
    AppliedEffect(
        "friction_drift",
        JOINTS,
        {"amplitude": np.full(7, 0.3), "time_constant": np.full(7, 300.0)},
    ),
)


class Loop(NamedTuple):
    """What is timed: ``run`` after ``prepare``."""

    prepare: Callable[[], object]
    run: Callable[[], None]


def reference(arm: NominalArm) -> tuple[Fourier, np.ndarray]:
    """A Fourier motion and its times [s]."""
    limits = urdf_limits(RigidBody(arm), 6.0)._replace(velocity=np.full(7, 1.5))
    motion = Fourier.random(
        np.random.default_rng(0),
        limits,
        duration=DURATION,
        centre=POSTURE,
        frequency=0.2,
    )
    return motion, np.arange(0.0, DURATION, DT)


def torques(arm: NominalArm, effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    """Torque of the motion [N m], shape (N, 7)."""
    motion, t = reference(arm)
    series = Motion(t, motion.position(t), motion.velocity(t), motion.acceleration(t))
    return CorrectedArm(arm, effects).predict(RigidBody(arm), series)


def timed(loops: list[Loop], rounds: int, clock: Callable[[], float]) -> np.ndarray:
    """Time of each loop in each round [s], shape (rounds, loops).

    They take turns, so that a busy machine slows all of a round.
    """
    times = np.empty((rounds, len(loops)))
    for i in range(rounds):
        for j, loop in enumerate(loops):
            loop.prepare()
            start = clock()
            loop.run()
            times[i, j] = clock() - start
    return times


def bare_pybullet(simulated: SimulatedArm, torque: np.ndarray) -> Loop:
    """A loop without anything of the project around PyBullet."""
    engine = simulated._arms._bodies._engine
    assert isinstance(engine, PyBulletEngine)
    robot, joints, client = engine._robot, engine._joints, engine._client
    forces = torque.tolist()

    def run() -> None:
        for force in forces:
            pybullet.setJointMotorControlArray(
                robot,
                joints,
                pybullet.TORQUE_CONTROL,
                forces=force,
                physicsClientId=client,
            )
            pybullet.stepSimulation(physicsClientId=client)
            pybullet.getJointStates(robot, joints, physicsClientId=client)

    return Loop(lambda: simulated.reset(POSTURE), run)


def bare_model(simulated: SimulatedArm) -> mujoco.MjModel:
    """MuJoCo's model of an arm."""
    body = simulated.body
    model = arm_model(moving_links(body), np.asarray(body.gravity), DT)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def bare_mujoco(simulated: SimulatedArm, torque: np.ndarray) -> Loop:
    """A loop without anything of the project around MuJoCo."""
    model = bare_model(simulated)
    data, state = mujoco.MjData(model), np.empty(14)

    def start() -> None:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = POSTURE

    def run() -> None:
        for force in torque:
            data.qfrc_applied[:] = force
            mujoco.mj_step(model, data)
            state[:7], state[7:] = data.qpos, data.qvel

    return Loop(start, run)


def arm_loop(simulated: SimulatedArm, torque: np.ndarray, substeps: int) -> Loop:
    """The simulated arm, with the torque held for ``substeps`` and its state read after them.

    A weak feedback keeps the arm on its motion, away from its limits.
    """
    motion, t = reference(simulated.arm)
    rows = list(
        zip(
            torque[::substeps],
            *(x(t)[::substeps] for x in (motion.position, motion.velocity)),
            strict=True,
        )
    )
    gain = np.diag(simulated.body.mass_matrix(POSTURE))

    def run() -> None:
        for force, q, dq in rows:
            simulated.step(
                force + gain * (40.0 * (q - simulated.q) + 9.0 * (dq - simulated.dq)),
                substeps,
            )

    return Loop(lambda: simulated.reset(POSTURE), run)


def make(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    engine: str,
    substeps: int,
    action: str = "torque",
) -> gymnasium.Env:
    """The environment, which follows the same motion; torque actions are scaled such that none is clipped."""
    share = {"action_share": 100.0} if action == "torque" else {}
    return gymnasium.make(
        "gapscope/ArmTracking-v0",
        robot=arm,
        effects=effects,
        engine=engine,
        action=action,
        **share,
        motion=reference(arm)[0],
        sub_steps=substeps,
        time_step=DT,
        episode_length=DURATION,
    )


def actions(
    environment: gymnasium.Env, torque: np.ndarray, substeps: int
) -> np.ndarray:
    """Actions of the motion's torque with a weak feedback [1], shape (K, 7); the same actions give the same motion."""
    inner = environment.unwrapped
    gain, parts = np.diag(inner.body.mass_matrix(POSTURE)), inner.layout.slices
    observation, _ = environment.reset(seed=0)
    rows = []
    for force in torque[::substeps]:
        error, rate = observation[parts["error"]], observation[parts["reference_rate"]]
        pd = gain * (40.0 * error + 9.0 * (rate - observation[parts["velocity"]]))
        rows.append((force + pd) / inner.torque_scale)
        observation, _, terminated, truncated, info = environment.step(rows[-1])
        assert not terminated, info
    assert truncated
    return np.array(rows)


def environment_loop(environment: gymnasium.Env, rows: list[np.ndarray]) -> Loop:
    """The environment through one episode of these actions."""

    def run() -> None:
        for action in rows:
            environment.step(action)

    return Loop(lambda: environment.reset(seed=0), run)


def against_bare_loops(arm: NominalArm, rounds: int) -> None:
    """Print the first table: the simulated arm and the environment against the bare loop."""
    print("time per simulated ms [us], and speed over that of the bare loop")
    print(
        "engine   sub-steps   bare    arm, no effects  arm, friction    env, no effects  env, friction    ",
        end="",
    )
    print("residual         residual, friction")
    free, rough = torques(arm, ()), torques(arm, FRICTION)
    for name, bare in (("pybullet", bare_pybullet), ("mujoco", bare_mujoco)):
        for substeps in (20, 4, 1):
            arms = [
                SimulatedArm(arm, effects, DT, engine=name)
                for effects in ((), FRICTION)
            ]
            kinds = [
                (effects, kind)
                for kind in ("torque", "residual")
                for effects in ((), FRICTION)
            ]
            environments = [
                make(arm, effects, name, substeps, kind) for effects, kind in kinds
            ]
            loops = [bare(arms[0], free)]
            loops += [
                arm_loop(x, torque, substeps)
                for x, torque in zip(arms, (free, rough), strict=True)
            ]
            played = [
                actions(x, y, substeps)
                for x, y in zip(environments[:2], (free, rough), strict=True)
            ]
            played += [np.zeros_like(played[0])] * 2
            loops += [
                environment_loop(x, list(rows))
                for x, rows in zip(environments, played, strict=True)
            ]
            times = timed(loops, rounds, time.process_time)
            for x in (*arms, *environments):
                x.close()
            floor, *ours = 1e6 * np.median(times, axis=0) / len(free)
            ratios = np.median(times[:, :1] / times[:, 1:], axis=0)
            columns = "  ".join(
                f"{value:8.2f} {ratio:6.2f}"
                for value, ratio in zip(ours, ratios, strict=True)
            )
            print(f"{name:9} {substeps:8d} {floor:6.2f}  {columns}", flush=True)


def in_vector_form(arm: NominalArm, rounds: int) -> None:
    """Print the second table: environments in vector form against one."""
    substeps = 20
    print(
        f"environment steps per second, {COPIES} environments in vector form, {substeps} sub-steps per action"
    )
    print("engine    effects    one     SyncVectorEnv    AsyncVectorEnv")
    for name in ("pybullet", "mujoco"):
        for label, effects in (("none", ()), ("friction", FRICTION)):
            one = make(arm, effects, name, substeps)
            rows = actions(one, torques(arm, effects), substeps)[
                :-1
            ]  # the last would end all episodes
            makers = [
                lambda effects=effects, name=name: make(arm, effects, name, substeps)
            ] * COPIES
            many = [SyncVectorEnv(makers), AsyncVectorEnv(makers)]
            stacked = np.repeat(rows[:, None], COPIES, axis=1).astype(np.float32)
            times = timed(
                [_stepping(one, rows), *(_stepping(x, stacked) for x in many)],
                rounds,
                time.perf_counter,
            )
            for x in (one, *many):
                x.close()
            speed = len(rows) * np.array([1, COPIES, COPIES]) / times
            rates, ratios = (
                np.median(speed, axis=0),
                np.median(speed[:, 1:] / speed[:, :1], axis=0),
            )
            columns = "  ".join(
                f"{rate:8.0f} {ratio:6.2f}"
                for rate, ratio in zip(rates[1:], ratios, strict=True)
            )
            print(f"{name:9} {label:9} {rates[0]:5.0f}  {columns}", flush=True)


def _stepping(
    environment: gymnasium.Env | gymnasium.vector.VectorEnv, rows: np.ndarray
) -> Loop:
    """All actions in turn."""

    def run() -> None:
        for action in rows:
            environment.step(action)

    return Loop(lambda: environment.reset(seed=0), run)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=21)
    parser.add_argument("--part", choices=("loops", "vector"))
    options = parser.parse_args()
    arm = load_nominal_arm(
        "kuka_iiwa", sheet={"coulomb": [0.0] * 7, "viscous": [0.0] * 7}
    )
    if options.part != "vector":
        against_bare_loops(arm, options.rounds)
    if options.part != "loops":
        in_vector_form(arm, max(3, options.rounds // 3))


if __name__ == "__main__":
    main()
