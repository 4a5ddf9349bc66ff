"""A recording and its gap as a scene for viewers."""

from __future__ import annotations

import heapq
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from shutil import move
from typing import Any

import numpy as np

from gapscope.arm.dynamics.kinematics import link_poses
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write, folder_aside
from gapscope.arm.nominal import NominalArm
from gapscope.reports.pages import COLOURS, write_html

# A recording and what the model says of it as one MCAP file, which Foxglove, Rerun and PlotJuggler open.
#
# Topics, all of ROS 2 messages: ``/recorded/joint_states`` and ``/predicted/joint_states`` (recorded position with the
# predicted torque), ``/remaining/joint_states`` (recorded minus predicted torque), ``/simulated/joint_states`` if the
# recording was replayed, ``/robot_description``, and ``/tf`` with the links of the recorded arm and, under the prefix
# ``simulated/``, of the simulated one.


POSES_PER_SECOND = 50.0
"""Rate at which links are placed [Hz]; smoother than a screen shows adds nothing."""
BASE = "base"
"""Name of the frame in which all links stand."""
SIMULATED = "simulated/"
"""Prefix of the frames of the simulated arm."""


Message = tuple[str, int, Any]
"""Topic, time [ns] and message."""


@dataclass(frozen=True)
class Scene:
    """A motion and the torques that belong to it; n joints.

    Attributes:
        arm: the nominal arm.
        t: time of the recording [s], shape (N,).
        q: recorded positions [rad or m], (N, n).
        recorded: recorded torque [N m or N], (N, n), or ``None``.
        predicted: torque that the model predicts [N m or N], (N, n).
        simulated: positions of the replayed motion at these times [rad or m], (N, n), or ``None``.
    """

    arm: NominalArm
    t: np.ndarray
    q: np.ndarray
    recorded: np.ndarray | None
    predicted: np.ndarray
    simulated: np.ndarray | None = None


def write_mcap(scene: Scene, path: Path) -> None:
    """Write the scene.

    Raises:
        GapscopeError: the file cannot be written.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    # messages as ROS 2 defines them, without ROS installed
    store = get_typestore(Stores.ROS2_HUMBLE)
    with atomic_write(path) as aside, folder_aside(path) as folder:
        bag = folder / "scene"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topics = {}
            # each stream is in order: merged as they come, never all in memory
            streams = _streams(scene, store.types)
            for topic, stamp, message in heapq.merge(*streams, key=itemgetter(1)):
                if topic not in topics:
                    topics[topic] = writer.add_connection(
                        topic, message.__msgtype__, typestore=store
                    )
                data = store.serialize_cdr(message, message.__msgtype__)
                writer.write(topics[topic], stamp, data)
        # the writer makes a folder with one file, which is what is wanted
        (file,) = bag.glob("*.mcap")
        move(file, aside)


def _streams(scene: Scene, types: Any) -> Iterator[Iterable[Message]]:
    """The messages of each topic."""
    # viewers expect a URDF here; with MJCF the links move without a body
    if scene.arm.urdf.suffix != ".xml":
        # in UTF-8, whatever the file is in
        text = ET.tostring(ET.parse(scene.arm.urdf).getroot(), encoding="unicode")
        start = _nanoseconds(scene.t[0])
        yield [("/robot_description", start, types["std_msgs/msg/String"](data=text))]
    series = {"recorded": scene.recorded, "predicted": scene.predicted}
    # what remains asks for a recorded torque
    if scene.recorded is not None:
        series["remaining"] = scene.recorded - scene.predicted
    for name, torque in series.items():
        if torque is not None:
            yield _states(scene, name, scene.q, torque, types)
    yield _poses(scene, scene.q, "", types)
    if scene.simulated is not None:
        # a message may leave out the efforts
        silent = np.empty((len(scene.t), 0))
        yield _states(scene, "simulated", scene.simulated, silent, types)
        yield _poses(scene, scene.simulated, SIMULATED, types)


def _states(
    scene: Scene, name: str, q: np.ndarray, torque: np.ndarray, types: Any
) -> Iterator[Message]:
    """Joint states at every sample."""
    # of the positions: not every log has velocities
    speed = np.gradient(q, scene.t, axis=0)
    for t, *state in zip(scene.t, q, speed, torque, strict=True):
        message = types["sensor_msgs/msg/JointState"](
            _header(t, types), list(scene.arm.joints), *state
        )
        yield f"/{name}/joint_states", _nanoseconds(t), message


def _poses(scene: Scene, q: np.ndarray, prefix: str, types: Any) -> Iterator[Message]:
    """Transforms of all links against the base."""
    rate = 1.0 / float(np.median(np.diff(scene.t)))
    step = max(1, round(rate / POSES_PER_SECOND))
    poses = link_poses(RigidBody(scene.arm), q[::step])
    for moment, links in zip(scene.t[::step], poses, strict=True):
        header = _header(moment, types)
        transforms = []
        # all against the base, so that no chain has to be known
        for name, numbers in links.items():
            place = types["geometry_msgs/msg/Vector3"](*numbers[:3])
            turn = types["geometry_msgs/msg/Quaternion"](*numbers[3:])
            pose = types["geometry_msgs/msg/Transform"](place, turn)
            stamped = types["geometry_msgs/msg/TransformStamped"]
            transforms.append(stamped(header, f"{prefix}{name}", pose))
        yield "/tf", _nanoseconds(moment), types["tf2_msgs/msg/TFMessage"](transforms)


def _header(moment: float, types: Any) -> Any:
    seconds, rest = divmod(_nanoseconds(moment), 10**9)
    stamp = types["builtin_interfaces/msg/Time"](seconds, rest)
    return types["std_msgs/msg/Header"](stamp, BASE)


def _nanoseconds(moment: float) -> int:
    return round(float(moment) * 1e9)


def write_layout(scene: Scene, path: Path) -> None:
    """Write a layout for Foxglove: the arm, real beside simulated, and torques and positions of each joint.

    Raises:
        GapscopeError: the file cannot be written.
    """
    arms = {"recorded": ""}
    if scene.simulated is not None:
        arms["simulated"] = SIMULATED
    write_html(
        "scene/foxglove.json.j2",
        path,
        joints=scene.arm.joints,
        arms=arms,
        base=BASE,
        colours=COLOURS,
    )
