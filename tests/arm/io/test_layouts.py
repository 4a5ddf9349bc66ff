"""Layouts of known logs: recognised by their columns, and turned into an import section that reads them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gapscope.arm.io.formats.rosbag import JOINT_STATE
from gapscope.arm.io.layouts import layout_of
from gapscope.arm.io.table import Table


def table(*columns: str) -> Table:
    """A table of ten rows with these columns."""
    return Table(Path("log.csv"), {name: np.zeros(10) for name in columns}, range(10))


HEADERS = {
    "case format": ("t", "q1", "q2", "tau1", "tau2"),
    "UR, RTDE": ("timestamp", "actual_q_0", "actual_q_1", "actual_current_0"),
    "UR5 degradation, NIST": ("ROBOT_TIME", "ROBOT_ACTUAL_JOINT_POSITIONS (J1)"),
    "libfranka, logToCSV": ("time", "success_rate", "state.q[0]", "state.tau_J[0]"),
    "Franka robot state": ("time", "q_0", "q_1", "tau_J_0"),
    "Kinova Kortex, cyclic feedback": ("timestamp", "position_0", "current_motor_0"),
}


NO_LAYOUTS = (
    # the columns of a message in a file
    ("t", "position[elbow]", "effort[elbow]"),
    ("t", "x", "y"),
    # names that everybody uses
    ("timestamp", "position_0", "torque_0"),
    ("time", "q_0", "tau_0"),
)


def test_a_header_or_a_type_of_messages_gives_its_layout() -> None:
    logs = {name: table(*columns) for name, columns in HEADERS.items()}
    logs["joint states of ROS"] = replace(table(*NO_LAYOUTS[0]), kind=JOINT_STATE)
    for name, log in logs.items():
        assert layout_of(log).name == name
    assert [layout_of(table(*columns)) for columns in NO_LAYOUTS] == [None] * 4


def test_the_measured_torque_is_taken_before_the_computed_one() -> None:
    columns = ("timestamp", "actual_q_0", "target_moment_0", "actual_current_0")
    log = table(*columns)
    layout = layout_of(log)
    place = layout.place("tau", log)
    assert (place.column, place.unit) == ("actual_current_{j0}", "A")
    without = layout.place("tau", table(*columns[:3]))
    assert "no measurement" in without.holds
