"""The environment against bare loops of its engines, environments in vector form against single ones, PPO.

KUKA iiwa, 20 steps of 1 ms per action, all along the same motion. *Friction* is the whole friction family on all
joints, *residual* actions add a PD loop that runs in every step. The bare loops set torque in every step (PyBullet
forgets it) and read the state once per action; the stricter of the two bare PyBullet loops is the yardstick, the other
reads joint states in every step. The bare batch of MuJoCo makes all steps of an action in one call. Resets are not
timed.

PPO is trained on the nominal arm with its friction, whole rollouts with their updates and resets, without evaluations:
eight environments one after the other, as before there was a vector environment, and as the shipped settings have it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from importlib import import_module

import numpy as np
from mujoco.batch import Batch

from experiments.benchmarks.point import Point, Settings
from experiments.benchmarks.row import Row, compared
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.envs.engines.pybullet import pybullet
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.simulated_arm import SimulatedArm
from gapscope.envs.vector.environment import VectorArmTracking

speed = import_module("experiments.03_engine_speed")
"""The loops of one environment."""
SUB_STEPS, ARMS, FEW = 20, (8, 64, 256), (8,)
BEFORE = {"n_steps": 128, "batch_size": 128}
"""Of PPO, before there was a vector environment; on eight environments."""
Loops = Mapping[str, Callable[[], object]]


def points(settings: Settings) -> list[Point]:
    """One environment on each engine, many on MuJoCo, and training."""
    arms = FEW if settings.quick else ARMS
    return [
        Point("one, pybullet", partial(_one, settings, "pybullet")),
        Point("one, mujoco", partial(_one, settings, "mujoco")),
        *(Point(f"{n} together", partial(_together, settings, n)) for n in arms),
        Point("PPO", partial(_ppo, settings)),
    ]


def _arm() -> NominalArm:
    """Without friction of its own."""
    nothing = {"coulomb": [0.0] * 7, "viscous": [0.0] * 7}
    return load_nominal_arm("kuka_iiwa", sheet=nothing)


def _in_turns(
    loops: Mapping[str, speed.Loop], settings: Settings, clock: Callable[[], float]
) -> dict[str, list[float]]:
    """Time of each loop in each round [s], without what prepares it."""
    times = speed.timed(list(loops.values()), settings.rounds, clock)
    return {name: times[:, i].tolist() for i, name in enumerate(loops)}


def _one(settings: Settings, engine: str) -> list[Row]:
    """One environment against the bare loops of an engine."""
    arm = _arm()
    free, rough = speed.torques(arm, ()), speed.torques(arm, speed.FRICTION)
    bare = SimulatedArm(arm, (), speed.DT, engine=engine)
    held = np.repeat(free[::SUB_STEPS], SUB_STEPS, axis=0)
    loops = {"bare, read once an action": _bare_once(bare, held, engine)}
    if engine == "pybullet":
        loops["bare, read in every step"] = speed.bare_pybullet(bare, held)
    kinds = {"no effects": ((), free), "friction": (speed.FRICTION, rough)}
    for label, (effects, torque) in kinds.items():
        for action in ("torque", "residual"):
            env = speed.make(arm, effects, engine, SUB_STEPS, action)
            rows = np.zeros((len(torque) // SUB_STEPS, 7))
            if action == "torque":
                rows = speed.actions(env, torque, SUB_STEPS)
            loops[f"{label}, {action}"] = speed.environment_loop(env, list(rows))
    times = _in_turns(loops, settings, time.process_time)
    # of an action, in microseconds
    per = len(free) / SUB_STEPS / 1e6
    return compared(times, next(iter(loops)), "µs an action", per, engine)


def _bare_once(arm: SimulatedArm, torque: np.ndarray, engine: str) -> speed.Loop:
    """Every step with its torque; the state is read after the last step of an action."""
    inside = arm._engine
    prepare = partial(arm.reset, speed.POSTURE)
    if engine == "mujoco":
        rows = torque[::SUB_STEPS]

        def steps() -> None:
            for row in rows:
                inside.step(row, SUB_STEPS)
                inside.read()

        return speed.Loop(prepare, steps)
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

    return speed.Loop(prepare, run)


def _together(settings: Settings, count: int) -> list[Row]:
    """Many arms in a vector environment against the bare batch, and against as many single environments' time."""
    arm = _arm()
    free, rough = speed.torques(arm, ()), speed.torques(arm, speed.FRICTION)
    loops = {"bare batch": _bare_batch(arm, free, count)}
    kinds = {"no effects": ((), free), "friction": (speed.FRICTION, rough)}
    for label, (effects, torque) in kinds.items():
        one = speed.make(arm, effects, "mujoco", SUB_STEPS)
        rows = speed.actions(one, torque, SUB_STEPS)[:-1]
        loops[f"{label}, one of them alone, times {count}"] = speed.environment_loop(
            one, list(rows)
        )
        for action in ("torque", "residual"):
            share = {"action_share": 100.0} if action == "torque" else {}
            env = VectorArmTracking(
                count,
                arm,
                effects=effects,
                action=action,
                motion=speed.reference(arm)[0],
                episode_length=speed.DURATION,
                **share,
            )
            played = rows if action == "torque" else np.zeros_like(rows)
            loops[f"{label}, {action}"] = _stepped(env, played, count)
    times = _in_turns(loops, settings, time.perf_counter)
    alone = {name for name in times if "alone" in name}
    scaled = {
        name: [value * (count if name in alone else 1) for value in values]
        for name, values in times.items()
    }
    per = count * (len(free) / SUB_STEPS - 1) / 1e6
    notes = dict.fromkeys(times, "by the clock")
    what = f"{count} arms on MuJoCo"
    return compared(scaled, "bare batch", "µs an action", per, what, notes)


def _bare_batch(arm: NominalArm, torque: np.ndarray, count: int) -> speed.Loop:
    """``Batch.step`` alone, a call for each action, on as many threads as the environment takes."""
    model = SimulatedArm(arm, (), speed.DT, engine="mujoco")._engine._model
    env = VectorArmTracking(count, arm)
    threads = env._plant._arms._engine._batch.nthread
    batch = Batch(model, count, threads)
    position, force = batch.bind("qpos"), batch.bind("qfrc_applied")
    seen = np.zeros_like(position)

    def prepare() -> None:
        batch.reset()
        position[:] = speed.POSTURE

    def run() -> None:
        for row in torque[:-SUB_STEPS:SUB_STEPS]:
            force[:] = row
            batch.step(nstep=SUB_STEPS)
            seen[:] = position

    return speed.Loop(prepare, run)


def _stepped(env: VectorArmTracking, rows: np.ndarray, count: int) -> speed.Loop:
    """All actions but the last, which would end the episodes."""
    stacked = np.repeat(rows[:, None], count, axis=1).astype(np.float32)

    def run() -> None:
        for actions in stacked:
            env.step(actions)

    return speed.Loop(lambda: env.reset(seed=0), run)


def _ppo(settings: Settings) -> list[Row]:
    """Time per action of training, of the processor and by the clock."""
    from gapscope.agents.training.training_settings import RESIDUAL, read_settings

    shipped = read_settings(RESIDUAL, randomise=())
    before = replace(
        shipped,
        environments=8,
        hyperparameters={**shipped.hyperparameters, **BEFORE},
    )
    loops = {
        "one by one, pybullet": _training(replace(before, engine="pybullet"), False),
        "one by one, mujoco": _training(before, False),
        "together, shipped settings": _training(shipped, True),
    }
    clocks = {"processor": time.process_time, "clock": time.perf_counter}
    times: dict[str, dict[str, list[float]]] = {
        kind: {name: [] for name in loops} for kind in clocks
    }
    for _ in range(1 if settings.quick else min(settings.rounds, 3)):
        for name, run in loops.items():
            start = {kind: clock() for kind, clock in clocks.items()}
            actions = run()
            for kind, clock in clocks.items():
                times[kind][name].append((clock() - start[kind]) / actions)
    rows = []
    for kind, found in times.items():
        what = f"PPO, by the {kind}"
        rows += compared(found, next(iter(loops)), "µs an action", 1e-6, what)
    return rows


def _training(settings: object, together: bool) -> Callable[[], int]:
    """Collects and learns from some rollouts; returns the number of actions."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    from gapscope.agents.training.learner import make_learner, seed_all
    from gapscope.agents.training.task import Normalisation, Task
    from gapscope.agents.training.vector_adapter import NormalisedArms

    task = Task.of("nominal", iiwa())
    one = task.simulator(settings)
    figures = Normalisation.measured(one, 0, settings.tolerance, episodes=1)
    one.close()
    vector = (
        NormalisedArms(task.simulators(settings), figures)
        if together
        else DummyVecEnv(task.normalised(settings, figures))
    )
    learner = make_learner(settings, vector)
    vector.seed(seed_all(0, 1))
    # a quarter of an episode, so that resets count as often as in training
    actions = settings.round_length // 2

    def run() -> int:
        before = learner.num_timesteps
        learner.learn(actions, reset_num_timesteps=False, log_interval=10**9)
        return learner.num_timesteps - before

    return run
