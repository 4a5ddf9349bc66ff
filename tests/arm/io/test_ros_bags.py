"""ROS 2 bags: joint states, controllers, interfaces, commands; with message definitions and without."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import to_and_fro
from numpy.typing import ArrayLike
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.rosbag import (
    CONTROLLER_STATE,
    DYNAMIC_JOINT_STATE,
    JOINT_STATE,
    JOINT_TRAJECTORY,
)
from gapscope.arm.io.import_section import Import, parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import Log, open_log
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

JOINTS, ORDER = ["elbow", "shoulder"], [1, 0]
STRING = "std_msgs/msg/String"
POINT = "trajectory_msgs/JointTrajectoryPoint"
MULTI = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
EPOCH = 1e9
"""When the first row was recorded [s]."""
PARTS = ("reference", "feedback", "error", "output")


def state_of(*parts: str, more: str = "") -> str:
    """Definition of the state of a controller with these points of a trajectory."""
    points = "".join(f"\n{POINT} {part}" for part in parts)
    return f"std_msgs/Header header\nstring[] joint_names{points}\n{more}"


# as printed by `ros2 interface show control_msgs/msg/JointTrajectoryControllerState`
OLDEST = state_of("desired", "actual", "error")
NEWEST = state_of(
    *PARTS,
    more="string[] multi_dof_joint_names\n"
    + "".join(f"{MULTI} multi_dof_{part}\n" for part in PARTS)
    + "float64 speed_scaling_factor\n",
)
INTERFACES = """
std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values
================================================================================
MSG: control_msgs/InterfaceValue
string[] interface_names
float64[] values
"""


class Bag:
    """A bag that is written message by message, MCAP or SQLite."""

    def __init__(
        self, folder: Path, controller_state: str = NEWEST, mcap: bool = True
    ) -> None:
        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(controller_state, CONTROLLER_STATE))
        self.store.register(get_types_from_msg(INTERFACES, DYNAMIC_JOINT_STATE))
        plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
        self.writer = Writer(folder, version=9, storage_plugin=plugin)
        self.connections: dict[str, Any] = {}

    def made(self, kind: str, **fields: Any) -> Any:
        """A message, or a part of one; numbers and lists of numbers are arrays."""
        return self.store.types[kind](**fields)

    def time(self, kind: str, seconds: float) -> Any:
        """A time or a duration."""
        whole, rest = divmod(round(seconds * 1e9), 10**9)
        return self.made(f"builtin_interfaces/msg/{kind}", sec=whole, nanosec=rest)

    def point(self, due: float = 0.0, **fields: ArrayLike) -> Any:
        """A point of a trajectory."""
        names = ("positions", "velocities", "accelerations", "effort")
        arrays = {name: np.array(fields.get(name, []), dtype=float) for name in names}
        due = self.time("Duration", due)
        kind = "trajectory_msgs/msg/JointTrajectoryPoint"
        return self.made(kind, **arrays, time_from_start=due)

    def multi(self) -> Any:
        """An empty point of a trajectory of bodies."""
        empty: dict[str, Any] = dict(transforms=[], velocities=[], accelerations=[])
        kind = "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"
        return self.made(kind, **empty, time_from_start=self.time("Duration", 0))

    def write(
        self, topic: str, kind: str, logged: float, stamp: float | None, **fields: Any
    ) -> None:
        """One message, with a header if it has a stamp."""
        if topic not in self.connections:
            made = self.writer.add_connection(topic, kind, typestore=self.store)
            self.connections[topic] = made
        if stamp is not None:
            at = self.time("Time", stamp)
            fields["header"] = self.made("std_msgs/msg/Header", stamp=at, frame_id="")
        raw = self.store.serialize_cdr(self.made(kind, **fields), kind)
        self.writer.write(self.connections[topic], round(logged * 1e9), raw)

    def state(
        self,
        t: float,
        names: list[str],
        topic: str = "/joint_states",
        stamp: float | None = None,
        **fields: ArrayLike,
    ) -> None:
        """A joint state at a time from the start, by default stamped with it."""
        keys = ("position", "velocity", "effort")
        arrays = {key: np.array(fields.get(key, []), dtype=float) for key in keys}
        stamp = EPOCH + t if stamp is None else stamp
        self.write(topic, JOINT_STATE, EPOCH + t, stamp, name=names, **arrays)

    def interfaces(self, topic: str, t: float, values: list[dict[str, float]]) -> None:
        """All interfaces of the joints."""
        kind = "control_msgs/msg/InterfaceValue"
        named = [{"interface_names": [*x], "values": np.array([*x.values()])} for x in values]  # fmt: skip
        fields = {"joint_names": JOINTS}
        fields["interface_values"] = [self.made(kind, **x) for x in named]
        self.write(topic, DYNAMIC_JOINT_STATE, EPOCH + t, EPOCH + t, **fields)


def without_definitions(folder: Path) -> Path:
    """The bag's file without what it says of the types, as ROS 2 before Iron stores it."""
    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as content:
        content.execute("DELETE FROM message_definitions")
    return file


States = Callable[..., Path]


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory, recording: Recording) -> States:
    """A bag of the recording whose joints stand under ``names``, the elbow first; a gripper speaks in between."""

    def bag_of(
        names: list[str] = JOINTS,
        *topics: str,
        mcap: bool = False,
        stamp: float | None = None,
    ) -> Path:
        topics = topics or ("/joint_states",)
        order, folder = ORDER[: len(names)], tmp_path_factory.mktemp("bag") / "bag"
        bag, one = Bag(folder, mcap=mcap), recording
        with bag.writer:
            for i, t in enumerate(one.t):
                values = {"position": one.q[i, order], "velocity": one.dq[i, order]}
                values["effort"] = one.tau[i, order]
                for topic in topics:
                    bag.state(t, names, topic, stamp, **values)
                if i % 50 == 0:
                    bag.state(t, ["gripper"], topics[0], stamp, position=[0.0])
        return folder

    return bag_of


@pytest.fixture(scope="module")
def plain(states: States) -> dict[str, Path]:
    """Such a bag in each storage."""
    return {"db3": states(), "mcap": states(mcap=True)}


def test_round_trip_with_joints_in_another_order(
    plain: dict[str, Path], recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    """Of a folder, and of its file alone."""
    bags = [plain["db3"]]
    for form, folder in plain.items():
        alone = tmp_path / f"alone.{form}"
        bags.append(Path(shutil.copy(next(folder.glob(f"*.{form}")), alone)))
    for bag in bags:
        back = load_recording(bag, arm, complete=True)
        np.testing.assert_allclose(back.t, recording.t, atol=1e-9)
        for name in ("q", "dq", "tau"):
            np.testing.assert_array_equal(getattr(back, name), getattr(recording, name))
        assert back.notes == ("joint states left out that lack a joint of the arm: 4",)


def test_foreign_names_by_order_or_by_import_on_several_topics(
    states: States, recording: Recording, arm: NominalArm
) -> None:
    """With stamps that are not set."""
    bag = states(["fer_b", "fer_a"], "/a", "/b", stamp=0.0)
    by_order = load_recording(bag, arm, Import(topic="/b"))
    matched = "joints are matched by order: fer_b .. fer_a in the log are shoulder"
    assert by_order.notes[0].startswith(matched)
    np.testing.assert_array_equal(by_order.q, recording.q[:, ORDER])
    np.testing.assert_allclose(by_order.t, recording.t, atol=1e-6)
    assert "time is that of logging" in "".join(by_order.notes)
    named = Import(topic="/b", joints=("fer_a", "fer_b"))
    np.testing.assert_array_equal(load_recording(bag, arm, named).q, recording.q)
    with pytest.raises(InputError, match="has q on several topics: /a, /b"):
        load_recording(bag, arm)
    with pytest.raises(InputError, match="has no topic /c about joints; it has /a"):
        load_recording(bag, arm, Import(topic="/c"))


def test_bags_without_the_joints(states: States, arm: NominalArm) -> None:
    asked = "holds all of the joints shoulder, elbow; the first holds "
    for names in (["x"], ["shoulder", "x"]):
        message = f"no message of /joint_states {asked}{', '.join(names)}"
        with pytest.raises(InputError, match=message):
            load_recording(states(names), arm)


def test_a_bag_of_texts_names_what_it_has(arm: NominalArm, tmp_path: Path) -> None:
    text = Bag(tmp_path / "text")
    with text.writer:
        text.write("/words", STRING, EPOCH, None, data="hello")
    with pytest.raises(InputError, match=r"it has /words \(std_msgs/msg/String\)"):
        load_recording(tmp_path / "text", arm)


@pytest.mark.parametrize("form", ["db3", "mcap"])
def test_truncated(form: str, plain: dict[str, Path], tmp_path: Path) -> None:
    content = next(plain[form].glob(f"*.{form}")).read_bytes()
    path = tmp_path / f"cut.{form}"
    for share in (0.0, 0.01, 0.5, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError, match=f"cut.{form}: .*"):
            open_log(path)


def test_folder_without_metadata(arm: NominalArm, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="neither metadata.yaml of a rosbag2"):
        load_recording(tmp_path, arm)
    (tmp_path / "bag_0.mcap").touch()
    with pytest.raises(InputError, match="give one of its files: bag_0.mcap"):
        load_recording(tmp_path, arm)


@pytest.mark.parametrize(
    ("definition", "mcap"),
    [(NEWEST, True), (NEWEST, False), (OLDEST, False)],
    ids=["newest", "newest, not defined", "oldest, not defined"],
)
def test_a_controller_state_alone_is_a_recording(
    definition: str, mcap: bool, recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    """Here at every fourth row."""
    bag, newest = Bag(tmp_path / "bag", definition, mcap), definition == NEWEST
    part = recording.part(slice(None, None, 4))
    with bag.writer:
        for i, stamp in enumerate(EPOCH + part.t):
            at, rate, effort = (x[i, ORDER] for x in (part.q, part.dq, part.tau))
            reference = bag.point(positions=at + 0.1, velocities=rate + 0.2)
            feedback = bag.point(positions=at, velocities=rate)
            fields: dict[str, Any] = {"error": bag.point(), "joint_names": JOINTS}
            if newest:
                fields |= {"reference": reference, "feedback": feedback}
                fields |= {f"multi_dof_{name}": bag.multi() for name in PARTS}
                fields["output"] = bag.point(effort=effort)
                fields |= {"multi_dof_joint_names": [], "speed_scaling_factor": 0.75}
            else:
                fields |= {"desired": reference, "actual": feedback}
            bag.write("/arm/state", CONTROLLER_STATE, stamp + 0.003, stamp, **fields)
    path = tmp_path / "bag" if mcap else without_definitions(tmp_path / "bag")
    back = load_recording(path, arm)
    np.testing.assert_allclose(back.t, part.t, atol=1e-9)
    np.testing.assert_array_equal(back.q, part.q)
    np.testing.assert_array_equal(back.q_ref, part.q + 0.1)
    np.testing.assert_array_equal(back.dq_ref, part.dq + 0.2)
    if newest:
        np.testing.assert_array_equal(back.tau, part.tau)
    else:
        assert back.tau is None


COMMANDS = "/arm_controller/joint_trajectory"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """Joint states, all interfaces at a fifth of the rate, commands, and a robot description."""
    q, _ = to_and_fro(np.arange(200) / 100)
    folder = tmp_path_factory.mktemp("bag") / "whole"
    bag = Bag(folder)
    with bag.writer:
        bag.write("/robot_description", STRING, EPOCH, None, data="<robot/>")
        for i, at in enumerate(q[:, ORDER]):
            t = i / 100
            bag.state(t, JOINTS, position=at)
            if i % 5 == 0:
                both = [{"temperature": 30 + t, "current": 2 * x} for x in at]
                bag.interfaces("/dynamic_joint_states", t, both)
        for start in (0.2, 1.0):
            path = [(start + due, -due) for due in (0, 0.5, 1.0)]
            points = [bag.point(-down, positions=(up, down)) for up, down in path]
            fields = {"joint_names": JOINTS, "points": points}
            bag.write(COMMANDS, JOINT_TRAJECTORY, EPOCH + start, 0.0, **fields)
    return open_log(folder)


def test_every_topic_about_joints_is_a_table_on_one_time(log: Log) -> None:
    tables = {table.name: table.columns for table in log.tables}
    assert log.format == "ROS 2 bag (MCAP)" and log.robot_description == "<robot/>"
    states = ["t", "position[elbow]", "position[shoulder]"]
    assert list(tables["/joint_states"]) == states
    slow, all_of = np.arange(40) / 20, tables["/dynamic_joint_states"]
    np.testing.assert_allclose(all_of["t"], slow, atol=1e-9)
    np.testing.assert_allclose(all_of["temperature[elbow]"], 30 + slow)
    # a new trajectory ends the one before
    due = [0.2, 0.7, 1.0, 1.5, 2.0]
    np.testing.assert_allclose(tables[COMMANDS]["t"], due, atol=1e-9)
    np.testing.assert_allclose(tables[COMMANDS]["positions[elbow]"], due)


SIMULATED = 5.0
"""Time of a simulation when its bag begins [s]."""


@pytest.mark.parametrize(
    ("states", "sent"),
    [(SIMULATED, 0.0), (SIMULATED, SIMULATED + 0.5), (0.0, 0.0), (0.0, EPOCH + 0.5)],
)
def test_commands_and_states_are_on_one_time_whichever_is_stamped(
    states: float, sent: float, tmp_path: Path
) -> None:
    bag, t, due = Bag(tmp_path / "bag"), np.arange(50) / 10, np.arange(4.0)
    with bag.writer:
        for now in t:
            stamp = states and states + now
            bag.state(now, JOINTS, stamp=stamp, position=[now, now])
        points = [bag.point(after, positions=(after, after)) for after in due]
        fields = {"joint_names": JOINTS, "points": points}
        bag.write(COMMANDS, JOINT_TRAJECTORY, EPOCH + 0.5, sent, **fields)
    for table in open_log(tmp_path / "bag").tables:
        expected = t if table.name == "/joint_states" else 0.5 + due
        np.testing.assert_allclose(table.columns["t"], expected, atol=1e-6)


def test_channels_from_topics_that_the_case_names(log: Log, arm: NominalArm) -> None:
    current = {"unit": "A", "motor_constant": 0.1, "gear_ratio": [100, 50]}
    place = {"topic": "/dynamic_joint_states", "column": "current[{joint}]"}
    section = {"join": "hold", "tau": place | current}
    section["q_ref"] = {"topic": COMMANDS, "column": "positions[{joint}]"}
    importing = parse_import(section, 2, Path("case.yaml"))
    found = load_recording(log.path, arm, importing, complete=True)
    # cut before the first command
    assert found.t[0] == pytest.approx(0.2)
    row = int(np.searchsorted(found.t, 0.999))
    # held: the current of the last fifth row, in joint order shoulder, elbow; 0.1 N m/A times gears
    np.testing.assert_allclose(found.tau[row], found.q[row] * 2 * [10, 5], rtol=1e-9)
    np.testing.assert_allclose(found.q_ref[row], [0.0, 1.0])
    np.testing.assert_allclose(found.temperature[row], 31.0)


def test_a_topic_that_covers_little_is_not_joined(
    recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    bag = Bag(tmp_path / "bag")
    with bag.writer:
        for i, t in enumerate(recording.t):
            bag.state(t, JOINTS, position=recording.q[i, ORDER])
            if i % 2 == 0 and i < 60:
                bag.interfaces("/dynamic", t, [{"temperature": 30.0}] * 2)
    back = load_recording(tmp_path / "bag", arm)
    assert back.temperature is None and len(back.t) == len(recording.t)
    assert "temperature of /dynamic left out: it covers 30% of the motion" in back.notes


@pytest.mark.parametrize("beside", [False, True])
def test_a_message_of_another_shape(beside: bool, tmp_path: Path) -> None:
    """It is an error alone, and left unread beside joint states."""
    bag = Bag(tmp_path / "bag", "float64[3] something", mcap=False)
    with bag.writer:
        bag.write("/state", CONTROLLER_STATE, EPOCH, None, something=np.arange(3.0))
        for t in np.arange(20) / 10 if beside else ():
            bag.state(t, JOINTS, position=[t, t])
    path = without_definitions(tmp_path / "bag")
    if beside:
        log = open_log(path)
        assert log.names == ["/joint_states"]
        assert log.unread == (f"{CONTROLLER_STATE}: of unknown form",)
    else:
        with pytest.raises(InputError, match="of type control_msgs.* be decoded"):
            open_log(path)
