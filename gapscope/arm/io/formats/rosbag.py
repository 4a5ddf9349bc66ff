"""ROS 2 bags: a rosbag2 folder, a single .db3 file, or MCAP; every topic about joints becomes a table."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import check_folder_files, is_file, is_folder
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.io.table import Log, Table

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
        columns = (*sample.columns, "speed_scaling_factor")
        values = np.append(sample.values, message.speed_scaling_factor)
        sample = replace(sample, columns=columns, values=values)
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
        due = start + nanoseconds(point.time_from_start)
        yield replace(_sample(message, logged, joints, fields), stamp=due)


SAMPLES: dict[str, Callable[[Any, int], Iterator[Sample]]] = {
    JOINT_STATE: _joint_state,
    CONTROLLER_STATE: _controller_state,
    DYNAMIC_JOINT_STATE: _dynamic_joint_state,
    JOINT_TRAJECTORY: _joint_trajectory,
}
"""Samples of a message and its time of logging [ns], by the type of the message."""


# Tables from the samples of a bag's topics, on one time.


OTHER_CLOCK = 1.0
"""Stamps and times of logging that are further apart than this come from two clocks, simulated and real [s]."""

LOGGING_TIME = "time is that of logging: the stamps in the messages are not set"
"""Note of a table without stamps."""


def tables_of_samples(
    path: Path, topics: Mapping[tuple[str, str], Sequence[Sample]]
) -> tuple[Table, ...]:
    """A table for each topic and set of joints, in the order of the bag.

    Args:
        path: the bag, for messages.
        topics: samples by topic and type of message.
    """
    every = [sample for samples in topics.values() for sample in samples]
    stamped = [s.logged - s.stamp for s in every if s.stamp]
    # a sample without a stamp takes its time of logging, on the clock of the stamps
    lead = int(np.median(stamped)) if stamped else 0
    if abs(lead) < OTHER_CLOCK * 1e9:
        lead = 0
    start = min((s.stamp or s.logged - lead for s in every), default=0)
    tables: list[Table] = []
    for (topic, kind), samples in topics.items():
        groups: dict[frozenset[str], list[Sample]] = defaultdict(list)
        for sample in samples:
            groups[frozenset(sample.joints)].append(sample)
        for group in groups.values():
            table = _table_of(path, group, start, lead)
            tables.append(replace(table, name=topic, kind=kind))
    return tuple(tables)


def _table_of(path: Path, samples: Sequence[Sample], start: int, lead: int) -> Table:
    """Samples about the same joints, with the columns that all of them have."""
    stamps = np.array([s.stamp or s.logged - lead for s in samples], dtype=np.int64)
    columns: dict[str, np.ndarray] = {"t": (stamps - start) * 1e-9}
    variants = {sample.columns for sample in samples}
    # in the order of the first; a joint named twice counts once
    kept = [
        x for x in dict.fromkeys(samples[0].columns) if all(x in v for v in variants)
    ]
    places = {names: [names.index(name) for name in kept] for names in variants}
    values = np.array([sample.values[places[sample.columns]] for sample in samples])
    columns |= {name: values[:, place] for place, name in enumerate(kept)}
    notes = []
    if not all(sample.stamp for sample in samples):
        notes.append(LOGGING_TIME)
    dropped = set[str]().union(*variants) - set(kept)
    if dropped:
        notes.append(
            f"left out, as some messages lack them: {', '.join(sorted(dropped))}"
        )
    rows = range(1, len(samples) + 1)
    return Table(path, columns, rows, "message", notes=tuple(notes))


def followed_trajectories(points: Sequence[Sample]) -> list[Sample]:
    """The points of all commanded trajectories in the order of time; a new one ends what is left of the one before.

    Args:
        points: in the order in which they were logged.
    """
    kept: list[Sample] = []
    for point in points:
        while kept and kept[-1].logged < point.logged and kept[-1].stamp >= point.stamp:
            kept.pop()
        kept.append(point)
    return kept


METADATA = "metadata.yaml"
"""The file that describes a bag's folder."""
TEXT = "std_msgs/msg/String"
"""Message type of the robot description."""


def read_bag(path: Path) -> Log:
    """The topics about joints of a bag, on one time that starts with the first sample of any of them.

    Read are joint states, states of joint trajectory controllers, dynamic joint states, joint trajectories, and the
    robot description. Messages are decoded by the definitions in the bag, else by those that Gapscope knows.

    Args:
        path: rosbag2 folder, ``.db3`` or ``.mcap`` file.

    Raises:
        InputError: the bag is damaged or incomplete, or a message is not what its type says.
    """
    check_folder_files(bag_files(path))
    if is_file(path / METADATA):
        # the library's own reader of YAML writes out aliases of aliases
        read_yaml(path / METADATA, "is the bag complete?")
    messages, typestore, others = _content(path)
    samples: dict[tuple[str, str], list[Sample]] = defaultdict(list)
    description = None
    first: dict[str, bytes] = {}
    for _, kind, _, raw in messages:
        first.setdefault(kind, raw)
    stores, unknown = _fitting_stores(path, first, typestore)
    for topic, kind, logged, raw in messages:
        if kind in unknown:
            continue
        message = _decoded(path, kind, raw, stores[kind])
        if kind == TEXT:
            description = message.data
        else:
            samples[topic, kind] += _samples(path, kind, message, logged)
    for (topic, kind), found in samples.items():
        if kind == JOINT_TRAJECTORY:
            samples[topic, kind] = followed_trajectories(found)
    tables = tables_of_samples(path, samples)
    if unknown and not tables:
        raise next(iter(unknown.values()))
    unread = (*others, *(f"{kind}: of unknown form" for kind in unknown))
    storage = "MCAP" if _is_mcap(path) else "SQLite"
    return Log(path, f"ROS 2 bag ({storage})", tables, description, unread=unread)


def _content(path: Path) -> tuple[list[tuple[str, str, int, bytes]], Any, list[str]]:
    """Topic, type, time of logging [ns] and bytes of each message of a bag about joints or the robot.

    Beside them the definitions in the bag, and its other topics with their types.

    Raises:
        InputError: the bag is damaged or incomplete.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        store = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=store) as reader:
            wanted = [
                c
                for c in reader.connections
                if c.msgtype in SAMPLES or _describes_robot(c)
            ]
            # an empty choice of connections would mean all of them
            found = reader.messages(wanted) if wanted else ()
            messages = [_message(c, logged, raw) for c, logged, raw in found]
            others = [c for c in reader.connections if c not in wanted]
            unread = dict.fromkeys(f"{c.topic} ({c.msgtype})" for c in others)
            return messages, reader.typestore, list(unread)
    # the library passes on whatever SQLite, MCAP and decompressors raise on damaged files
    except Exception as error:
        raise InputError(
            f"cannot be read as a ROS 2 bag ({error})",
            "is the file complete? try ros2 bag info on it",
            file=path,
        ) from error


def _message(connection: Any, logged: Any, raw: Any) -> tuple[str, str, int, bytes]:
    """Topic, type, time of logging [ns] and bytes of a message; SQLite may hold anything in any column."""
    if not isinstance(logged, int) or not isinstance(raw, (bytes, memoryview)):
        raise ValueError("a message is not of bytes, or its time no whole number")
    return connection.topic, connection.msgtype, logged, bytes(raw)


def bag_files(path: Path) -> list[Path]:
    """The files of a bag: those of a folder, or the bag itself."""
    if not is_folder(path):
        return [path]
    return sorted(file for file in path.iterdir() if not is_folder(file))


def _describes_robot(connection: Any) -> bool:
    topic = connection.topic.rsplit("/", 1)[-1]
    return connection.msgtype == TEXT and topic == "robot_description"


def _is_mcap(path: Path) -> bool:
    return any(file.suffix.lower() == ".mcap" for file in bag_files(path))


def _fitting_stores(
    path: Path, first: Mapping[str, bytes], typestore: Any
) -> tuple[dict[str, Any], dict[str, InputError]]:
    """For each type of messages the definitions by which its first message can be decoded, or why there are none."""
    stores: dict[str, Any] = {}
    unknown: dict[str, InputError] = {}
    for kind, raw in first.items():
        in_bag = kind in typestore.fielddefs
        for store in [typestore] if in_bag else known_typestores():
            try:
                _decoded(path, kind, raw, store)
            except InputError as error:
                unknown[kind] = error
            else:
                stores[kind] = store
                unknown.pop(kind, None)
                break
    return stores, unknown


def _samples(path: Path, kind: str, message: Any, logged: int) -> list[Sample]:
    """Samples of a message.

    Raises:
        InputError: the definition in the bag gives the type other fields than ROS does.
    """
    try:
        return list(SAMPLES[kind](message, logged))
    except (AttributeError, TypeError) as error:
        raise InputError(
            f"a message of type {kind} has other fields than that type ({error})",
            "are the message definitions in the bag those of ROS?",
            file=path,
        ) from None


def _decoded(path: Path, kind: str, raw: bytes, store: Any) -> Any:
    """A message by the definitions of a type store.

    Raises:
        InputError: they do not fit.
    """
    try:
        return store.deserialize_cdr(raw, kind)
    # definitions in a bag may name types that there are not, or themselves; the library passes on what it meets
    except Exception as error:
        raise InputError(
            f"a message of type {kind} cannot be decoded ({type(error).__name__}: {error})",
            "record the bag with its message definitions (MCAP does), or convert it with ros2 bag convert",
            file=path,
        ) from None
