"""Layouts of known logs, as data: how each is recognised, which column is which channel, and what its torque is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gapscope.arm.io.column_pattern import joints_in
from gapscope.arm.io.formats.messages import (
    CONTROLLER_STATE,
    DYNAMIC_JOINT_STATE,
    JOINT_STATE,
    JOINT_TRAJECTORY,
)
from gapscope.arm.io.table import Table
from gapscope.arm.recording import CHANNELS

LEROBOT = "LeRobot episode"
"""Kind of the tables of a LeRobot dataset."""


@dataclass(frozen=True)
class Place:
    """Where a layout holds one channel.

    Attributes:
        column: pattern of the column names, as in the import section.
        unit: of the column; empty if it is the recording's.
        holds: what the vendor says that the column holds, if its name does not say it.
    """

    column: str
    unit: str = ""
    holds: str = ""

    def joints(self, table: Table) -> list[str]:
        """Names or numbers of the joints for which the table has the column."""
        return joints_in(self.column, table.columns)

    def entry(self) -> str | dict[str, str]:
        """The entry of the import section."""
        return {"column": self.column, "unit": self.unit} if self.unit else self.column


@dataclass(frozen=True)
class LoadPlace:
    """Where a layout holds the load that a robot was told to carry, as a point.

    Attributes:
        mass: column of its mass [kg].
        com: pattern of the columns of its centre [m].
        frames: how links are called in whose frame the centre stands, by the endings of their names.
    """

    mass: str
    com: str
    frames: tuple[str, ...]


@dataclass(frozen=True)
class Layout:
    """A known log.

    Attributes:
        name: in words.
        places: by channel, where it may stand; the first that the table has counts.
        source: where this is documented.
        kind: type of messages or format to which it belongs; empty: any table with its columns.
        time: the ``time`` entry of the import section; ``None``: a column ``t`` in s.
        marks: patterns of which the table must have one, if its positions have a name that others use too.
        loads: where the load may stand that the robot was told.
    """

    name: str
    places: Mapping[str, Sequence[Place]]
    source: str
    kind: str = ""
    time: str | Mapping[str, Any] | None = None
    marks: tuple[str, ...] = ()
    loads: tuple[LoadPlace, ...] = ()

    def place(self, channel: str, table: Table) -> Place | None:
        """Where a table of this layout holds a channel, or ``None``."""
        places = self.places.get(channel, ())
        return next((place for place in places if place.joints(table)), None)

    def fits(self, table: Table) -> bool:
        """Whether a table has the positions, the time and the marks of this layout."""
        column = self.time
        if isinstance(column, Mapping):
            column = column.get("column")
        marked = [mark for mark in self.marks if joints_in(mark, table.columns)]
        timed = (column or "t") in table.columns
        named = bool(marked) or not self.marks
        return timed and named and self.place("q", table) is not None

    def channels(self, table: Table) -> dict[str, Place]:
        """The channels that a table of this layout holds."""
        found = {name: self.place(name, table) for name in CHANNELS}
        return {name: place for name, place in found.items() if place is not None}

    def section(self, table: Table) -> dict[str, Any]:
        """The import section for a table of this layout; amperes still lack their motor constants."""
        section: dict[str, Any] = {} if self.time is None else {"time": self.time}
        for name, place in self.channels(table).items():
            section[name] = place.entry()
        return section


_EFFORT = (
    "what the driver calls effort: torque of the joint or of its sensor, or motor current in A, or a torque without "
    "gravity, or one computed from gains; diagnose tells which"
)
_UR_TORQUE = "motor current times motor constant and gear ratio, by the robot's controller; with friction"
_UR_CURRENT = "motor current; times motor constant and gear ratio it is the motor's torque, friction included"
_UR_TARGET = (
    "computed by the controller's own model from the target motion: no measurement"
)
_FRANKA_SENSOR = (
    "joint torque sensor on the link's side: gravity included, no motor friction"
)
_FRANKA_MOTOR = (
    "the motor's position, over the gear: with it say nominal: {encoder: motor}"
)
_KORTEX_SENSOR = "joint torque sensor on the link's side, gravity included"
_KORTEX_CURRENT = (
    "motor current; times motor constant and gear ratio it is the motor's torque"
)
_COMMANDED = "what the controller commanded"

LAYOUTS: tuple[Layout, ...] = (
    Layout(
        "case format",
        {name: (Place(f"{name}{{j}}"),) for name in CHANNELS},
        "docs/case.md",
    ),
    Layout(
        "joint states of ROS",
        {
            "q": (Place("position[{joint}]"),),
            "dq": (Place("velocity[{joint}]"),),
            "tau": (Place("effort[{joint}]", holds=_EFFORT),),
        },
        "docs.ros.org, sensor_msgs/JointState",
        kind=JOINT_STATE,
    ),
    Layout(
        "state of a joint trajectory controller",
        {
            "q": (
                Place("feedback.positions[{joint}]"),
                Place("actual.positions[{joint}]"),
            ),
            "dq": (
                Place("feedback.velocities[{joint}]"),
                Place("actual.velocities[{joint}]"),
            ),
            "tau": (
                Place("feedback.effort[{joint}]", holds=_EFFORT),
                Place("actual.effort[{joint}]", holds=_EFFORT),
                Place("output.effort[{joint}]", holds=_COMMANDED),
            ),
            "q_ref": (
                Place("reference.positions[{joint}]"),
                Place("desired.positions[{joint}]"),
            ),
            "dq_ref": (
                Place("reference.velocities[{joint}]"),
                Place("desired.velocities[{joint}]"),
            ),
        },
        "docs.ros.org, control_msgs/JointTrajectoryControllerState",
        kind=CONTROLLER_STATE,
    ),
    Layout(
        "dynamic joint states of ros2_control",
        {
            "q": (Place("position[{joint}]"),),
            "dq": (Place("velocity[{joint}]"),),
            "tau": (
                Place("effort[{joint}]", holds=_EFFORT),
                Place("current[{joint}]", "A", holds="motor current"),
            ),
            "temperature": (Place("temperature[{joint}]"),),
        },
        "docs.ros.org, control_msgs/DynamicJointState",
        kind=DYNAMIC_JOINT_STATE,
    ),
    Layout(
        "LeRobot dataset",
        {
            "q": (
                Place("observation.state[{joint}.pos]"),
                Place("observation.state[{joint}]"),
            ),
            "dq": (
                Place("observation.state[{joint}.vel]"),
                Place("observation.velocity[{joint}]"),
                Place("observation.velocity[{joint}.pos]"),
            ),
            "tau": (
                Place("observation.state[{joint}.torque]", holds="of the driver"),
                Place("observation.effort[{joint}]", holds="of the driver"),
                Place("observation.effort[{joint}.pos]", holds="of the driver"),
            ),
            "q_ref": (Place("action[{joint}.pos]"), Place("action[{joint}]")),
        },
        "huggingface.co/docs/lerobot, LeRobotDataset v2.1 and v3.0",
        kind=LEROBOT,
    ),
    Layout(
        "UR, RTDE",
        {
            "q": (Place("actual_q_{j0}"),),
            "dq": (Place("actual_qd_{j0}"),),
            "tau": (
                Place("actual_current_as_torque_{j0}", holds=_UR_TORQUE),
                Place("actual_current_{j0}", "A", holds=_UR_CURRENT),
                Place("target_moment_{j0}", holds=_UR_TARGET),
            ),
            "q_ref": (Place("target_q_{j0}"),),
            "dq_ref": (Place("target_qd_{j0}"),),
            "temperature": (Place("joint_temperatures_{j0}"),),
        },
        "Universal Robots, Real-Time Data Exchange guide",
        time="timestamp",
        loads=(LoadPlace("payload", "payload_cog_{j0}", ("tool0", "flange")),),
    ),
    Layout(
        "UR5 degradation, NIST",
        {
            "q": (Place("ROBOT_ACTUAL_JOINT_POSITIONS (J{j})", "deg"),),
            "dq": (Place("ROBOT_ACTUAL_JOINT_VELOCITIES (J{j})", "deg/s"),),
            "tau": (
                Place("ROBOT_ACTUAL_JOINT_CURRENTS (J{j})", "A", holds=_UR_CURRENT),
                Place("ROBOT_ACTUAL_JOINT_CURRENT (J{j})", "A", holds=_UR_CURRENT),
                Place("ROBOT_TARGET_JOINT_TORQUES (J{j})", holds=_UR_TARGET),
            ),
            "q_ref": (Place("ROBOT_TARGET_JOINT_POSITIONS (J{j})", "deg"),),
            "dq_ref": (Place("ROBOT_TARGET_JOINT_VELOCITIES (J{j})", "deg/s"),),
            "temperature": (Place("ROBOT_JOINT_TEMP (J{j})"),),
        },
        "NIST, Degradation Measurement of Robot Arm Position Accuracy, header of its tables",
        time="ROBOT_TIME",
    ),
    Layout(
        "libfranka, logToCSV",
        {
            "q": (Place("state.q[{j0}]"),),
            "dq": (Place("state.dq[{j0}]"),),
            "tau": (Place("state.tau_J[{j0}]", holds=_FRANKA_SENSOR),),
            "q_ref": (Place("state.q_d[{j0}]"),),
            "dq_ref": (Place("state.dq_d[{j0}]"),),
        },
        "libfranka, src/log.cpp and franka::RobotState",
        time={"column": "time", "unit": "ms"},
    ),
    Layout(
        "Franka robot state",
        {
            "q": (
                Place("q[{j0}]"),
                Place("q_{j0}"),
                Place("theta[{j0}]", holds=_FRANKA_MOTOR),
                Place("theta_{j0}", holds=_FRANKA_MOTOR),
            ),
            "dq": (Place("dq[{j0}]"), Place("dq_{j0}")),
            "tau": (
                Place("tau_J[{j0}]", holds=_FRANKA_SENSOR),
                Place("tau_J_{j0}", holds=_FRANKA_SENSOR),
            ),
            "q_ref": (Place("q_d[{j0}]"), Place("q_d_{j0}")),
            "dq_ref": (Place("dq_d[{j0}]"), Place("dq_d_{j0}")),
        },
        "libfranka, franka::RobotState, its fields as columns",
        time="time",
        marks=("tau_J[{j0}]", "tau_J_{j0}"),
        loads=(
            LoadPlace("m_load", "F_x_Cload[{j0}]", ("link8", "flange")),
            LoadPlace("m_load", "F_x_Cload_{j0}", ("link8", "flange")),
        ),
    ),
    Layout(
        "Kinova Kortex, cyclic feedback",
        {
            "q": (Place("position_{j0}", "deg"),),
            "dq": (Place("velocity_{j0}", "deg/s"),),
            "tau": (
                Place("torque_{j0}", holds=_KORTEX_SENSOR),
                Place("current_motor_{j0}", "A", holds=_KORTEX_CURRENT),
            ),
            "temperature": (Place("temperature_motor_{j0}"),),
        },
        "Kinova Kortex API, BaseCyclic ActuatorFeedback",
        time="timestamp",
        marks=("current_motor_{j0}", "temperature_motor_{j0}"),
    ),
    Layout(
        "joint trajectory",
        {
            "q_ref": (Place("positions[{joint}]"),),
            "dq_ref": (Place("velocities[{joint}]"),),
        },
        "docs.ros.org, trajectory_msgs/JointTrajectory",
        kind=JOINT_TRAJECTORY,
    ),
)
"""All known layouts; of several that fit, the first counts."""


def layout_of_kind(kind: str) -> Layout | None:
    """The layout of a type of messages or a format, or ``None`` for one that has none of its own."""
    return next((layout for layout in LAYOUTS if kind and layout.kind == kind), None)


def layout_of(table: Table, kind: str = "") -> Layout | None:
    """The known layout of a table, or ``None``.

    Args:
        table: the columns of the log.
        kind: type of its messages or format, ``LogTable.kind``.
    """
    own = layout_of_kind(kind)
    if own is not None:
        return own
    for layout in LAYOUTS:
        if not layout.kind and layout.fits(table):
            return layout
    return None
