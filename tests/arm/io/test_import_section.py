"""Logs in foreign columns, units and on the motor's side; the numbers are worked out by hand."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.import_section import parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

N = 60
A, B, T = np.sin(np.arange(N)), np.cos(np.arange(N)), np.arange(N) / 100


def write(path: Path, **columns: Any) -> Path:
    """A CSV file with these columns."""
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([columns, *zip(*columns.values(), strict=True)])
    return path


def imported(arm: NominalArm, **section: Any) -> Any:
    """An import section for the two-joint arm."""
    return parse_import(section, arm.n_joints, Path("case.yaml"))


Read = Callable[..., Recording]


@pytest.fixture
def read(arm: NominalArm, load: Read) -> Read:
    """A recording from a CSV file of these columns, by default t at 100 Hz and q1, q2, through an import section."""

    def of(section: dict[str, Any] | None = None, **columns: Any) -> Recording:
        given = {"t": T, "q1": A, "q2": B} | columns
        kept = {key: series for key, series in given.items() if series is not None}
        return load(kept, importing=imported(arm, **section) if section else None)

    return of


def both(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.column_stack([first, second])


def test_names_units_signs_and_scale(read: Read) -> None:
    section = {
        "time": {"column": "stamp", "unit": "us"},
        "q": {"column": "P{j0}", "unit": "deg"},
        "tau": {"column": "I_{joint}", "scale": [100, 50], "unit": "mN m"},
        "signs": [1, -1],
        "offsets": [0, 0.5],
    }
    currents = {"I_shoulder": A, "I_elbow": B}
    found = read(section, stamp=np.arange(N) * 4000, P0=90 * A, P1=45 * B, **currents)
    assert found.rate == pytest.approx(250)
    np.testing.assert_allclose(found.q, both(np.pi / 2 * A, 0.5 - np.pi / 4 * B))
    np.testing.assert_allclose(found.tau, both(0.1 * A, -0.05 * B))


COUPLED = {"ratios": [10, 5], "coupling": [{"motor": 2, "joint": 1, "ratio": 2}]}


@pytest.mark.parametrize("transmission", [COUPLED, {"matrix": [[10, 0], [2, 5]]}])
def test_coupled_transmission(transmission: dict[str, Any], read: Read) -> None:
    # Motor 1 turns 10 times for one turn of joint 1; motor 2 turns 2 times for joint 1 and 5 times for joint 2.
    # q1 = m1 / 10, q2 = (m2 - 2 q1) / 5; tau1 = 10 u1 + 2 u2, tau2 = 5 u2.
    motors = {"q1": 10 * A, "q2": 2 * A + 5 * B, "tau1": A, "tau2": B}
    found = read({"transmission": transmission}, **motors)
    np.testing.assert_allclose(found.q, both(A, B), atol=1e-15)
    np.testing.assert_allclose(found.tau, both(10 * A + 2 * B, 5 * B), atol=1e-15)


SIDE_BY_SIDE = {
    "time": {"rate": 200},
    "q": {"column": "J{j}", "file": "position"},
    "tau": {"column": "J{j}", "file": "torque"},
}


def test_files_side_by_side_by_row(arm: NominalArm, tmp_path: Path) -> None:
    position = write(tmp_path / "p.csv", J1=A, J2=B)
    files = {"torque": write(tmp_path / "c.csv", J1=B, J2=A), "position": position}
    section = imported(arm, **SIDE_BY_SIDE)
    recording = load_recording(files, arm, section, complete=True)
    np.testing.assert_array_equal(recording.q, both(A, B))
    np.testing.assert_array_equal(recording.tau, both(B, A))
    assert recording.name == "p.csv" and recording.rate == pytest.approx(200)
    part = load_recording(files, arm, section, rows=(10, 39))
    np.testing.assert_allclose(part.t, np.arange(10, 40) / 200)
    np.testing.assert_array_equal(part.q, both(A, B)[10:40])
    alone = load_recording(position, arm, section)
    assert alone.tau is None and len(alone.t) == N
    short = write(tmp_path / "short.csv", J1=A[:50], J2=B[:50])
    for message, given, complete in (
        ("rows 10 to 60 were asked for, the file has rows 0 to 59", position, False),
        ("short.csv: has 50 rows, p.csv has 60", files | {"torque": short}, False),
        ("the file torque, an entry holds position", {"position": position}, True),
        ("the files torque, but q comes from pos", {"torque": files["torque"]}, False),
    ):
        rows = (10, 60) if message.startswith("rows") else None
        with pytest.raises(InputError, match=message):
            load_recording(given, arm, section, complete=complete, rows=rows)


def beside(arm: NominalArm, join: str, column: str) -> Any:
    """States and commands in files of their own, with times in ms."""
    return imported(
        arm,
        time={"column": "time", "unit": "ms"},
        join=join,
        q={"column": column.format("q"), "file": "state"},
        q_ref={"column": column.format("r"), "file": "command"},
    )


def test_commands_with_their_own_time(arm: NominalArm, tmp_path: Path) -> None:
    t, commands = np.arange(N) * 10.0, [[k / 10, -k / 10] for k in range(N // 2)]
    state = write(tmp_path / "s.csv", time=t, q=both(A, B).tolist())
    command = write(tmp_path / "c.csv", time=t[::2] + 20, r=commands)
    files = {"state": state, "command": command}
    for join, expected in (
        ("hold", [0, 0, 1, 1, 2, 2]),
        ("interpolate", [0, 0.5, 1, 1.5, 2, 2.5]),
    ):
        recording = load_recording(files, arm, beside(arm, join, "{}"))
        # the state before the first command is cut
        assert recording.t[0] == pytest.approx(0.02)
        np.testing.assert_array_equal(recording.q, both(A, B)[2:])
        np.testing.assert_allclose(recording.q_ref[:6, 0], np.array(expected) / 10)
        assert recording.notes == ("rows cut outside the time of the other files: 2",)
    write(command, time=t[::2] + 5000, r=commands)
    with pytest.raises(InputError, match="does not overlap in time with s.csv"):
        load_recording(files, arm, beside(arm, "interpolate", "{}"))


def test_interpolation_adds_no_corners(arm: NominalArm, tmp_path: Path) -> None:
    t = np.arange(N) * 10.0
    slow = t[::4] / 1000
    smooth, stepped = np.sin(10 * slow), np.where(slow < 0.3, 0.0, 1.0)
    files = {
        "state": write(tmp_path / "s.csv", time=t, q1=A, q2=B),
        "command": write(tmp_path / "c.csv", time=t[::4], r1=smooth, r2=stepped),
    }
    found = load_recording(files, arm, beside(arm, "interpolate", "{}{{j}}"))
    assert found.q_ref[:, 1].min() == 0 and found.q_ref[:, 1].max() == 1
    true, straight = np.sin(10 * found.t), np.interp(found.t, slow, smooth)
    error, corners = found.q_ref[8:-8, 0] - true[8:-8], (straight - true)[8:-8]
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(corners**2))


def test_a_count_of_samples_shows_missing_ones(read: Read) -> None:
    count = np.delete(np.arange(N + 10), np.arange(20, 30))
    recording = read({"time": {"column": "n", "rate": 500}}, n=count)
    assert recording.t[-1] == pytest.approx((N + 9) / 500)
    assert recording.notes == ("gaps in time: 1, the longest 0.022 s",)


def test_a_file_in_the_columns_of_the_case_format_is_read_as_such(read: Read) -> None:
    recording = read({"q": {"column": "P{j}", "unit": "deg"}})
    np.testing.assert_array_equal(recording.q, both(A, B))
    assert "in the columns of the case format" in recording.notes[0]


def test_repeated_rows_are_dropped_and_reported(read: Read, load: Read) -> None:
    t, stale = T.copy(), np.arange(N)
    stale[[10, 30, 31]] = [9, 29, 29]
    t[40] = t[39]
    measured = {"q1": A[stale], "q2": B[stale], "tau1": B[stale], "tau2": A[stale]}
    found = read(t=t, **measured)
    np.testing.assert_array_equal(found.q[:, 0], np.delete(A, [10, 30, 31, 40]))
    assert found.notes[:2] == (
        "rows dropped that repeat the time stamp before them: 1",
        "rows dropped that repeat the measurement before them: 3 (5.00%)",
    )
    assert len(load({"t": t} | measured, every_row=True).t) == N
    # an arm that stands still keeps its rows
    still = np.minimum(np.arange(N), 20)
    assert len(read(q1=A[still], q2=B[still], tau1=B[still], tau2=A[still]).t) == N


def test_torque_that_cannot_be_one_is_set_aside(read: Read) -> None:
    """An unsigned one, but not one that gravity holds on one side; and silent channels."""
    unsigned = read(tau1=abs(B), tau2=abs(A))
    said = "torque is unsigned: only commands and positions can be trusted"
    assert unsigned.tau is None and unsigned.notes == (said,)
    held = read(tau1=3 + B, tau2=2 + A)
    assert held.tau is not None and held.notes == ()
    zero = 0 * A
    silent = read(tau1=A, tau2=zero, tau_sensor1=zero, tau_sensor2=zero)
    assert silent.tau is not None and silent.tau_sensor is None
    left_out = "tau_sensor is zero throughout and was left out"
    assert silent.notes == ("tau2 zero throughout", left_out)


def at_fault(ratio: dict[str, Any]) -> dict[str, Any]:
    return {"transmission": ratio}


CURRENT = {"unit": "A", "motor_constant": 0.1, "gear_ratio": 100}
THIRD = [{"motor": 3, "joint": 1, "ratio": 1}]
CONTRADICTIONS = [
    ({"signs": [1]}, "signs", "expected 2 entries, one per joint, got 1"),
    ({"q": None}, "q", "a recording needs positions"),
    ({"time": {"column": "n", "rate": 5, "unit": "ms"}}, "time", "a unit and a rate"),
    (at_fault({"ratios": [1, 0]}), "transmission", "cannot be inverted"),
    (at_fault({"matrix": [[1, 0], [1]]}), "transmission.matrix[2]", "expected 2 entries"),
    (at_fault({"matrix": [[1, 0], [0, 1]], "ratios": [1, 1]}), "transmission", "either matrix, or ratios"),
    (at_fault({"ratio": [1, 1]}), "transmission", "did you mean 'ratios'"),
    (at_fault({}), "transmission", "either matrix, or ratios"),
    (at_fault({"ratios": [1, 1], "coupling": THIRD}), "transmission.coupling[1]", "two different numbers from 1 to 2"),
    ({"rows": {"fit": [5, 2]}}, "rows.fit", "expected [first, last]"),
    ({"tau": {"unit": "A"}}, "tau", "a torque needs the motors' constants"),
    ({"q": ["a"]}, "q", "expected 2 entries"),
    ({"tau": {"unit": "N m", "motor_constant": 0.1}}, "tau", "but no current"),
    ({"tau": {"unit": "A", "motor_constant": [0.1]}}, "tau.motor_constant", "expected 2 entries"),
    ({"tau": CURRENT, "transmission": {"ratios": [100, 100]}}, "tau.gear_ratio", "beside the transmission"),
]  # fmt: skip


@pytest.mark.parametrize(("section", "field", "message"), CONTRADICTIONS)
def test_contradictions(
    section: dict[str, Any], field: str, message: str, arm: NominalArm
) -> None:
    with pytest.raises(InputError) as caught:
        imported(arm, **section)
    text = str(caught.value)
    assert text.startswith(f"case.yaml, field import.{field}: ") and message in text


def test_a_count_that_starts_again_after_a_turn(read: Read, load: Read) -> None:
    smooth, degrees = 0.3 * np.sin(np.arange(N) / 10) - 0.05, {"unit": "deg"}
    around = np.mod(np.rad2deg(smooth), 360)
    found = read({"q": {"column": "q{j}"} | degrees}, q1=around, q2=10 * B)
    np.testing.assert_allclose(found.q[:, 0], smooth, atol=1e-12)
    assert found.notes[0] == "jumps by a turn between two samples taken back: q1"
    # steps of all sizes are no turns
    steps = np.linspace(0.5, 7.5, N)
    other = load({"t": T, "q1": np.cumsum(steps), "q2": B}, any_unit=True)
    np.testing.assert_allclose(np.diff(other.q[:, 0]), steps[1:])


def test_current_by_motor_constant_and_gear_ratio(read: Read) -> None:
    tau = CURRENT | {"column": "i{j0}", "unit": "mA", "motor_constant": [0.1, 0.2]}
    found = read({"tau": tau}, i0=A, i1=B)
    # 0.001 A/mA times 0.1 N m/A times 100
    np.testing.assert_allclose(found.tau, both(0.01 * A, 0.02 * B))


def test_joint_names_of_a_log_stand_for_the_pattern(read: Read) -> None:
    section = {"q": "{joint}", "joints": ["upper", "lower"]}
    found = read(section, q1=None, q2=None, lower=B, upper=A)
    np.testing.assert_array_equal(found.q, both(A, B))
