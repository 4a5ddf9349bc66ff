"""ROS 2 bags: written with the rosbags library, read back."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from gapscope.arm.errors import InputError
from gapscope.arm.io.import_section import Import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

STORE = get_typestore(Stores.ROS2_HUMBLE)
JOINT_STATE = "sensor_msgs/msg/JointState"


def joint_state(stamp: float, names: list[str], **fields: Any) -> Any:
    """One message."""
    types = STORE.types
    nanoseconds = round(stamp * 1e9)
    time = types["builtin_interfaces/msg/Time"](
        sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
    )
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
    arrays = {
        key: np.asarray(fields.get(key, []), dtype=float)
        for key in ("position", "velocity", "effort")
    }
    return types[JOINT_STATE](header=header, name=names, **arrays)


def write_bag(
    folder: Path,
    recording: Recording,
    *,
    names: list[str],
    order: list[int],
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    topics: tuple[str, ...] = ("/joint_states",),
    epoch: float = 1e9,
    message_type: str = JOINT_STATE,
) -> Path:
    """A bag of a recording whose joints stand under ``names`` in ``order``; a gripper speaks in between."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        connections = [
            writer.add_connection(topic, message_type, typestore=STORE)
            for topic in topics
        ]
        for i in range(len(recording.t) if message_type == JOINT_STATE else 0):
            stamp = 0.0 if epoch == 0 else epoch + recording.t[i]
            assert recording.tau is not None and recording.dq is not None
            message = joint_state(
                stamp,
                names,
                position=recording.q[i, order],
                velocity=recording.dq[i, order],
                effort=recording.tau[i, order],
            )
            logged = round((1e9 + recording.t[i]) * 1e9)
            for connection in connections:
                writer.write(
                    connection, logged, STORE.serialize_cdr(message, JOINT_STATE)
                )
            if i % 50 == 0:
                gripper = joint_state(stamp, ["gripper"], position=[0.0])
                writer.write(
                    connections[0], logged, STORE.serialize_cdr(gripper, JOINT_STATE)
                )
    return folder


@pytest.mark.parametrize("form", ["folder", "db3", "mcap"])
def test_round_trip_with_joints_in_another_order(
    form: str, recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    storage = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    bag = write_bag(
        tmp_path / "bag",
        recording,
        names=["elbow", "shoulder"],
        order=[1, 0],
        storage=storage,
    )
    if form != "folder":
        bag = Path(shutil.copy(next(bag.glob(f"*.{form}")), tmp_path / f"alone.{form}"))
    back = load_recording(bag, arm, complete=True)
    np.testing.assert_allclose(back.t, recording.t, atol=1e-9)
    for name in ("q", "dq", "tau"):
        np.testing.assert_array_equal(getattr(back, name), getattr(recording, name))
    assert back.notes == ("joint states left out that lack a joint of the arm: 4",)


def test_foreign_names_by_order_or_by_import(
    recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / "bag", recording, names=["fer_b", "fer_a"], order=[1, 0])
    by_order = load_recording(bag, arm)
    assert by_order.notes[0].startswith(
        "joints are matched by order: fer_b .. fer_a in the log are shoulder .. elbow"
    )
    np.testing.assert_array_equal(by_order.q, recording.q[:, [1, 0]])
    by_name = load_recording(bag, arm, Import(joints=("fer_a", "fer_b")))
    np.testing.assert_array_equal(by_name.q, recording.q)


def test_stamps_that_are_not_set(
    recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    bag = write_bag(
        tmp_path / "bag", recording, names=["shoulder", "elbow"], order=[0, 1], epoch=0
    )
    back = load_recording(bag, arm)
    np.testing.assert_allclose(back.t, recording.t, atol=1e-6)
    assert any("time is that of logging" in note for note in back.notes)


def test_several_topics(recording: Recording, arm: NominalArm, tmp_path: Path) -> None:
    names = ["shoulder", "elbow"]
    bag = write_bag(
        tmp_path / "bag", recording, names=names, order=[0, 1], topics=("/a", "/b")
    )
    with pytest.raises(InputError, match="has q on several topics: /a, /b"):
        load_recording(bag, arm)
    assert len(load_recording(bag, arm, Import(topic="/b")).t) == len(recording.t)
    with pytest.raises(
        InputError,
        match="has no topic /c about joints; it has /a",
    ):
        load_recording(bag, arm, Import(topic="/c"))


def test_bags_without_the_joints(
    recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    text = write_bag(
        tmp_path / "text",
        recording,
        names=[],
        order=[],
        message_type="std_msgs/msg/String",
    )
    with pytest.raises(
        InputError, match=r"it has /joint_states \(std_msgs/msg/String\)"
    ):
        load_recording(text, arm)
    one = write_bag(tmp_path / "one", recording, names=["x"], order=[0])
    with pytest.raises(
        InputError,
        match="no message of /joint_states holds all of the joints shoulder, elbow; the first holds x",
    ):
        load_recording(one, arm)
    half = write_bag(
        tmp_path / "half", recording, names=["shoulder", "x"], order=[0, 1]
    )
    with pytest.raises(
        InputError,
        match="holds all of the joints shoulder, elbow; the first holds shoulder, x",
    ):
        load_recording(half, arm)


@pytest.mark.parametrize("form", ["db3", "mcap"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.9])
def test_truncated(
    form: str, share: float, recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    storage = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    bag = write_bag(
        tmp_path / "bag",
        recording,
        names=["shoulder", "elbow"],
        order=[0, 1],
        storage=storage,
    )
    content = next(bag.glob(f"*.{form}")).read_bytes()
    path = tmp_path / f"cut.{form}"
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=f"cut.{form}: .*"):
        load_recording(path, arm)


def test_folder_without_metadata(arm: NominalArm, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="neither metadata.yaml of a rosbag2"):
        load_recording(tmp_path / "bag", arm)
    (tmp_path / "bag" / "bag_0.mcap").touch()
    with pytest.raises(InputError, match="give one of its files: bag_0.mcap"):
        load_recording(tmp_path / "bag", arm)
