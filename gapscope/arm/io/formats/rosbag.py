"""ROS 2 bags: a rosbag2 folder, a single .db3 file, or MCAP; every topic about joints becomes a table."""

from __future__ import annotations

import sqlite3
import struct
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.control_messages import known_typestores
from gapscope.arm.io.formats.joint_messages import JOINT_TRAJECTORY, SAMPLES, Sample
from gapscope.arm.io.formats.sample_tables import (
    followed_trajectories,
    tables_of_samples,
)
from gapscope.arm.io.log_table import Log

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
    samples: dict[tuple[str, str], list[Sample]] = defaultdict(list)
    description = None
    with _opened(path) as reader:
        known = [c for c in reader.connections if c.msgtype in SAMPLES]
        texts = [c for c in reader.connections if _describes_robot(c)]
        decoders = {
            kind: _Decoder(path, kind, reader.typestore)
            for kind in {c.msgtype for c in known + texts}
        }
        # an empty choice of connections would mean all of them
        for connection, logged, raw in (
            reader.messages(known + texts) if known + texts else ()
        ):
            kind = connection.msgtype
            message = decoders[kind](raw)
            if kind == TEXT:
                description = message.data
                continue
            samples[connection.topic, kind] += SAMPLES[kind](message, logged)
        others = [c for c in reader.connections if c not in known + texts]
        unread = tuple(dict.fromkeys(f"{c.topic} ({c.msgtype})" for c in others))
    for (topic, kind), found in samples.items():
        if kind == JOINT_TRAJECTORY:
            samples[topic, kind] = followed_trajectories(found)
    tables, notes = tables_of_samples(path, samples)
    storage = "MCAP" if _is_mcap(path) else "SQLite"
    return Log(path, f"ROS 2 bag ({storage})", tables, description, notes, unread)


def _describes_robot(connection: Any) -> bool:
    topic = connection.topic.rsplit("/", 1)[-1]
    return connection.msgtype == TEXT and topic == "robot_description"


def _is_mcap(path: Path) -> bool:
    files = path.iterdir() if path.is_dir() else [path]
    return any(file.suffix.lower() == ".mcap" for file in files)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A reader of the bag; what a damaged bag makes it raise becomes an ``InputError``."""
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
        ValueError,
        LookupError,
        MemoryError,
    )
    try:
        store = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=store) as reader:
            yield reader
    except damaged as error:
        raise InputError(
            f"cannot be read as a ROS 2 bag ({error})",
            "is the file complete? try ros2 bag info on it",
            file=path,
        ) from None


class _Decoder:
    """Decodes the messages of one type: by the bag's definition, else by the version that fits the first message."""

    def __init__(self, path: Path, kind: str, typestore: Any) -> None:
        self._path, self._kind = path, kind
        self._stores: Sequence[Any] = [typestore]
        if kind not in typestore.fielddefs:
            self._stores = known_typestores()

    def __call__(self, raw: bytes) -> Any:
        """The message.

        Raises:
            InputError: no version fits.
        """
        from rosbags.serde import SerdeError

        problem = ""
        for store in self._stores:
            try:
                message = store.deserialize_cdr(raw, self._kind)
            except (SerdeError, IndexError, MemoryError) as error:
                problem = str(error)
                continue
            self._stores = [store]
            return message
        raise InputError(
            f"a message of type {self._kind} cannot be decoded ({problem})",
            "record the bag with its message definitions (MCAP does), or convert it with ros2 bag convert",
            file=self._path,
        )
