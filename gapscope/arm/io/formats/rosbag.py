"""ROS 2 bags: a rosbag2 folder, a single .db3 file, or MCAP; every topic about joints becomes a table."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import (
    check_folder_files,
    complete_file,
    is_file,
    is_folder,
)
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.io.table import Log, Table

CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
"""Message type of the state of a joint trajectory controller."""
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
"""Message type of all state interfaces of ros2_control, by joint."""


def known_typestores() -> list[Any]:
    """Type stores of rosbags, one for each version of the controller state, over the messages of ROS 2 itself."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    text = Path(__file__).with_name("control_msgs.yaml").read_text(encoding="utf-8")
    known, stores = yaml.safe_load(text), []
    # the same type name has had four contents: each gets a store of its own
    for state in known.pop(CONTROLLER_STATE).values():
        store = get_typestore(Stores.ROS2_HUMBLE)
        for name, definition in {**known, CONTROLLER_STATE: state}.items():
            store.register(get_types_from_msg(definition, name))
        stores.append(store)
    return stores


# Messages about joints as samples: values under names such as ``position[joint_1]``, with a stamp.


JOINT_STATE = "sensor_msgs/msg/JointState"
"""The message type that holds names, positions [rad], velocities [rad/s] and efforts [N m] of joints."""
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
"""The message type that commands a joint trajectory controller."""

SAMPLED = (JOINT_STATE, CONTROLLER_STATE, DYNAMIC_JOINT_STATE, JOINT_TRAJECTORY)
"""Message types that are read."""

_STATE_POINTS = ("reference", "feedback", "error", "output", "desired", "actual")
_POINT_FIELDS = ("positions", "velocities", "accelerations", "effort")


class Sample(NamedTuple):
    """One sample of a topic.

    Attributes:
        stamp: time of its header [ns]; 0 if the sender has not set it.
        logged: time of logging [ns].
        joints: that it is about.
        columns: names of the values.
        values: (m,).
        after: how much later it is due, as a point of a trajectory is [ns].
    """

    stamp: int
    logged: int
    joints: tuple[str, ...]
    columns: tuple[str, ...]
    values: np.ndarray
    after: int = 0


def nanoseconds(time: Any) -> int:
    """A time or a duration of ROS as a whole number [ns]."""
    return int(time.sec) * 10**9 + int(time.nanosec)


@lru_cache(maxsize=1024)
def _labels(fields: tuple[str, ...], joints: tuple[str, ...]) -> tuple[str, ...]:
    """``field[joint]`` for each field, joint by joint."""
    return tuple(f"{field}[{joint}]" for field in fields for joint in joints)


def samples_of(kind: str, message: Any, logged: int) -> Iterator[Sample]:
    """Samples of a message of one of the types ``SAMPLED``, which was logged at a time [ns].

    Points of a trajectory are due after its stamp; one of 0 means from now on.
    """
    stamp = nanoseconds(message.header.stamp)
    joints = tuple(message.name if kind == JOINT_STATE else message.joint_names)

    def sample(fields: Mapping[str, np.ndarray], after: int = 0) -> Sample:
        """Of the fields that have a value for each joint; the others were left empty by the sender."""
        full = {name: x for name, x in fields.items() if len(x) == len(joints)}
        values = np.concatenate([*full.values(), []])
        columns = _labels(tuple(full), joints)
        return Sample(stamp, logged, joints, columns, values, after)

    if kind == JOINT_STATE:
        names = ("position", "velocity", "effort")
        yield sample({name: getattr(message, name) for name in names})
    elif kind == DYNAMIC_JOINT_STATE:
        pairs = [
            (f"{name}[{joint}]", value)
            for joint, own in zip(joints, message.interface_values, strict=False)
            for name, value in zip(own.interface_names, own.values, strict=False)
        ]
        columns = tuple(name for name, _ in pairs)
        values = np.array([value for _, value in pairs])
        yield Sample(stamp, logged, joints, columns, values)
    elif kind == JOINT_TRAJECTORY:
        # a controller sends a trajectory at once: each point is due at its own time
        for point in message.points:
            after = nanoseconds(point.time_from_start)
            yield sample({name: getattr(point, name) for name in _POINT_FIELDS}, after)
    else:
        # fields that this version of the message has
        found = sample(
            {
                f"{point}.{name}": getattr(getattr(message, point), name)
                for point in _STATE_POINTS
                if hasattr(message, point)
                for name in _POINT_FIELDS
            }
        )
        if hasattr(message, "speed_scaling_factor"):
            found = found._replace(
                columns=(*found.columns, "speed_scaling_factor"),
                values=np.append(found.values, message.speed_scaling_factor),
            )
        yield found


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

    def due(s: Sample) -> int:
        """Time of a sample [ns]."""
        return (s.stamp or s.logged - lead) + s.after

    start = min(map(due, every), default=0)
    tables: list[Table] = []
    for (topic, kind), samples in topics.items():
        if kind == JOINT_TRAJECTORY:
            samples = _followed(samples, due)
        groups: dict[frozenset[str], list[Sample]] = defaultdict(list)
        for sample in samples:
            groups[frozenset(sample.joints)].append(sample)
        for group in groups.values():
            # whole nanoseconds: a float of a date has no digits left for them
            stamps = [due(sample) - start for sample in group]
            columns, dropped = _columns(group)
            columns = {"t": np.array(stamps, dtype=np.int64) * 1e-9, **columns}
            notes = [] if all(sample.stamp for sample in group) else [LOGGING_TIME]
            if dropped:
                left_out = ", ".join(sorted(dropped))
                notes.append(f"left out, as some messages lack them: {left_out}")
            tables.append(
                Table(
                    path,
                    columns,
                    range(1, len(group) + 1),
                    "message",
                    notes=tuple(notes),
                    name=topic,
                    kind=kind,
                )
            )
    return tuple(tables)


def _columns(samples: Sequence[Sample]) -> tuple[dict[str, np.ndarray], set[str]]:
    """The columns that all samples have, (N,) each, and the names of others."""
    variants = {sample.columns for sample in samples}
    # in the order of the first; a joint named twice counts once
    kept = [
        x for x in dict.fromkeys(samples[0].columns) if all(x in v for v in variants)
    ]
    # the places of the kept columns in each variant of the message
    places = {names: [names.index(name) for name in kept] for names in variants}
    values = np.array([sample.values[places[sample.columns]] for sample in samples])
    columns = {name: values[:, place] for place, name in enumerate(kept)}
    return columns, set[str]().union(*variants) - set(kept)


def _followed(points: Sequence[Sample], due: Callable[[Sample], int]) -> list[Sample]:
    """The points of all commanded trajectories in the order of time; a new one ends what is left of the one before.

    Args:
        points: in the order in which they were logged.
        due: time of a point [ns].
    """
    kept: list[Sample] = []
    for point in points:
        # what was due after the start of the next trajectory never happened
        while kept and kept[-1].logged < point.logged and due(kept[-1]) >= due(point):
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
    messages, typestore, unread = _content(path)
    samples: dict[tuple[str, str], list[Sample]] = defaultdict(list)
    stores: dict[str, Any] = {}
    description = None
    for topic, kind, logged, raw in messages:
        # one store for each type: definitions are tried on its first message
        if kind not in stores:
            stores[kind] = _fitting_store(path, kind, raw, typestore)
        if isinstance(stores[kind], InputError):
            continue
        message = _decoded(path, kind, raw, stores[kind])
        if kind == TEXT:
            description = message.data
            continue
        try:
            samples[topic, kind] += samples_of(kind, message, logged)
        except (AttributeError, TypeError) as error:
            raise InputError(
                f"a message of type {kind} has other fields than that type ({error})",
                "are the message definitions in the bag those of ROS?",
                file=path,
            ) from None
    tables = tables_of_samples(path, samples)
    for kind, store in stores.items():
        if isinstance(store, InputError):
            # a type that nobody knows spoils the bag only if there is nothing else
            if not tables:
                raise store
            unread.append(f"{kind}: of unknown form")
    mcap = any(file.suffix.lower() == ".mcap" for file in bag_files(path))
    form = f"ROS 2 bag ({'MCAP' if mcap else 'SQLite'})"
    return Log(path, form, tables, description, unread=tuple(unread))


def _content(path: Path) -> tuple[list[tuple[str, str, int, bytes]], Any, list[str]]:
    """Topic, type, time of logging [ns] and bytes of each message of a bag about joints or the robot.

    Beside them the definitions in the bag, and its other topics with their types.

    Raises:
        InputError: the bag is damaged or incomplete.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    remedy = "is the file complete? try ros2 bag info on it"
    with complete_file(path, "a ROS 2 bag", remedy):
        store = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=store) as reader:
            # by type, and of texts the one that holds the robot's file
            wanted = [
                c
                for c in reader.connections
                if c.msgtype in SAMPLED
                or (c.msgtype, c.topic.rsplit("/", 1)[-1])
                == (TEXT, "robot_description")
            ]
            messages = []
            # an empty choice of connections would mean all of them
            for c, logged, raw in reader.messages(wanted) if wanted else ():
                # SQLite may hold anything in any column
                if not (
                    isinstance(logged, int) and isinstance(raw, (bytes, memoryview))
                ):
                    raise ValueError("a message is not of bytes, or its time no number")
                messages.append((c.topic, c.msgtype, logged, bytes(raw)))
            others = [c for c in reader.connections if c not in wanted]
            unread = dict.fromkeys(f"{c.topic} ({c.msgtype})" for c in others)
            return messages, reader.typestore, list(unread)


def bag_files(path: Path) -> list[Path]:
    """The files of a bag: those of a folder, or the bag itself."""
    if not is_folder(path):
        return [path]
    return sorted(file for file in path.iterdir() if not is_folder(file))


def _fitting_store(path: Path, kind: str, raw: bytes, typestore: Any) -> Any:
    """Definitions by which a first message of a type can be decoded, or the error that says why there are none."""
    error: InputError | None = None
    # definitions of the bag itself, else each version that is known, until one fits
    for store in [typestore] if kind in typestore.fielddefs else known_typestores():
        try:
            _decoded(path, kind, raw, store)
            return store
        except InputError as found:
            error = found
    return error


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
