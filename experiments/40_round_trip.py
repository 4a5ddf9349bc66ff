"""Round trip: every effect exported, simulated by other engines alone, and compared with the arm that has it.

    .venv/bin/python experiments/40_round_trip.py [--effects NAME,...] [--out out/round_trip]

The arm that has the effect is Gapscope's simulated iiwa under a PD loop with feedforward; with rotors and friction for
MuJoCo, without both for PyBullet and DART, whose formats hold no rotors. The engine loads the exported nominal arm,
then the exported corrected one, by its own reader (`in_mujoco` and its like use nothing of Gapscope), and runs each
under the same references and the same loop. Gap: RMS over joints and 3 s of motion of what the encoders read in the
engine minus what they read on the arm [mrad]; before with the nominal arm, after with the corrected one. Injecting and
exporting use the same law: this checks the files, not the laws.

Effects are drawn as for simulated cases, on joints 2, 4 and 6, with a fixed seed; the row `friction` has Coulomb and
viscous friction on all joints. Beside load friction, which no format holds, the Coulomb friction that the file names as
nearest is exported. Prints the table of `docs/export.md`; takes some minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from benchmarks.child import without_meshes
from common import command_line

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.json_file import write_json
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift, Transmission
from gapscope.effects.severity import draw
from gapscope.envs.export.formats import export
from gapscope.envs.export.plain_arm import TARGETS as FORMATS
from gapscope.envs.export.plain_arm import holds, nearest_friction
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.simulated_arm import SimulatedArm

# Engines, by their own readers

PERIOD = 1e-3
"""Period of the controller [s]."""
Command = Callable[[int, np.ndarray], np.ndarray]
"""Torque [N m] of a tick from what the encoders read [rad], each of shape (n,)."""


def in_mujoco(
    file: Path, joints: Sequence[str], start: np.ndarray, ticks: int, command: Command
) -> np.ndarray:
    """What the encoders read at each tick [rad], shape (ticks, n).

    Args:
        file: MJCF; its sensors and actuators carry the joints' names.
        joints: names of the n joints.
        start: posture at first [rad], (n,), at rest.
        ticks: of the controller.
        command: of the controller.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    steps = round(PERIOD / model.opt.timestep)
    sensors = [model.sensor(name).adr[0] for name in joints]
    motors = [model.actuator(name).id for name in joints]
    for name, position in zip(joints, start.tolist(), strict=True):
        data.joint(name).qpos = position
        data.joint(model.joint(model.actuator(name).trnid[0]).name).qpos = position
    out = np.empty((ticks, len(joints)))
    for tick in range(ticks):
        mujoco.mj_step1(model, data)
        out[tick] = data.sensordata[sensors]
        data.ctrl[motors] = command(tick, out[tick])
        mujoco.mj_step2(model, data)
        mujoco.mj_step(model, data, steps - 1)
    return out


def in_pybullet(
    file: Path, joints: Sequence[str], start: np.ndarray, ticks: int, command: Command
) -> np.ndarray:
    """As ``in_mujoco``, of a URDF.

    PyBullet gives the friction and the torque limits of the file back on request, and applies neither by itself.
    """
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81)
    pybullet.setTimeStep(PERIOD)
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE
    robot = pybullet.loadURDF(str(file), useFixedBase=True, flags=flags)
    infos = [
        pybullet.getJointInfo(robot, i) for i in range(pybullet.getNumJoints(robot))
    ]
    index = {info[1].decode(): info[0] for info in infos}
    order = [index[name] for name in joints]
    friction = [infos[i][7] for i in order]
    limit = np.array([infos[i][10] for i in order])
    for i in range(-1, len(infos)):
        pybullet.changeDynamics(robot, i, linearDamping=0, angularDamping=0)
    for i, position in zip(order, start.tolist(), strict=True):
        pybullet.resetJointState(robot, i, position)
    pybullet.setJointMotorControlArray(
        robot, order, pybullet.VELOCITY_CONTROL, forces=friction
    )
    out = np.empty((ticks, len(joints)))
    for tick in range(ticks):
        out[tick] = [state[0] for state in pybullet.getJointStates(robot, order)]
        torque = np.clip(command(tick, out[tick]), -limit, limit)
        pybullet.setJointMotorControlArray(
            robot, order, pybullet.TORQUE_CONTROL, forces=torque.tolist()
        )
        pybullet.stepSimulation()
    pybullet.disconnect(client)
    return out


def in_dart(
    file: Path, joints: Sequence[str], start: np.ndarray, ticks: int, command: Command
) -> np.ndarray:
    """As ``in_mujoco``, of an SDF; DART's reader passes over limits of torque."""
    import dartpy

    arm = dartpy.utils.SdfParser.readSkeleton(str(file))
    world = dartpy.simulation.World()
    world.setGravity(np.array([0.0, 0.0, -9.81]))
    world.setTimeStep(PERIOD)
    world.addSkeleton(arm)
    awake = world.getDeactivationOptions()
    awake.mEnabled = False
    world.setDeactivationOptions(awake)
    order = [arm.getDof(name).getIndexInSkeleton() for name in joints]
    for i, position in zip(order, start.tolist(), strict=True):
        arm.setPosition(i, position)
    out = np.empty((ticks, len(joints)))
    force = np.zeros(arm.getNumDofs())
    for tick in range(ticks):
        out[tick] = arm.getPositions()[order]
        force[order] = command(tick, out[tick])
        arm.setForces(force)
        world.step()
    return out


# The arm that is exported

TARGETS = {
    "MuJoCo": ("mjcf", in_mujoco),
    "PyBullet": ("urdf", in_pybullet),
    "DART": ("sdf", in_dart),
}
"""Format and runner by name of the simulator."""


JOINTS = (2, 4, 6)
"""Joints that the effects act on."""
BEFORE, MOTION = 1.0, 3.0
"""Seconds of motion before those that count, in which friction forgets how the arm was put there; and counted."""
POSTURE = np.array([0.2, 0.5, -0.3, -1.2, 0.4, 0.8, 0.3])
"""Posture about which the arm moves [rad]."""
SWING = np.array([0.5, 0.4, 0.5, 0.5, 0.6, 0.6, 0.8])
"""Amplitude of each joint [rad]."""
FREQUENCY = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1])
"""Frequency of each joint [Hz]."""
LOOP = 4.0
"""Natural frequency of the position loop [Hz]."""
LEAST = 1e-3
"""Gap that counts as none [mrad]: a fiftieth of a step of the iiwa's encoders."""
SEED = 40
"""Of the effects' values."""


class Gaps(NamedTuple):
    """Gap before and after [mrad], ``None`` without a simulation, and whether the format leaves the effect out."""

    before: float | None
    after: float | None
    left_out: bool

    def __str__(self) -> str:
        """As a cell of the table."""
        if self.before is None or self.after is None:
            return "left out"
        if self.left_out and self.after == self.before:
            return f"{figure(self.before)}, left out"
        figures = f"{figure(self.before)} → {figure(self.after)}"
        return f"{figures}, nearest" if self.left_out else figures


def figure(value: float) -> str:
    """Two digits; below ``LEAST`` none."""
    if value < LEAST:
        return f"< {LEAST:g}"
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


class Loop:
    """PD with the nominal arm's torque fed forward; the velocity is the difference of two readings."""

    def __init__(self, arm: NominalArm) -> None:
        body = RigidBody(arm)
        self.q, dq, ddq = reference()
        inertia = np.diag(body.mass_matrix(POSTURE)) + arm.armature
        self.feedforward = body.inverse_dynamics(self.q, dq, ddq) + arm.armature * ddq
        w = 2 * np.pi * LOOP
        self.kp, self.kd = w**2 * inertia, 2 * w * inertia

    def command(self) -> Command:
        """The loop's torque, from rest."""
        before = self.q[0].copy()

        def torque(tick: int, seen: np.ndarray) -> np.ndarray:
            error, earlier = self.q[tick] - seen, self.q[max(tick - 1, 0)] - before
            before[:] = seen
            rate = (error - earlier) / PERIOD
            return self.feedforward[tick] + self.kp * error + self.kd * rate

        return torque


def reference() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position [rad], velocity and acceleration of the reference, (ticks, n) each."""
    t = np.arange(round((BEFORE + MOTION) / PERIOD))[:, None] * PERIOD
    w, half = 2 * np.pi * FREQUENCY, 0.5 * SWING
    q = POSTURE + half * (1 - np.cos(w * t))
    return q, half * w * np.sin(w * t), half * w**2 * np.cos(w * t)


def effects_of(name: str, arm: NominalArm) -> tuple[AppliedEffect, ...]:
    """What the arm has in a row of the table."""
    if name == "none":
        return ()
    if name == "friction":
        joints = tuple(range(1, arm.n_joints + 1))
        coulomb = AppliedEffect("coulomb_friction", joints, {"torque": arm.coulomb})
        viscous = AppliedEffect(
            "viscous_friction", joints, {"coefficient": arm.viscous}
        )
        return coulomb, viscous
    rng = np.random.default_rng(SEED)
    return (draw(name, rng, ArmScale.of(arm), JOINTS),)


def exported(
    effects: tuple[AppliedEffect, ...], arm: NominalArm
) -> tuple[AppliedEffect, ...]:
    """The effects of an arm as they are exported: Coulomb friction beside load friction, as the file advises."""
    nearest = nearest_friction(CorrectedArm(arm, effects))
    joints = np.flatnonzero(nearest)
    if not joints.size:
        return effects
    torque = {"torque": nearest[joints]}
    numbers = tuple((joints + 1).tolist())
    return (*effects, AppliedEffect("coulomb_friction", numbers, torque))


def on_the_arm(
    arm: NominalArm, effects: tuple[AppliedEffect, ...], loop: Loop
) -> np.ndarray:
    """What the encoders read on the arm with the effects [rad], (ticks, n)."""
    command, out = loop.command(), np.empty_like(loop.q)
    with SimulatedArm(arm, effects, PERIOD) as simulated:
        simulated.start(loop.q[0], time=-BEFORE)
        for tick in range(len(out)):
            out[tick] = simulated.encoders()
            simulated.step(command(tick, out[tick]))
    return out


def gap(a: np.ndarray, b: np.ndarray) -> float:
    """RMS over joints and the motion that counts [mrad]."""
    counted = slice(round(BEFORE / PERIOD), None)
    return 1e3 * float(np.sqrt(np.mean((a[counted] - b[counted]) ** 2)))


def round_trip(
    arm: NominalArm, effects: tuple[AppliedEffect, ...], folder: Path
) -> dict[str, Gaps]:
    """Gaps by simulator."""
    none = np.zeros(arm.n_joints)
    bare = replace(arm, armature=none, coulomb=none, viscous=none)
    needs = any(isinstance(e.effect, Transmission | Drift) for e in effects)
    gaps = {}
    for name, (form, run) in TARGETS.items():
        left_out = any(not holds(FORMATS[form].held, e.effect) for e in effects)
        own = arm if form == "mjcf" else bare
        if needs and own is bare:
            gaps[name] = Gaps(None, None, left_out)
            continue
        loop, both = Loop(own), []
        recorded = on_the_arm(own, effects, loop)
        for these in ((), exported(effects, own)):
            file = folder / f"arm.{form}"
            export(CorrectedArm(own, these), form, file)
            ticks = len(loop.q)
            seen = run(file, own.joints, loop.q[0], ticks, loop.command())
            both.append(gap(seen, recorded))
        gaps[name] = Gaps(both[0], both[1], left_out)
    return gaps


def main() -> None:
    """Print the table."""
    options = command_line(
        __doc__,
        effects=",".join(("none", "friction", *CATALOGUE)),
        out=Path("out/round_trip"),
    ).parse_args()
    # DART looks for no file below the current folder
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    arm = iiwa()
    # shapes would collide in one engine and not in the other
    arm = replace(arm, urdf=without_meshes(arm.urdf, out / "iiwa.urdf"))
    results = {}
    heads = [f"{name} ({form})" for name, (form, _) in TARGETS.items()]
    print("| effect | " + " | ".join(heads) + " |\n" + "|---" * (len(heads) + 1) + "|")
    for name in options.effects.split(","):
        results[name] = round_trip(arm, effects_of(name, arm), out)
        cells = [str(each) for each in results[name].values()]
        print(f"| `{name}` | " + " | ".join(cells) + " |", flush=True)
    write_json(results, out / "round_trip.json")


if __name__ == "__main__":
    main()
