"""The environment against bare loops of its engines, environments in vector form against single ones, PPO.

KUKA iiwa, 20 steps of 1 ms per action, all along the same motion. *Friction* is the whole friction family on all
joints, *residual* actions add a PD loop that runs in every step. The bare loops set torque in every step (PyBullet
forgets it) and read the state once per action; the bare batch of MuJoCo makes all steps of an action in one call.
Resets are not timed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import mujoco
import numpy as np
from mujoco.batch import Batch

from gapscope.arm.dynamics.plain_urdf import moving_links
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Fourier, motion_of, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.engines.mujoco import arm_model
from gapscope.envs.engines.pybullet import pybullet
from gapscope.envs.environment import VectorArmTracking
from gapscope.envs.simulated_arm import SimulatedArm

from .measure import Point, Row, Settings, compared, in_turns

JOINTS = (1, 2, 3, 4, 5, 6, 7)
POSTURE = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 0.8, 0.0])
DURATION, DT = 2.0, 1e-3
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
    return CorrectedArm(arm, effects).predict(RigidBody(arm), motion_of(motion, t))


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


SUB_STEPS, ARMS, FEW = 20, (8, 64), (8,)
Loops = Mapping[str, Callable[[], object]]


def points(settings: Settings) -> list[Point]:
    """One environment on each engine, and many on MuJoCo."""
    arms = FEW if settings.quick else ARMS
    return [
        Point("one, pybullet", partial(_one, settings, "pybullet")),
        Point("one, mujoco", partial(_one, settings, "mujoco")),
        *(Point(f"{n} together", partial(_together, settings, n)) for n in arms),
    ]


def _arm() -> NominalArm:
    """Without friction of its own."""
    nothing = {"coulomb": [0.0] * 7, "viscous": [0.0] * 7}
    return load_nominal_arm("kuka_iiwa", sheet=nothing)


def _in_turns(
    loops: Mapping[str, Loop], settings: Settings, clock: Callable[[], float]
) -> dict[str, list[float]]:
    """Time of each loop in each round [s], without what prepares it."""
    runs = {name: loop.run for name, loop in loops.items()}
    prepare = {name: loop.prepare for name, loop in loops.items()}
    return in_turns(runs, settings.rounds, clock, prepare)


def _one(settings: Settings, engine: str) -> list[Row]:
    """One environment against the bare loops of an engine."""
    arm = _arm()
    free, rough = torques(arm, ()), torques(arm, FRICTION)
    bare = SimulatedArm(arm, (), DT, engine=engine)
    held = np.repeat(free[::SUB_STEPS], SUB_STEPS, axis=0)
    loops = {"bare": _bare(bare, held, engine)}
    kinds = {"no effects": ((), free), "friction": (FRICTION, rough)}
    for label, (effects, torque) in kinds.items():
        for action in ("torque", "residual"):
            env = make(arm, effects, engine, SUB_STEPS, action)
            rows = np.zeros((len(torque) // SUB_STEPS, 7))
            if action == "torque":
                rows = actions(env, torque, SUB_STEPS)
            loops[f"{label}, {action}"] = _episode(env, list(rows))
    times = _in_turns(loops, settings, time.process_time)
    # of an action, in microseconds
    per = len(free) / SUB_STEPS / 1e6
    return compared(times, next(iter(loops)), "µs an action", per, engine)


def _bare(arm: SimulatedArm, torque: np.ndarray, engine: str) -> Loop:
    """Every step with its torque and nothing of the project; the state is read once an action."""
    inside = arm._bodies
    prepare = partial(arm.reset, POSTURE)
    if engine == "mujoco":
        rows = torque[::SUB_STEPS]

        def steps() -> None:
            for row in rows:
                inside.run(row, SUB_STEPS)

        return Loop(prepare, steps)
    robot, joints, client = inside._robot, inside._joints, inside._client
    forces = torque.tolist()

    def run() -> None:
        for number, force in enumerate(forces, 1):
            pybullet.setJointMotorControlArray(
                robot,
                joints,
                pybullet.TORQUE_CONTROL,
                forces=force,
                physicsClientId=client,
            )
            pybullet.stepSimulation(physicsClientId=client)
            if number % SUB_STEPS == 0:
                pybullet.getJointStates(robot, joints, physicsClientId=client)

    return Loop(prepare, run)


def _together(settings: Settings, count: int) -> list[Row]:
    """Many arms in a vector environment against the bare batch."""
    arm = _arm()
    free, rough = torques(arm, ()), torques(arm, FRICTION)
    loops = {"bare batch": _bare_batch(arm, free, count)}
    kinds = {"no effects": ((), free), "friction": (FRICTION, rough)}
    for label, (effects, torque) in kinds.items():
        one = make(arm, effects, "mujoco", SUB_STEPS)
        # all but the last, which would end the episodes
        rows = actions(one, torque, SUB_STEPS)[:-1]
        for action in ("torque", "residual"):
            share = {"action_share": 100.0} if action == "torque" else {}
            env = VectorArmTracking(
                count,
                arm,
                effects=effects,
                action=action,
                motion=reference(arm)[0],
                episode_length=DURATION,
                **share,
            )
            played = rows if action == "torque" else np.zeros_like(rows)
            stacked = np.repeat(played[:, None], count, axis=1).astype(np.float32)
            loops[f"{label}, {action}"] = _episode(env, list(stacked))
    times = _in_turns(loops, settings, time.perf_counter)
    per = count * (len(free) / SUB_STEPS - 1) / 1e6
    notes = dict.fromkeys(times, "by the clock")
    what = f"{count} arms on MuJoCo"
    return compared(times, "bare batch", "µs an action", per, what, notes)


def _bare_batch(arm: NominalArm, torque: np.ndarray, count: int) -> Loop:
    """``Batch.step`` alone, a call for each action, on as many threads as the environment takes."""
    body = RigidBody(arm)
    model = arm_model(moving_links(body), np.asarray(body.gravity), DT)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    env = VectorArmTracking(count, arm)
    threads = env._episodes._simulators[0]._bodies._batch.nthread
    batch = Batch(model, count, threads)
    position, force = batch.bind("qpos"), batch.bind("qfrc_applied")
    seen = np.zeros_like(position)

    def prepare() -> None:
        batch.reset()
        position[:] = POSTURE

    def run() -> None:
        for row in torque[:-SUB_STEPS:SUB_STEPS]:
            force[:] = row
            batch.step(nstep=SUB_STEPS)
            seen[:] = position

    return Loop(prepare, run)


def _episode(env: Any, rows: Sequence[np.ndarray]) -> Loop:
    """The environment, or many together, through these actions of one episode."""

    def run() -> None:
        for action in rows:
            env.step(action)

    return Loop(lambda: env.reset(seed=0), run)
