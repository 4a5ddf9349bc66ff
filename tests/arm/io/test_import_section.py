"""Logs in foreign columns, units and on the motor's side; the numbers are worked out by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.import_section import parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.nominal import NominalArm

N = 60
A, B = np.sin(np.arange(N)), np.cos(np.arange(N))


def write(path: Path, **columns: Any) -> Path:
    """A CSV file with these columns."""
    rows = zip(*columns.values(), strict=True)
    lines = [
        ",".join(columns),
        *(
            ",".join(f'"{x}"' if isinstance(x, list) else repr(float(x)) for x in row)
            for row in rows
        ),
    ]
    path.write_text("\n".join(lines))
    return path


def imported(arm: NominalArm, **section: Any) -> Any:
    """An import section for the two-joint arm."""
    return parse_import(section, arm.n_joints, Path("case.yaml"))


def test_names_units_signs_and_scale(arm: NominalArm, tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.csv",
        stamp=np.arange(N) * 4000,
        P0=90 * A,
        P1=45 * B,
        I_shoulder=A,
        I_elbow=B,
    )
    section = imported(
        arm,
        time={"column": "stamp", "unit": "us"},
        q={"column": "P{j0}", "unit": "deg"},
        tau={"column": "I_{joint}", "scale": [100, 50], "unit": "mN m"},
        signs=[1, -1],
        offsets=[0, 0.5],
    )
    recording = load_recording(path, arm, section, complete=True)
    assert recording.rate == pytest.approx(250)
    np.testing.assert_allclose(
        recording.q, np.column_stack([np.pi / 2 * A, 0.5 - np.pi / 4 * B])
    )
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, np.column_stack([0.1 * A, -0.05 * B]))


@pytest.mark.parametrize(
    "transmission",
    [
        {"ratios": [10, 5], "coupling": [{"motor": 2, "joint": 1, "ratio": 2}]},
        {"matrix": [[10, 0], [2, 5]]},
    ],
)
def test_coupled_transmission(
    transmission: dict[str, Any], arm: NominalArm, tmp_path: Path
) -> None:
    # Motor 1 turns 10 times for one turn of joint 1; motor 2 turns 2 times for joint 1 and 5 times for joint 2.
    # q1 = m1 / 10, q2 = (m2 - 2 q1) / 5; tau1 = 10 u1 + 2 u2, tau2 = 5 u2.
    path = write(
        tmp_path / "a.csv",
        t=np.arange(N) / 100,
        q1=10 * A,
        q2=2 * A + 5 * B,
        tau1=A,
        tau2=B,
    )
    recording = load_recording(path, arm, imported(arm, transmission=transmission))
    np.testing.assert_allclose(recording.q, np.column_stack([A, B]), atol=1e-15)
    assert recording.tau is not None
    np.testing.assert_allclose(
        recording.tau, np.column_stack([10 * A + 2 * B, 5 * B]), atol=1e-15
    )


def test_files_side_by_side_by_row(arm: NominalArm, tmp_path: Path) -> None:
    position = write(tmp_path / "p.csv", J1=A, J2=B)
    torque = write(tmp_path / "c.csv", J1=B, J2=A)
    section = imported(
        arm,
        time={"rate": 200},
        q={"column": "J{j}", "file": "position"},
        tau={"column": "J{j}", "file": "torque"},
    )
    recording = load_recording(
        {"torque": torque, "position": position}, arm, section, complete=True
    )
    np.testing.assert_array_equal(recording.q, np.column_stack([A, B]))
    np.testing.assert_array_equal(recording.tau, np.column_stack([B, A]))
    assert recording.name == "p.csv" and recording.rate == pytest.approx(200)
    part = load_recording(
        {"torque": torque, "position": position}, arm, section, rows=(10, 39)
    )
    np.testing.assert_allclose(part.t, np.arange(10, 40) / 200)
    np.testing.assert_array_equal(part.q, np.column_stack([A, B])[10:40])
    alone = load_recording(position, arm, section)
    assert alone.tau is None and len(alone.t) == N


@pytest.mark.parametrize(
    ("join", "expected"),
    [("hold", [0, 0, 1, 1, 2, 2]), ("interpolate", [0, 0.5, 1, 1.5, 2, 2.5])],
)
def test_commands_with_their_own_time(
    join: str, expected: list[float], arm: NominalArm, tmp_path: Path
) -> None:
    t = np.arange(N) * 10.0
    state = write(
        tmp_path / "s.csv",
        time=t,
        pos=[[float(a), float(b)] for a, b in zip(A, B, strict=True)],
    )
    command = write(
        tmp_path / "c.csv",
        time=t[::2] + 20,
        pos=[[k / 10, -k / 10] for k in range(N // 2)],
    )
    section = imported(
        arm,
        time={"column": "time", "unit": "ms"},
        join=join,
        q={"column": "pos", "file": "state"},
        q_ref={"column": "pos", "file": "command"},
    )
    recording = load_recording({"state": state, "command": command}, arm, section)
    assert recording.t[0] == pytest.approx(0.02), (
        "the state before the first command is cut"
    )
    np.testing.assert_array_equal(recording.q, np.column_stack([A, B])[2:])
    assert recording.q_ref is not None
    np.testing.assert_allclose(recording.q_ref[:6, 0], np.array(expected) / 10)
    assert recording.notes == ("rows cut outside the time of the other files: 2",)


def test_interpolation_adds_no_corners_and_does_not_overshoot(
    arm: NominalArm, tmp_path: Path
) -> None:
    t = np.arange(N) * 10.0
    state = write(tmp_path / "s.csv", time=t, q1=A, q2=B)
    slow = t[::4] / 1000
    smooth, stepped = np.sin(10 * slow), np.where(slow < 0.3, 0.0, 1.0)
    command = write(tmp_path / "c.csv", time=t[::4], r1=smooth, r2=stepped)
    section = imported(
        arm,
        time={"column": "time", "unit": "ms"},
        join="interpolate",
        q={"column": "q{j}", "file": "state"},
        q_ref={"column": "r{j}", "file": "command"},
    )
    recording = load_recording({"state": state, "command": command}, arm, section)
    assert recording.q_ref is not None
    assert recording.q_ref[:, 1].min() == 0 and recording.q_ref[:, 1].max() == 1
    inner = slice(8, -8)
    error = recording.q_ref[inner, 0] - np.sin(10 * recording.t[inner])
    straight = np.interp(recording.t, slow, smooth)[inner]
    straight = straight - np.sin(10 * recording.t[inner])
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(straight**2))


def test_a_count_of_samples_shows_missing_ones(arm: NominalArm, tmp_path: Path) -> None:
    count = np.delete(np.arange(N + 10), np.arange(20, 30))
    path = write(tmp_path / "a.csv", n=count, q1=A, q2=B)
    recording = load_recording(
        path, arm, imported(arm, time={"column": "n", "rate": 500})
    )
    assert recording.t[-1] == pytest.approx((N + 9) / 500)
    assert recording.notes == ("gaps in time: 1, the longest 0.022 s",)


def test_a_file_in_the_columns_of_the_case_format_is_read_as_such(
    arm: NominalArm, tmp_path: Path
) -> None:
    path = write(tmp_path / "a.csv", t=np.arange(N) / 100, q1=A, q2=B)
    recording = load_recording(
        path, arm, imported(arm, q={"column": "P{j}", "unit": "deg"})
    )
    np.testing.assert_array_equal(recording.q, np.column_stack([A, B]))
    assert "in the columns of the case format" in recording.notes[0]


def test_repeated_rows_are_dropped_and_reported(
    arm: NominalArm, tmp_path: Path
) -> None:
    t, stale = np.arange(N) / 100, np.arange(N)
    stale[[10, 30, 31]] = [9, 29, 29]
    t[40] = t[39]
    path = write(
        tmp_path / "a.csv", t=t, q1=A[stale], q2=B[stale], tau1=B[stale], tau2=A[stale]
    )
    recording = load_recording(path, arm)
    np.testing.assert_array_equal(recording.q[:, 0], np.delete(A, [10, 30, 31, 40]))
    assert (
        recording.notes[0] == "rows dropped that repeat the time stamp before them: 1"
    )
    assert (
        recording.notes[1]
        == "rows dropped that repeat the measurement before them: 3 (5.00%)"
    )
    assert len(load_recording(path, arm, every_row=True).t) == N


def test_an_arm_that_stands_still_keeps_its_rows(
    arm: NominalArm, tmp_path: Path
) -> None:
    still = np.minimum(np.arange(N), 20)
    path = write(
        tmp_path / "a.csv",
        t=np.arange(N) / 100,
        q1=A[still],
        q2=B[still],
        tau1=B[still],
        tau2=A[still],
    )
    assert len(load_recording(path, arm).t) == N


def test_unsigned_torque_is_set_aside(arm: NominalArm, tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.csv", t=np.arange(N) / 100, q1=A, q2=B, tau1=abs(B), tau2=abs(A)
    )
    recording = load_recording(path, arm, complete=True)
    assert recording.tau is None
    assert recording.notes == (
        "torque is unsigned: only commands and positions can be trusted",
    )


def test_torque_that_gravity_holds_on_one_side_is_kept(
    arm: NominalArm, tmp_path: Path
) -> None:
    path = write(
        tmp_path / "a.csv", t=np.arange(N) / 100, q1=A, q2=B, tau1=3 + B, tau2=2 + A
    )
    assert load_recording(path, arm).tau is not None


def test_silent_channels(arm: NominalArm, tmp_path: Path) -> None:
    zero = np.zeros(N)
    path = write(
        tmp_path / "a.csv",
        t=np.arange(N) / 100,
        q1=A,
        q2=B,
        tau1=A,
        tau2=zero,
        tau_sensor1=zero,
        tau_sensor2=zero,
    )
    recording = load_recording(path, arm)
    assert recording.tau is not None and recording.tau_sensor is None
    assert recording.notes == (
        "tau2 zero throughout",
        "tau_sensor is zero throughout and was left out",
    )


@pytest.mark.parametrize(
    ("section", "field", "message"),
    [
        ({"signs": [1]}, "import.signs", "expected 2 entries, one per joint, got 1"),
        ({"tau": {"scale": [1, 2, 3]}}, "import.tau.scale", "expected 2 entries"),
        ({"q": None}, "import.q", "a recording needs positions"),
        (
            {"time": {"column": "n", "rate": 5, "unit": "ms"}},
            "import.time",
            "has a unit and a rate",
        ),
        (
            {"transmission": {"ratios": [1, 0]}},
            "import.transmission",
            "cannot be inverted",
        ),
        (
            {"transmission": {"matrix": [[1, 0]]}},
            "import.transmission.matrix",
            "2 by 2",
        ),
        ({"transmission": {}}, "import.transmission", "either matrix, or ratios"),
        (
            {
                "transmission": {
                    "ratios": [1, 1],
                    "coupling": [{"motor": 3, "joint": 1, "ratio": 1}],
                }
            },
            "import.transmission.coupling[1]",
            "two different numbers from 1 to 2",
        ),
        ({"rows": {"fit": [5, 2]}}, "import.rows.fit", "expected [first, last]"),
    ],
)
def test_contradictions(
    section: dict[str, Any], field: str, message: str, arm: NominalArm
) -> None:
    with pytest.raises(InputError) as caught:
        imported(arm, **section)
    assert str(caught.value).startswith(
        f"case.yaml, field {field}: "
    ) and message in str(caught.value)


def test_files_of_different_length(arm: NominalArm, tmp_path: Path) -> None:
    section = imported(
        arm,
        time={"rate": 200},
        q={"column": "J{j}", "file": "position"},
        tau={"column": "J{j}", "file": "torque"},
    )
    files = {
        "position": write(tmp_path / "p.csv", J1=A, J2=B),
        "torque": write(tmp_path / "c.csv", J1=A[:50], J2=B[:50]),
    }
    with pytest.raises(InputError, match="c.csv: has 50 rows, p.csv has 60"):
        load_recording(files, arm, section)
    with pytest.raises(
        InputError, match="comes from the file torque, an entry holds position"
    ):
        load_recording({"position": files["position"]}, arm, section, complete=True)
    with pytest.raises(
        InputError, match="holds the files torque, but q comes from position"
    ):
        load_recording({"torque": files["torque"]}, arm, section)


def test_files_that_do_not_overlap(arm: NominalArm, tmp_path: Path) -> None:
    t = np.arange(N) / 100
    files = {
        "s": write(tmp_path / "s.csv", t=t, q1=A, q2=B),
        "c": write(tmp_path / "c.csv", t=t + 5, r1=A, r2=B),
    }
    section = imported(
        arm, join="interpolate", q={"file": "s"}, q_ref={"column": "r{j}", "file": "c"}
    )
    with pytest.raises(InputError, match="does not overlap in time with s.csv"):
        load_recording(files, arm, section)


def test_rows_that_are_not_there(arm: NominalArm, tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", t=np.arange(N) / 100, q1=A, q2=B)
    with pytest.raises(
        InputError, match="rows 10 to 60 were asked for, the file has rows 0 to 59"
    ):
        load_recording(path, arm, rows=(10, 60))


def test_a_count_that_starts_again_after_a_turn(
    arm: NominalArm, tmp_path: Path
) -> None:
    smooth = 0.3 * np.sin(np.arange(N) / 10) - 0.05
    path = write(
        tmp_path / "a.csv",
        t=np.arange(N) / 100,
        q1=np.mod(np.rad2deg(smooth), 360),
        q2=10 * B,
    )
    recording = load_recording(
        path, arm, imported(arm, q={"column": "q{j}", "unit": "deg"})
    )
    np.testing.assert_allclose(recording.q[:, 0], smooth, atol=1e-12)
    assert recording.notes[0] == "jumps by a turn between two samples taken back: q1"


def test_steps_of_all_sizes_are_no_turns(arm: NominalArm, tmp_path: Path) -> None:
    steps = np.linspace(0.5, 7.5, N)
    path = write(tmp_path / "a.csv", t=np.arange(N) / 100, q1=np.cumsum(steps), q2=B)
    recording = load_recording(path, arm, any_unit=True)
    np.testing.assert_allclose(np.diff(recording.q[:, 0]), steps[1:])


def test_current_by_motor_constant_and_gear_ratio(
    arm: NominalArm, tmp_path: Path
) -> None:
    path = write(tmp_path / "a.csv", t=np.arange(N) / 100, q1=A, q2=B, i0=A, i1=B)
    tau = {
        "column": "i{j0}",
        "unit": "mA",
        "motor_constant": [0.1, 0.2],
        "gear_ratio": 100,
    }
    recording = load_recording(path, arm, imported(arm, tau=tau), complete=True)
    # 0.001 A/mA times 0.1 N m/A times 100
    assert recording.tau is not None
    np.testing.assert_allclose(recording.tau, np.column_stack([0.01 * A, 0.02 * B]))


@pytest.mark.parametrize(
    ("tau", "transmission", "message"),
    [
        ({"unit": "A"}, None, "give motor_constant"),
        ({"unit": "N m", "motor_constant": 0.1}, None, "but no current"),
        (
            {"unit": "A", "motor_constant": [0.1]},
            None,
            "motor_constant: expected 2 entries",
        ),
        (
            {"unit": "A", "motor_constant": 0.1, "gear_ratio": 100},
            {"ratios": [100, 100]},
            "give the ratio in one of them",
        ),
    ],
)
def test_currents_that_cannot_be_torques(
    tau: Any, transmission: Any, message: str, arm: NominalArm
) -> None:
    section = {"tau": tau} | ({"transmission": transmission} if transmission else {})
    with pytest.raises(InputError, match=message):
        imported(arm, **section)


def test_joint_names_of_a_log_stand_for_the_pattern(
    arm: NominalArm, tmp_path: Path
) -> None:
    path = write(tmp_path / "a.csv", t=np.arange(N) / 100, lower=B, upper=A)
    section = imported(arm, q="{joint}", joints=["upper", "lower"])
    np.testing.assert_array_equal(
        load_recording(path, arm, section).q, np.column_stack([A, B])
    )
