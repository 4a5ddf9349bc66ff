"""Exported arms in MuJoCo, PyBullet and DART by the engines' own readers; nothing of Gapscope is imported here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

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


TARGETS = {
    "MuJoCo": ("mjcf", in_mujoco),
    "PyBullet": ("urdf", in_pybullet),
    "DART": ("sdf", in_dart),
}
"""Format and runner by name of the simulator."""
