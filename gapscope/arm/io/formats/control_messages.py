"""Definitions of the messages of ros2_control, for bags that hold none: those of SQLite before ROS 2 Iron.

Written after the package control_msgs of ros2_control (docs.ros.org, ``control_msgs/msg``), whose controller state
has changed three times under one name.
"""

from __future__ import annotations

from typing import Any

CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
"""Message type of the state of a joint trajectory controller."""
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
"""Message type of all state interfaces of ros2_control, by joint."""

_POINT = "trajectory_msgs/JointTrajectoryPoint"
_MULTI_DOF_POINT = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_NEW = ("reference", "feedback", "error", "output")
_DEPRECATED = ("desired", "actual")


def _controller_state(
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
    "Jazzy": _controller_state(_NEW, _NEW, True),
    "Iron": _controller_state(_NEW, _NEW, False),
    "Humble": _controller_state(_NEW + _DEPRECATED, _NEW + _DEPRECATED, False),
    "Foxy": _controller_state((*_DEPRECATED, "error"), (), False),
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
