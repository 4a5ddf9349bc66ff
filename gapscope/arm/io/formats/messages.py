"""Messages of bags: joint states and controllers of ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

# Definitions of the messages of ros2_control, for bags that hold none: those of SQLite before ROS 2 Iron.
#
# Written after the package control_msgs of ros2_control (docs.ros.org, ``control_msgs/msg``), whose controller state
# has changed three times under one name.


CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
"""Message type of the state of a joint trajectory controller."""
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
"""Message type of all state interfaces of ros2_control, by joint."""

_POINT = "trajectory_msgs/JointTrajectoryPoint"
_MULTI_DOF_POINT = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_NEW = ("reference", "feedback", "error", "output")
_DEPRECATED = ("desired", "actual")


def _control_state(
    points: tuple[str, ...], multi_dof: tuple[str, ...], speed_scaling: bool
) -> str:
    """Text of one version of the controller state."""
    lines = ["std_msgs/Header header", "string[] joint_names"]
    lines += [f"{_POINT} {name}" for name in points]
    if multi_dof:
        lines.append("string[] multi_dof_joint_names")
    lines += [f"{_MULTI_DOF_POINT} multi_dof_{name}" for name in multi_dof]
    if speed_scaling:
        lines.append("float64 speed_scaling_factor")
    return "\n".join(lines)


CONTROLLER_STATES = {
    "Jazzy": _control_state(_NEW, _NEW, True),
    "Iron": _control_state(_NEW, _NEW, False),
    "Humble": _control_state(_NEW + _DEPRECATED, _NEW + _DEPRECATED, False),
    "Foxy": _control_state((*_DEPRECATED, "error"), (), False),
}
"""Text of the controller state by the first ROS 2 release with it."""

_OTHERS = {
    DYNAMIC_JOINT_STATE: (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values"
    ),
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values",
}


def known_typestores() -> list[Any]:
    """Type stores of rosbags, one for each version of the controller state, over the messages of ROS 2 itself."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    stores = []
    for controller_state in CONTROLLER_STATES.values():
        store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in {**_OTHERS, CONTROLLER_STATE: controller_state}.items():
            store.register(get_types_from_msg(text, name))
        stores.append(store)
    return stores


# Messages about joints as samples: values under names such as ``position[joint_1]``, with a stamp.


JOINT_STATE = "sensor_msgs/msg/JointState"
"""The message type that holds names, positions [rad], velocities [rad/s] and efforts [N m] of joints."""
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
"""The message type that commands a joint trajectory controller."""

_POINTS = ("reference", "feedback", "error", "output", "desired", "actual")
_POINT_FIELDS = ("positions", "velocities", "accelerations", "effort")


@dataclass(frozen=True)
class Sample:
    """One sample of a topic.

    Attributes:
        stamp: time of its header [ns]; 0 if the sender has not set it.
        logged: time of logging [ns].
        columns: names of the values.
        values: (m,).
        joints: that it is about.
    """

    stamp: int
    logged: int
    columns: tuple[str, ...]
    values: np.ndarray
    joints: tuple[str, ...]


def nanoseconds(time: Any) -> int:
    """A time or a duration of ROS as a whole number [ns]."""
    return int(time.sec) * 10**9 + int(time.nanosec)


@lru_cache(maxsize=1024)
def _labels(fields: tuple[str, ...], joints: tuple[str, ...]) -> tuple[str, ...]:
    """``field[joint]`` for each field, joint by joint."""
    return tuple(f"{field}[{joint}]" for field in fields for joint in joints)


def _sample(
    message: Any,
    logged: int,
    joints: tuple[str, ...],
    fields: dict[str, np.ndarray],
) -> Sample:
    """A sample of the fields that have a value for each joint; the others were left empty by the sender."""
    full = {name: x for name, x in fields.items() if len(x) == len(joints)}
    columns = _labels(tuple(full), joints)
    values = np.concatenate([*full.values(), []])
    return Sample(nanoseconds(message.header.stamp), logged, columns, values, joints)


def _joint_state(message: Any, logged: int) -> Iterator[Sample]:
    names = ("position", "velocity", "effort")
    fields = {name: getattr(message, name) for name in names}
    yield _sample(message, logged, tuple(message.name), fields)


def _controller_state(message: Any, logged: int) -> Iterator[Sample]:
    fields = {
        f"{point}.{name}": getattr(getattr(message, point), name)
        for point in _POINTS
        if hasattr(message, point)
        for name in _POINT_FIELDS
    }
    sample = _sample(message, logged, tuple(message.joint_names), fields)
    if hasattr(message, "speed_scaling_factor"):
        sample = Sample(
            sample.stamp,
            logged,
            (*sample.columns, "speed_scaling_factor"),
            np.append(sample.values, message.speed_scaling_factor),
            sample.joints,
        )
    yield sample


def _dynamic_joint_state(message: Any, logged: int) -> Iterator[Sample]:
    columns: list[str] = []
    values: list[float] = []
    joints = tuple(message.joint_names)
    for joint, interfaces in zip(joints, message.interface_values, strict=False):
        columns += [f"{name}[{joint}]" for name in interfaces.interface_names]
        values += list(interfaces.values)
    stamp = nanoseconds(message.header.stamp)
    if len(columns) == len(values):
        yield Sample(stamp, logged, tuple(columns), np.array(values), joints)


def _joint_trajectory(message: Any, logged: int) -> Iterator[Sample]:
    """The points of a trajectory, at the times for which they are meant; a stamp of 0 means from now on."""
    start = nanoseconds(message.header.stamp) or logged
    joints = tuple(message.joint_names)
    for point in message.points:
        fields = {name: getattr(point, name) for name in _POINT_FIELDS}
        sample = _sample(message, logged, joints, fields)
        due = start + nanoseconds(point.time_from_start)
        yield Sample(due, logged, sample.columns, sample.values, joints)


SAMPLES: dict[str, Callable[[Any, int], Iterator[Sample]]] = {
    JOINT_STATE: _joint_state,
    CONTROLLER_STATE: _controller_state,
    DYNAMIC_JOINT_STATE: _dynamic_joint_state,
    JOINT_TRAJECTORY: _joint_trajectory,
}
"""Samples of a message and its time of logging [ns], by the type of the message."""
