"""Topics of ROS 2 bags beside joint states: controllers, all interfaces, commands; with and without definitions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import to_and_fro
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.rosbag import CONTROLLER_STATE, DYNAMIC_JOINT_STATE
from gapscope.arm.io.import_section import parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import Log, open_log
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

JOINTS = ["elbow", "shoulder"]
ORDER = [1, 0]
POINT = "trajectory_msgs/JointTrajectoryPoint"
MULTI = "trajectory_msgs/MultiDOFJointTrajectoryPoint"

# as printed by `ros2 interface show control_msgs/msg/JointTrajectoryControllerState`
NEWEST = f"""
std_msgs/Header header
string[] joint_names
{POINT} reference
{POINT} feedback
{POINT} error
{POINT} output
string[] multi_dof_joint_names
{MULTI} multi_dof_reference
{MULTI} multi_dof_feedback
{MULTI} multi_dof_error
{MULTI} multi_dof_output
float64 speed_scaling_factor
"""
OLDEST = f"""
std_msgs/Header header
string[] joint_names
{POINT} desired
{POINT} actual
{POINT} error
"""
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
    """A bag that is written message by message."""

    def __init__(self, folder: Path, controller_state: str, with_text: bool) -> None:
        self.store = get_typestore(Stores.ROS2_HUMBLE)
        types = get_types_from_msg(controller_state, CONTROLLER_STATE)
        self.store.register(types)
        self.store.register(get_types_from_msg(INTERFACES, DYNAMIC_JOINT_STATE))
        plugin = StoragePlugin.MCAP if with_text else StoragePlugin.SQLITE3
        # SQLite of version 4 knows no message definitions
        version = 9 if with_text else 8
        self.writer = Writer(folder, version=version, storage_plugin=plugin)
        self.connections: dict[str, Any] = {}

    def header(self, stamp: float) -> Any:
        """A header with a stamp."""
        types = self.store.types
        whole = round(stamp * 1e9)
        time = types["builtin_interfaces/msg/Time"](
            sec=whole // 10**9, nanosec=whole % 10**9
        )
        return types["std_msgs/msg/Header"](stamp=time, frame_id="")

    def point(self, due: float = 0.0, **fields: Any) -> Any:
        """A point of a trajectory."""
        whole = round(due * 1e9)
        duration = self.store.types["builtin_interfaces/msg/Duration"](
            sec=whole // 10**9, nanosec=whole % 10**9
        )
        names = ("positions", "velocities", "accelerations", "effort")
        arrays = {name: np.array(fields.get(name, []), dtype=float) for name in names}
        kind = self.store.types["trajectory_msgs/msg/JointTrajectoryPoint"]
        return kind(**arrays, time_from_start=duration)

    def multi(self) -> Any:
        """An empty point of a trajectory of bodies."""
        kind = self.store.types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]
        duration = self.store.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
        return kind(
            transforms=[], velocities=[], accelerations=[], time_from_start=duration
        )

    def write(self, topic: str, kind: str, logged: float, **fields: Any) -> None:
        """One message."""
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(
                topic, kind, typestore=self.store
            )
        message = self.store.types[kind](**fields)
        raw = self.store.serialize_cdr(message, kind)
        self.writer.write(self.connections[topic], round(logged * 1e9), raw)


def without_definitions(folder: Path) -> Path:
    """The bag's file without what it says of the types, as ROS 2 before Iron stores it."""
    import sqlite3

    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as content:
        content.execute("DELETE FROM message_definitions")
    return file


def controller_bag(
    folder: Path, recording: Recording, definition: str, with_text: bool
) -> Path:
    """A bag with the state of a controller at every second row of a recording."""
    bag = Bag(folder, definition, with_text)
    new = "reference" in definition
    q, dq, tau = recording.q, recording.dq, recording.tau
    assert dq is not None and tau is not None
    with bag.writer:
        for i in range(0, len(recording.t), 2):
            stamp = 1e9 + recording.t[i]
            reference = bag.point(
                positions=q[i, ORDER] + 0.1, velocities=dq[i, ORDER] + 0.2
            )
            feedback = bag.point(positions=q[i, ORDER], velocities=dq[i, ORDER])
            points: dict[str, Any] = {"error": bag.point()}
            if new:
                points |= {"reference": reference, "feedback": feedback}
                points["output"] = bag.point(effort=tau[i, ORDER])
                points["multi_dof_joint_names"] = []
                names = ("reference", "feedback", "error", "output")
                points |= {f"multi_dof_{name}": bag.multi() for name in names}
                points["speed_scaling_factor"] = 0.75
            else:
                points |= {"desired": reference, "actual": feedback}
            bag.write(
                "/arm_controller/state",
                CONTROLLER_STATE,
                stamp + 0.003,
                header=bag.header(stamp),
                joint_names=JOINTS,
                **points,
            )
    return folder if with_text else without_definitions(folder)


@pytest.mark.parametrize("with_text", [True, False])
@pytest.mark.parametrize("definition", [NEWEST, OLDEST])
def test_a_controller_state_alone_is_a_recording(
    definition: str,
    with_text: bool,
    recording: Recording,
    arm: NominalArm,
    tmp_path: Path,
) -> None:
    path = controller_bag(tmp_path / "bag", recording, definition, with_text)
    back = load_recording(path, arm)
    assert recording.dq is not None and recording.tau is not None
    np.testing.assert_allclose(back.t, recording.t[::2], atol=1e-9)
    np.testing.assert_array_equal(back.q, recording.q[::2])
    np.testing.assert_array_equal(back.q_ref, recording.q[::2] + 0.1)
    np.testing.assert_array_equal(back.dq_ref, recording.dq[::2] + 0.2)
    if definition == NEWEST:
        np.testing.assert_array_equal(back.tau, recording.tau[::2])
    else:
        assert back.tau is None


def whole_bag(folder: Path, recording: Recording) -> Path:
    """Joint states, all interfaces at a fifth of the rate, commands, and a robot description."""
    bag = Bag(folder, NEWEST, True)
    types = bag.store.types
    q = recording.q
    with bag.writer:
        bag.write("/robot_description", "std_msgs/msg/String", 1e9, data="<robot/>")
        for i, t in enumerate(recording.t):
            header = bag.header(1e9 + t)
            bag.write(
                "/joint_states",
                "sensor_msgs/msg/JointState",
                1e9 + t,
                header=header,
                name=JOINTS,
                position=q[i, ORDER],
                velocity=np.array([]),
                effort=np.array([]),
            )
            if i % 5 == 0:
                value = types["control_msgs/msg/InterfaceValue"]
                values = [
                    value(
                        interface_names=["temperature", "current"],
                        values=np.array([30.0 + t, 2.0 * q[i, j]]),
                    )
                    for j in ORDER
                ]
                bag.write(
                    "/dynamic_joint_states",
                    DYNAMIC_JOINT_STATE,
                    1e9 + t,
                    header=header,
                    joint_names=JOINTS,
                    interface_values=values,
                )
        for start in (0.2, 1.0):
            points = [
                bag.point(due, positions=[start + due, -due]) for due in (0, 0.5, 1.0)
            ]
            bag.write(
                "/arm_controller/joint_trajectory",
                "trajectory_msgs/msg/JointTrajectory",
                1e9 + start,
                header=bag.header(0),
                joint_names=JOINTS,
                points=points,
            )
    return folder


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    t = np.arange(200) / 100
    q, _ = to_and_fro(t)
    folder = tmp_path_factory.mktemp("bag") / "whole"
    return open_log(whole_bag(folder, Recording("motion", t, q)))


def test_every_topic_about_joints_is_a_table_on_one_time(log: Log) -> None:
    tables = {table.name: table.table for table in log.tables}
    assert log.format == "ROS 2 bag (MCAP)" and log.robot_description == "<robot/>"
    assert list(tables["/joint_states"].columns) == [
        "t",
        "position[elbow]",
        "position[shoulder]",
    ]
    interfaces = tables["/dynamic_joint_states"]
    np.testing.assert_allclose(interfaces.columns["t"], np.arange(40) / 20, atol=1e-9)
    np.testing.assert_allclose(
        interfaces.columns["temperature[elbow]"], 30 + np.arange(40) / 20
    )


def test_a_new_trajectory_ends_the_one_before(log: Log) -> None:
    tables = {table.name: table.table for table in log.tables}
    commands = tables["/arm_controller/joint_trajectory"]
    np.testing.assert_allclose(
        commands.columns["t"], [0.2, 0.7, 1.0, 1.5, 2.0], atol=1e-9
    )
    np.testing.assert_allclose(
        commands.columns["positions[elbow]"], [0.2, 0.7, 1.0, 1.5, 2.0]
    )


def test_channels_from_topics_that_the_case_names(log: Log, arm: NominalArm) -> None:
    section = {
        "join": "hold",
        "tau": {
            "topic": "/dynamic_joint_states",
            "column": "current[{joint}]",
            "unit": "A",
            "motor_constant": 0.1,
            "gear_ratio": [100, 50],
        },
        "q_ref": {
            "topic": "/arm_controller/joint_trajectory",
            "column": "positions[{joint}]",
        },
    }
    importing = parse_import(section, 2, Path("case.yaml"))
    recording = load_recording(log.path, arm, importing, complete=True)
    assert recording.t[0] == pytest.approx(0.2), "cut before the first command"
    assert recording.tau is not None and recording.q_ref is not None
    row = int(np.searchsorted(recording.t, 0.999))
    # held: the current of the last fifth row, in joint order shoulder, elbow; 0.1 N m/A times gears
    np.testing.assert_allclose(
        recording.tau[row], recording.q[row] * 2 * [10, 5], rtol=1e-9
    )
    np.testing.assert_allclose(recording.q_ref[row], [0.0, 1.0])
    assert recording.temperature is not None
    np.testing.assert_allclose(recording.temperature[row], 31.0)


def test_a_topic_that_covers_little_is_not_joined(
    recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    bag = Bag(tmp_path / "bag", NEWEST, True)
    with bag.writer:
        for i, t in enumerate(recording.t):
            state = {"position": recording.q[i], "velocity": [], "effort": []}
            bag.write(
                "/joint_states",
                "sensor_msgs/msg/JointState",
                t + 1,
                header=bag.header(1 + t),
                name=list(arm.joints),
                **{name: np.array(x, dtype=float) for name, x in state.items()},
            )
            if i % 2 == 0 and i < 60:
                value = bag.store.types["control_msgs/msg/InterfaceValue"]
                one = value(interface_names=["temperature"], values=np.array([30.0]))
                bag.write(
                    "/dynamic",
                    DYNAMIC_JOINT_STATE,
                    t + 1,
                    header=bag.header(1 + t),
                    joint_names=list(arm.joints),
                    interface_values=[one, one],
                )
    back = load_recording(tmp_path / "bag", arm)
    assert back.temperature is None and len(back.t) == len(recording.t)
    assert "temperature of /dynamic left out: it covers 30% of the motion" in back.notes


def test_a_message_of_another_shape(arm: NominalArm, tmp_path: Path) -> None:
    bag = Bag(tmp_path / "bag", "float64[3] something", False)
    with bag.writer:
        bag.write("/state", CONTROLLER_STATE, 1.0, something=np.arange(3.0))
    with pytest.raises(InputError, match="of type control_msgs.* cannot be decoded"):
        open_log(without_definitions(tmp_path / "bag"))


def test_joint_states_beside_a_message_of_another_shape(
    recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    bag = Bag(tmp_path / "bag", "float64[3] something", False)
    with bag.writer:
        bag.write("/state", CONTROLLER_STATE, 1.0, something=np.arange(3.0))
        for i, t in enumerate(recording.t):
            bag.write(
                "/joint_states",
                "sensor_msgs/msg/JointState",
                t + 1,
                header=bag.header(1 + t),
                name=list(arm.joints),
                position=recording.q[i],
                velocity=np.array([]),
                effort=np.array([]),
            )
    log = open_log(without_definitions(tmp_path / "bag"))
    assert log.names == ["/joint_states"]
    assert log.unread == (f"{CONTROLLER_STATE}: of unknown form",)
