"""Layouts of known logs: recognised by their columns, and turned into an import section that reads them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

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


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_gives_its_layout(name: str) -> None:
    layout = layout_of(table(*HEADERS[name]))
    assert layout is not None and layout.name == name


def test_a_type_of_messages_gives_its_layout() -> None:
    states = table("t", "position[elbow]", "effort[elbow]")
    layout = layout_of(replace(states, kind=JOINT_STATE))
    assert layout is not None and layout.name == "joint states of ROS"
    # the same columns in a file are no message
    assert layout_of(states) is None
    assert layout_of(table("t", "x", "y")) is None
    # names that everybody uses
    assert layout_of(table("timestamp", "position_0", "torque_0")) is None
    assert layout_of(table("time", "q_0", "tau_0")) is None


def test_the_measured_torque_is_taken_before_the_computed_one() -> None:
    columns = ("timestamp", "actual_q_0", "target_moment_0", "actual_current_0")
    log = table(*columns)
    layout = layout_of(log)
    assert layout is not None
    place = layout.place("tau", log)
    assert place is not None
    assert (place.column, place.unit) == ("actual_current_{j0}", "A")
    without = layout.place("tau", table(*columns[:3]))
    assert without is not None and "no measurement" in without.holds
