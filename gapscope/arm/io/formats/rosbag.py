"""ROS 2 bags: a rosbag2 folder, a single .db3 file, or MCAP; every topic about joints becomes a table."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import check_folder_files, is_file, is_folder
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.io.formats.messages import (
    JOINT_TRAJECTORY,
    SAMPLES,
    Sample,
    known_typestores,
)
from gapscope.arm.io.formats.table_files import followed_trajectories, tables_of_samples
from gapscope.arm.io.table import Log

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
    content = _content(path)
    samples: dict[tuple[str, str], list[Sample]] = defaultdict(list)
    description = None
    stores, unknown = _fitting_stores(path, content)
    for topic, kind, logged, raw in content.messages:
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
    unread = (*content.unread, *(f"{kind}: of unknown form" for kind in unknown))
    storage = "MCAP" if _is_mcap(path) else "SQLite"
    return Log(path, f"ROS 2 bag ({storage})", tables, description, unread=unread)


@dataclass(frozen=True)
class _Content:
    """What a bag holds.

    Attributes:
        messages: topic, type, time of logging [ns] and bytes of each message about joints or the robot.
        typestore: the definitions in the bag.
        unread: the other topics with their types.
    """

    messages: Sequence[tuple[str, str, int, bytes]]
    typestore: Any
    unread: tuple[str, ...]


def _content(path: Path) -> _Content:
    """The messages of a bag, still encoded.

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
            unread = tuple(dict.fromkeys(f"{c.topic} ({c.msgtype})" for c in others))
            return _Content(messages, reader.typestore, unread)
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
    path: Path, content: _Content
) -> tuple[dict[str, Any], dict[str, InputError]]:
    """For each type of messages the definitions by which its first message can be decoded, or why there are none."""
    first: dict[str, bytes] = {}
    for _, kind, _, raw in content.messages:
        first.setdefault(kind, raw)
    stores: dict[str, Any] = {}
    unknown: dict[str, InputError] = {}
    for kind, raw in first.items():
        in_bag = kind in content.typestore.fielddefs
        for store in [content.typestore] if in_bag else known_typestores():
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
