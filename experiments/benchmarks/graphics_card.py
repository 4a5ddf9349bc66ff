"""N arms on a graphics card against MuJoCo's batch on all processors: MuJoCo's JAX version, and a kernel of our own.

Nothing of the project runs on the card: this asks what an environment there could reach. The KUKA iiwa, its motion and
its torques are those of the environment's benchmark, an action is 20 steps. Dry friction follows Dahl's state, residual
actions add a PD loop and inverse dynamics at the reference in every step. Arms begin at slightly different postures.

The card's side needs neither the project nor is it needed by it, but ``jax`` and ``cupy`` with a card, and ``mujoco``
and ``mujoco-mjx`` of one version; ``JAX_ENABLE_X64=1`` is double precision:

    python -m experiments.benchmarks.graphics_card export FOLDER       # with the project
    python experiments/benchmarks/graphics_card.py mjx FOLDER 4096 1024 64
    python experiments/benchmarks/graphics_card.py kernel FOLDER 4096 1024 64
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

DT, STEPS, CHECKED = 1e-3, 20, 25
"""Period [s], steps of an action, and actions over which positions are compared with MuJoCo's: 0.5 s."""
SLIP = 0.01
"""Distance over which dry friction builds up [rad]."""
KP, KD = 400.0, 28.0
"""Of the PD loop, over the joint's own inertia [1/s^2, 1/s]."""
GOAL = ("position", "velocity", "acceleration")
KINDS = {
    "bare": {"friction": False, "residual": False},
    "friction": {"friction": True, "residual": False},
    "friction, residual actions": {"friction": True, "residual": True},
}


class Timed(NamedTuple):
    """Seconds an action of all arms, seconds of compilation, and positions after ``CHECKED`` actions, (N, 7)."""

    action: float
    compilation: float
    positions: np.ndarray


def export(folder: Path) -> None:
    """Write the model, and torque and motion of every action."""
    from gapscope.arm.dynamics.plain_urdf import moving_links
    from gapscope.arm.dynamics.rigid_body import RigidBody
    from gapscope.envs.engines.mujoco import arm_model

    from . import environment as bench

    arm = bench._arm()
    body = RigidBody(arm)
    model = arm_model(moving_links(body), np.asarray(body.gravity), DT)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    folder.mkdir(parents=True, exist_ok=True)
    mujoco.mj_saveModel(model, str(folder / "arm.mjb"))
    motion, t = bench.reference(arm)
    t = t[::STEPS]
    np.savez(
        folder / "motion.npz",
        torque=bench.torques(arm, ())[::STEPS],
        **{name: getattr(motion, name)(t) for name in GOAL},
        friction=bench.SCALE,
        inertia=np.diag(body.mass_matrix(bench.POSTURE)),
    )


def starts(count: int, posture: np.ndarray) -> np.ndarray:
    """Postures at which the arms begin [rad], (N, 7)."""
    offsets = np.random.default_rng(0).uniform(-0.01, 0.01, (count, len(posture)))
    return posture + offsets


def on_processors(
    model: mujoco.MjModel, data: dict[str, np.ndarray], count: int
) -> Timed:
    """MuJoCo's batch on all processors."""
    from mujoco.batch import Batch

    batch = Batch(model, count, min(count, len(os.sched_getaffinity(0))))
    position, force = batch.bind("qpos"), batch.bind("qfrc_applied")
    times = []
    for _ in range(3):
        batch.reset()
        position[:] = starts(count, data["position"][0])
        begin = time.perf_counter()
        for number, row in enumerate(data["torque"], 1):
            force[:] = row
            batch.step(nstep=STEPS)
            if number == CHECKED:
                seen = np.array(position)
        times.append((time.perf_counter() - begin) / len(data["torque"]))
    return Timed(min(times), 0.0, seen)


def of_mjx(
    model: mujoco.MjModel,
    data: dict[str, np.ndarray],
    count: int,
    friction: bool,
    residual: bool,
) -> Timed:
    """MuJoCo's JAX version."""
    import jax
    import jax.numpy as jnp
    from mujoco import mjx

    arm, one = mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")
    scale, inertia = jnp.asarray(data["friction"]), jnp.asarray(data["inertia"])

    def step(goal: tuple, carry: tuple, _: None) -> tuple:
        (state, bend), (torque, q, dq, ddq) = carry, goal
        if residual:
            wanted = mjx.inverse(arm, state.replace(qpos=q, qvel=dq, qacc=ddq))
            error = KP * (q - state.qpos) + KD * (dq - state.qvel)
            torque = wanted.qfrc_inverse + inertia * error
        if friction:
            way = state.qvel * DT
            side = jnp.sign(way)
            bend = side + (bend - side) * jnp.exp(-jnp.abs(way) / SLIP)
            rise = 1.0 + 0.3 * jnp.exp(-((state.qvel / 0.1) ** 2))
            torque = torque - scale * (rise * bend + state.qvel)
        return (mjx.step(arm, state.replace(qfrc_applied=torque)), bend), None

    def action(state: Any, bend: Any, *goal: Any) -> tuple:
        return jax.lax.scan(partial(step, goal), (state, bend), length=STEPS)[0]

    q = jnp.asarray(starts(count, data["position"][0]))
    begun = jax.jit(jax.vmap(lambda q: one.replace(qpos=q)))(q)
    goals = [
        tuple(map(jnp.asarray, row))
        for row in zip(*(data[x] for x in ("torque", *GOAL)), strict=True)
    ]
    many = jax.jit(jax.vmap(action, in_axes=(0, 0, *(None,) * 4)))
    begin = time.perf_counter()
    many = many.lower(begun, jnp.zeros_like(q), *goals[0]).compile()
    compiled, times = time.perf_counter() - begin, []
    for _ in range(2):
        state, bend = begun, jnp.zeros_like(q)
        begin = time.perf_counter()
        for number, goal in enumerate(goals, 1):
            state, bend = many(state, bend, *goal)
            if number == CHECKED:
                seen = state.qpos
        jax.block_until_ready(state.qpos)
        times.append((time.perf_counter() - begin) / len(goals))
    return Timed(min(times), compiled, np.asarray(seen))


def of_kernel(
    model: mujoco.MjModel,
    data: dict[str, np.ndarray],
    count: int,
    friction: bool,
    residual: bool,
) -> Timed:
    """A kernel that makes all steps of an action, one thread an arm."""
    import cupy

    real = np.float64 if os.environ.get("JAX_ENABLE_X64") else np.float32
    source = Path(__file__).parent / "children" / "arm_kernel.cu"
    name = "double" if real is np.float64 else "float"
    head = (
        f"#define REAL {name}\n#define N {model.nv}\n#define JOINTS {joints(model)}\n"
    )
    begin = time.perf_counter()
    module = cupy.RawModule(code=head + source.read_text(), options=("--std=c++17",))
    action = module.get_function("actions")
    compiled, times = time.perf_counter() - begin, []
    torque, scale, inertia = (
        cupy.asarray(data[x], real) for x in ("torque", "friction", "inertia")
    )
    goals = cupy.asarray(np.hstack([data[x] for x in GOAL]), real)
    begun = cupy.asarray(starts(count, data["position"][0]), real)
    kind = (np.int32(STEPS), np.int32(friction), np.int32(residual), real(DT))
    for _ in range(3):
        q, dq, bend = begun.copy(), cupy.zeros_like(begun), cupy.zeros_like(begun)
        cupy.cuda.Device().synchronize()
        begin = time.perf_counter()
        for number, row in enumerate(zip(torque, goals, strict=True), 1):
            arguments = (np.int32(count), q, dq, bend, *row, scale, inertia, *kind)
            action((-(-count // 32),), (32,), arguments)
            if number == CHECKED:
                seen = q.copy()
        cupy.cuda.Device().synchronize()
        times.append((time.perf_counter() - begin) / len(torque))
    return Timed(min(times), compiled, seen.get())


def joints(model: mujoco.MjModel) -> str:
    """The chain as the kernel's table."""

    def turn(quaternion: np.ndarray) -> np.ndarray:
        out = np.zeros(9)
        mujoco.mju_quat2Mat(out, quaternion)
        return out

    def listed(values: np.ndarray) -> str:
        return "{" + ",".join(f"(REAL){float(x)!r}" for x in values) + "}"

    rows = []
    for i in range(1, model.nbody):
        r = turn(model.body_iquat[i]).reshape(3, 3)
        parts = (
            listed(turn(model.body_quat[i])),
            listed(model.body_pos[i]),
            listed(model.jnt_axis[model.body_jntadr[i]]),
            f"(REAL){float(model.body_mass[i])!r}",
            listed(model.body_ipos[i]),
            listed(((r * model.body_inertia[i]) @ r.T).ravel()),
        )
        rows.append("{" + ",".join(parts) + "}")
    return "{" + ",".join(rows) + "}"


def figures(
    timed: Callable[..., Timed], folder: Path, counts: list[int]
) -> Iterator[dict[str, Any]]:
    """Figures of each number of arms and kind of action; joint limits cost MJX its solver, in MuJoCo nearly nothing."""
    limited, free = (
        mujoco.MjModel.from_binary_path(str(folder / "arm.mjb")) for _ in range(2)
    )
    free.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    with np.load(folder / "motion.npz") as loaded:
        data = dict(loaded)
    asked = [(name, free, kind) for name, kind in KINDS.items()]
    if timed is of_mjx:
        # a tenth of the kernel's speed or less
        data |= {name: data[name][:30] for name in ("torque", *GOAL)}
        asked.append(("bare, joint limits", limited, KINDS["bare"]))
    for count in counts:
        batch = on_processors(limited, data, count)
        for name, arm, kind in asked:
            one = timed(arm, data, count, **kind)
            off = float(np.abs(one.positions - batch.positions).max())
            yield {
                "arms": count,
                "what": name,
                "us_an_action": one.action / count * 1e6,
                "batch_us": batch.action / count * 1e6,
                "actions_per_s": count / one.action,
                "times_batch": batch.action / one.action,
                "compilation_s": one.compilation,
                # of others the torque is not the batch's
                "off_rad": off if kind == KINDS["bare"] else None,
            }


if __name__ == "__main__":
    what, where, *given = sys.argv[1:]
    if what == "export":
        export(Path(where))
    else:
        how = {"mjx": of_mjx, "kernel": of_kernel}[what]
        for line in figures(how, Path(where), [int(x) for x in given]):
            print(json.dumps(line), flush=True)
