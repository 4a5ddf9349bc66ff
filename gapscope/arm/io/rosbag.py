"""Joint states from ROS 2 bags: a rosbag2 folder, a single .db3 file, or MCAP."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.table import Table
from gapscope.arm.nominal import NominalArm

JOINT_STATE = "sensor_msgs/msg/JointState"
"""The message type that holds names, positions [rad], velocities [rad/s] and efforts [N m] of joints."""


def read_bag(
    path: Path,
    arm: NominalArm,
    *,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
) -> Table:
    """Joint states of a bag as a table with the columns ``t``, ``q1..``, ``dq1..`` and ``tau1..``.

    Time is the header's stamp counted from the first one, or the time of logging if the stamps are not set.

    Args:
        path: rosbag2 folder, ``.db3`` or ``.mcap`` file.
        arm: the arm whose joints are wanted.
        topic: topic to read; may be omitted if only one holds joint states.
        joints: names of the joints in the bag, in the arm's order; by default the arm's own names, or, if the
            bag knows none of those, the bag's order.

    Raises:
        InputError: the bag is damaged or incomplete, has no such topic, or not the joints.
    """
    messages = _messages(path, topic)
    names, notes = _joint_names(path, messages[0][1], arm, joints)
    wanted = set(names)
    full = [
        (stamp, message) for stamp, message in messages if wanted <= set(message.name)
    ]
    if not full:
        raise InputError(
            f"no message holds all of the joints {', '.join(names)}; the first holds {', '.join(messages[0][1].name)}",
            "name the joints as the bag does in joints: of the import section",
            file=path,
        )
    if len(full) < len(messages):
        notes = (
            *notes,
            f"joint states left out that lack a joint of the arm: {len(messages) - len(full)}",
        )
    stamps = np.array(
        [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in full],
        dtype=np.int64,
    )
    if not stamps.any():
        stamps = np.array([stamp for stamp, _ in full], dtype=np.int64)
        notes = (
            *notes,
            "time is that of logging: the stamps in the messages are not set",
        )
    columns: dict[str, np.ndarray] = {"t": (stamps - stamps[0]) * 1e-9}
    for channel, field in (("q", "position"), ("dq", "velocity"), ("tau", "effort")):
        columns |= _columns(channel, field, full, names)
    return Table(path, columns, range(1, len(full) + 1), "message", notes=notes)


def _messages(path: Path, topic: str | None) -> list[tuple[int, Any]]:
    """All joint states of the bag as (time of logging [ns], message)."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.rosbag2 import ReaderError
    from rosbags.typesys import Stores, get_typestore

    damaged = (
        AnyReaderError,
        ReaderError,
        sqlite3.Error,
        struct.error,
        OSError,
        EOFError,
        AssertionError,
    )
    try:
        with AnyReader(
            [path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)
        ) as reader:
            connections = _connections(path, reader.connections, topic)
            messages = [
                (stamp, reader.deserialize(raw, connection.msgtype))
                for connection, stamp, raw in reader.messages(connections)
            ]
    except damaged as error:
        raise InputError(
            f"cannot be read as a ROS 2 bag ({error})",
            "is the file complete? try ros2 bag info on it",
            file=path,
        ) from None
    if not messages:
        raise InputError(
            "has no joint states",
            "was the robot's driver running while it was recorded?",
            file=path,
        )
    return messages


def _connections(
    path: Path, connections: Sequence[Any], topic: str | None
) -> list[Any]:
    """The connections of the one topic to read."""
    found = [
        c for c in connections if c.msgtype == JOINT_STATE and topic in (None, c.topic)
    ]
    topics = sorted({c.topic for c in found})
    if not topics:
        listed = (
            ", ".join(f"{c.topic} ({c.msgtype})" for c in connections) or "no topics"
        )
        raise InputError(
            f"has no topic{f' {topic}' if topic else ''} of type {JOINT_STATE}; it has {listed}",
            "record the topic of the joint states, or name it in topic: of the import section",
            file=path,
        )
    if len(topics) > 1:
        raise InputError(
            f"has joint states on several topics: {', '.join(topics)}",
            "name one in topic: of the import section",
            file=path,
        )
    return found


def _joint_names(
    path: Path, message: Any, arm: NominalArm, joints: Sequence[str] | None
) -> tuple[list[str], tuple[str, ...]]:
    """The bag's names of the arm's joints, in the arm's order, and a note if they had to be assumed."""
    if joints is not None:
        return list(joints), ()
    if set(message.name) & set(arm.joints):
        return list(arm.joints), ()
    if len(message.name) != arm.n_joints:
        raise InputError(
            f"holds the joints {', '.join(message.name)}; the arm has {', '.join(arm.joints)}",
            "name the bag's joints, in the arm's order, in joints: of the import section",
            file=path,
        )
    return list(message.name), (
        f"joints are matched by order: {message.name[0]} .. {message.name[-1]} in the bag are "
        f"{arm.joints[0]} .. {arm.joints[-1]} of the arm",
    )


def _columns(
    channel: str, field: str, messages: list[tuple[int, Any]], names: list[str]
) -> dict[str, np.ndarray]:
    """Columns ``channel1..`` of one field of the messages; none if the driver leaves the field empty."""
    if any(
        len(getattr(message, field)) != len(message.name) for _, message in messages
    ):
        return {}
    places = {
        tuple(message.name): [message.name.index(name) for name in names]
        for _, message in messages
    }
    values = np.array(
        [
            np.asarray(getattr(message, field))[places[tuple(message.name)]]
            for _, message in messages
        ]
    )
    return {f"{channel}{j + 1}": values[:, j] for j in range(len(names))}
