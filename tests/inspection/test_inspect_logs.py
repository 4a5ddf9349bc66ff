"""Logs in other people's columns: the drafted case reads them as the recording that they were made from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foreign_logs import case_format, columns, inspected

from gapscope.arm.case import load_case
from gapscope.arm.io.log import open_log
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.inspection.inspection import (
    Inspection,
    case_text,
    check_draft,
    inspect_logs,
)
from gapscope.reports.inspection import torque_rows

DEGREES = 180 / np.pi


def degrees_and_milliseconds(r: Recording) -> dict[str, np.ndarray]:
    return {
        "time_ms": 1e3 * r.t + 17,
        **columns("joint_{j}_position", DEGREES * r.q),
        **columns("joint_{j}_velocity", DEGREES * r.dq),
        **columns("joint_{j}_torque", r.tau),
    }


def mixed_units(r: Recording) -> dict[str, np.ndarray]:
    return {
        "Time": r.t,
        **columns("ActualPos{j0}", r.q),
        **columns("ActualVel{j0}", DEGREES * r.dq),
        **columns("MotorTorque{j0}", r.tau),
    }


def counted_rows(r: Recording) -> dict[str, np.ndarray]:
    return {
        "sample": np.arange(len(r.t)),
        **columns("pos ({j})", r.q),
        **columns("vel ({j})", r.dq),
        **columns("eff ({j})", np.zeros_like(r.q)),
        **columns("torque ({j})", r.tau),
    }


def named_joints(r: Recording) -> dict[str, np.ndarray]:
    names = ("a", "b", "c", "d", "e", "f", "wrist_7")
    series = {"pos": r.q, "vel": r.dq, "effort": r.tau}
    found = {"timestamp": 1.7e9 + r.t}
    for kind, values in series.items():
        for j, name in enumerate(names):
            found[f"{name}.{kind}"] = values[:, j]
    return found


def lists_in_cells(r: Recording) -> dict[str, object]:
    series = {"positions": r.q, "velocities": r.dq, "torques": r.tau}
    cells = {name: [str(row.tolist()) for row in x] for name, x in series.items()}
    return {"timestamp": 1e6 * r.t, "kind": ["STATE"] * len(r.t), **cells}


def without_a_word(r: Recording) -> dict[str, np.ndarray]:
    return {
        "ZEIT": r.t,
        **columns("AXIS_ACT_A{j}", DEGREES * r.q),
        **columns("AXIS_VEL_A{j}", DEGREES * r.dq),
        **columns("TORQUE_ACT_A{j}", r.tau),
    }


STYLES: tuple[Callable[[Recording], dict[str, object]], ...] = (
    case_format,
    degrees_and_milliseconds,
    mixed_units,
    counted_rows,
    named_joints,
    lists_in_cells,
    without_a_word,
)


def drafted(found: Inspection, folder: Path) -> Path:
    """The drafted case."""
    file = folder / "case.yaml"
    file.write_text(case_text(found, folder, "kuka_iiwa"), encoding="utf-8")
    return file


@pytest.mark.parametrize("style", STYLES)
def test_the_drafted_case_reads_the_log_as_it_was_made(style, arm, motion, tmp_path):
    found = inspected(tmp_path, arm, log=style(motion))
    read = load_case(drafted(found, tmp_path)).recordings[0]
    np.testing.assert_allclose(read.t - read.t[0], motion.t, atol=1e-6)
    np.testing.assert_allclose(read.q, motion.q, atol=1e-9)
    np.testing.assert_allclose(read.dq, motion.dq, atol=1e-9)
    np.testing.assert_allclose(read.tau, motion.tau, atol=1e-9)


def test_a_time_in_milliseconds_at_1_khz_counts_no_rows(arm, motion, tmp_path):
    table = {**case_format(motion), "t_ms": np.arange(len(motion.t))}
    del table["t"]
    found = inspected(tmp_path, arm, log=table)
    read = load_case(drafted(found, tmp_path)).recordings[0]
    assert read.rate == pytest.approx(1000.0)


def test_files_side_by_side_become_one_recording(arm, motion, tmp_path):
    state = columns("Joint_{j}", motion.q)
    torque = columns("Joint_{j}", motion.tau)
    found = inspected(tmp_path, arm, positions=state, torques=torque)
    assert len(found.entries) == 1
    read = load_case(drafted(found, tmp_path)).recordings[0]
    np.testing.assert_allclose(read.tau, motion.tau, atol=1e-9)
    # nothing tells the rate, and that is said
    assert any("tells the rate" in odd.said for odd in check_draft(found))


def test_torques_of_one_name_in_two_files_are_told_apart(arm, motion, tmp_path):
    torque = columns("tau_{j}", motion.tau)
    time = {"time": motion.t}
    state = time | columns("q_{j}", motion.q) | torque
    wanted = time | columns("q_ref_{j}", motion.q + 0.01) | torque
    found = inspected(tmp_path, arm, state=state, wanted=wanted)
    assert len(found.sources) == 2
    assert [name for name, _ in torque_rows(found)] == [
        "tau_{j} (taken as tau)",
        "tau_{j}",
    ]


def test_logs_of_one_kind_become_recordings(arm, motion, tmp_path):
    table = case_format(motion)
    found = inspected(tmp_path, arm, first=table, second=table)
    assert len(load_case(drafted(found, tmp_path)).recordings) == 2


def test_amperes_wait_for_motor_constants(arm, motion, tmp_path):
    table = {
        "timestamp": motion.t,
        **columns("actual_q_{j0}", motion.q),
        **columns("actual_qd_{j0}", motion.dq),
        **columns("actual_current_{j0}", motion.tau / 12),
    }
    found = inspected(tmp_path, arm, log=table)
    text = case_text(found, tmp_path, "kuka_iiwa")
    assert "unit: A" in text and "tau: null" in text
    assert load_case(drafted(found, tmp_path)).recordings[0].tau is None


def test_a_log_of_fewer_joints_takes_the_first_of_the_robot(arm, motion, tmp_path):
    table = {"t": motion.t, **columns("q{j}", motion.q[:, :4])}
    found = inspected(tmp_path, arm, log=table)
    assert found.arm is not None and found.arm.joints == arm.joints[:4]


@pytest.mark.parametrize(
    ("robot", "layout", "expected"),
    [
        (
            "franka_panda",
            ("time", "q[{j0}]", "tau_J[{j0}]", "m_load", "F_x_Cload[{j0}]"),
            [0.02, 0.0, 0.137],
        ),
        (
            "kuka_iiwa",
            ("timestamp", "actual_q_{j0}", "target_moment_{j0}", "payload", "payload_cog_{j0}"),
            [0.02, 0.0, 0.03],
        ),
    ],
)  # fmt: skip
def test_the_load_that_a_robot_was_told_is_a_known_load(
    robot, layout, expected, motion, tmp_path
):
    time, position, torque, mass, centre = layout
    arm, n = load_nominal_arm(robot), len(motion.t)
    table = {
        time: motion.t,
        **columns(position, motion.q),
        **columns(torque, motion.tau),
        mass: np.full(n, 1.3),
        **columns(centre, np.tile([0.02, 0.0, 0.03], (n, 1))),
    }
    found = inspected(tmp_path, arm, log=table)
    text = case_text(found, tmp_path, str(arm.urdf))
    assert f"told to the robot ({mass}" in text
    (tmp_path / "case.yaml").write_text(text)
    load = load_case(tmp_path, any_unit=True).recordings[0].payload
    assert load is not None and load.mass == 1.3
    np.testing.assert_allclose(load.com, expected, atol=1e-6)


def test_the_position_of_the_motor_waits_beside_that_of_the_joint(
    arm, motion, tmp_path
):
    table = {
        "time": motion.t,
        **columns("q[{j0}]", motion.q),
        **columns("theta[{j0}]", motion.q + 1e-4 * motion.tau),
        **columns("tau_J[{j0}]", motion.tau),
    }
    text = case_text(inspected(tmp_path, arm, log=table), tmp_path, "kuka_iiwa")
    assert 'q: "q[{j0}]"' in text or "q: q[{j0}]" in text
    assert "# q: theta[{j0}]" in text and "encoder: motor" in text


def test_a_vector_of_positions_velocities_and_torques_joint_by_joint(
    arm, motion, tmp_path
):
    """As OpenArm writes ``observation.state`` of a LeRobot dataset."""
    deg, table = 180 / np.pi, {"t": motion.t}
    for j in range(arm.n_joints):
        for field, values in (
            ("pos", deg * motion.q),
            ("vel", deg * motion.dq),
            ("torque", motion.tau),
        ):
            table[f"observation.state[joint_{j + 1}.{field}]"] = values[:, j]
    found = inspected(tmp_path, arm, log=table)
    read = load_case(drafted(found, tmp_path), any_unit=True).recordings[0]
    for name in ("q", "dq", "tau"):
        np.testing.assert_allclose(
            getattr(read, name), getattr(motion, name), atol=1e-6
        )


def test_feetech_servos_keep_the_sign_in_a_bit(arm, motion, tmp_path):
    """Positions in steps, load with its sign in bit 10, speed in bit 15, as the registers hold them."""
    steps = 4096 / (2 * np.pi)
    load, speed = np.round(20 * motion.tau / 11), np.round(steps * motion.dq)
    table = {
        "t": motion.t,
        **columns("present_position{j}", np.round(steps * motion.q + 2048)),
        **columns("present_velocity{j}", np.abs(speed) + 2**15 * (speed < 0)),
        **columns("present_load{j}", np.abs(load) + 2**10 * (load < 0)),
    }
    assert np.abs(load).max() < 2**10
    found = inspected(tmp_path, arm, log=table)
    read = load_case(drafted(found, tmp_path), any_unit=True).recordings[0]
    np.testing.assert_allclose(read.dq, motion.dq, atol=1 / steps)
    np.testing.assert_allclose(read.tau, load)


def test_of_two_arms_in_a_log_it_is_said_which_is_taken(arm, motion, tmp_path):
    table = {"t": motion.t}
    for side, values in (("left", motion.q), ("right", -motion.q)):
        table |= columns(side + "_joint{j}.position", values)
    found = inspected(tmp_path, arm, log=table)
    (said,) = (n.said for n in found.notes if "14 columns, the robot 7" in n.said)
    assert "taken: the first, left_joint1 to left_joint7;" in said
    assert "right_joint1" in said


def test_a_log_without_positions_is_refused(arm, motion, tmp_path):
    with pytest.raises(Exception, match="identifies joint positions"):
        inspected(tmp_path, arm, log={"t": motion.t, **columns("tau{j}", motion.tau)})


def test_a_log_of_one_row_is_refused(motion, tmp_path):
    table = {name: x[:1] for name, x in case_format(motion).items()}
    with pytest.raises(Exception, match="a single row of positions"):
        inspected(tmp_path, None, log=table)


@pytest.mark.parametrize("header", [True, False])
def test_damaged_rows_are_left_out_of_what_is_seen(header, arm, motion, tmp_path):
    table = {
        "time": motion.t,
        **columns("q{j}", motion.q),
        **columns("dq{j}", motion.dq),
        **columns("tau{j}", motion.tau),
    }
    lines = [
        ",".join(f"{x:.9g}" for x in row) for row in zip(*table.values(), strict=True)
    ]
    for row in (7, 300, 301, 900):
        cells = lines[row].split(",")
        cells[row % 20 + 1] = "1e154"
        lines[row] = ",".join(cells)
    lines[500] = lines[500][:40]
    lines[600:640] = [line.split(",")[0] + ",nan" * 21 for line in lines[600:640]]
    file = tmp_path / "log.csv"
    file.write_text("\n".join(([",".join(table)] if header else []) + lines))
    found = inspect_logs([open_log(file)], arm)
    assert set(found.chosen) == {"q", "dq", "tau"}
    read = load_case(drafted(found, tmp_path)).recordings[0]
    assert len(read.t) == len(motion.t) - 45
    kept = np.delete(
        np.arange(len(motion.t)), [7, 300, 301, 500, 900, *range(600, 640)]
    )
    np.testing.assert_allclose(read.tau, motion.tau[kept], atol=1e-6)
    said = " ".join(note.said for note in found.notes)
    assert "rows left out that cannot be read: 5 of 1200" in said
    assert "pauses: 40 of 1200 in 1 block" in said
    assert set(read.notes[:2]) <= {note.said for note in found.notes}
