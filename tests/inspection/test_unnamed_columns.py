"""Logs without names of columns: what they hold is told by their values, and the drafted case reads them by number."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from arms import Link
from arms import written as written_arm
from sweeps import nightly
from test_inspect_logs import drafted

from gapscope.arm.case import load_case
from gapscope.arm.io.log import open_log
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.inspection.inspection import (
    Inspection,
    case_text,
    inspect_logs,
    judge_torques,
)


@pytest.fixture(scope="module")
def moved(motion: Recording) -> dict[str, np.ndarray]:
    """The motion with its reference, 15 ms ahead, and encoder noise."""
    rng = np.random.default_rng(1)
    q = motion.q + 2e-5 * rng.standard_normal(motion.q.shape)
    ahead = motion.q + 0.015 * motion.dq
    warm = 30 + 0.2 * motion.t[:, None] + np.arange(motion.n_joints)
    temperature = np.round(2 * warm) / 2
    return {
        "t": motion.t[:, None],
        "q": q,
        "dq": motion.dq + 1e-3 * rng.standard_normal(q.shape),
        "tau": motion.tau,
        "q_ref": ahead,
        "temperature": temperature,
    }


def written(folder: Path, *tables: np.ndarray, delimiter: str = ",") -> list[Path]:
    files = []
    for number, table in enumerate(tables):
        file = folder / f"log{number}.txt"
        np.savetxt(file, table, delimiter=delimiter, fmt="%.9g")
        files.append(file)
    return files


def inspected(files: list[Path], arm: NominalArm | None) -> Inspection:
    return inspect_logs([open_log(file) for file in files], arm)


LAYOUTS = {
    "case format": ("t", "q", "dq", "tau"),
    "torque before velocity": ("t", "q", "tau", "dq"),
    "reference first": ("t", "q_ref", "q", "dq", "tau"),
    "temperature": ("t", "q", "dq", "temperature", "tau"),
    "no time": ("q", "dq", "tau"),
    "no velocity": ("t", "q", "tau"),
    "torque first": ("t", "tau", "q", "dq"),
}


def taken(found: Inspection) -> dict[str, list[int]]:
    """Numbers of the columns that were taken for each channel."""
    return {
        name: [int(number) for number in guess.group.names]
        for name, (_, guess) in found.chosen.items()
    }


def in_a_row(names: Iterable[str]) -> dict[str, list[int]]:
    """Numbers of the columns of blocks of seven joints, and of a time."""
    out, first = {}, 1
    for name in names:
        if name != "t":
            out[name] = list(range(first, first + 7))
        first += 1 if name == "t" else 7
    return out


FORMS = [(layout, known, ",") for layout in LAYOUTS for known in (True, False)]
BY_SPACES = [(layout, known, "  ") for layout, known, _ in FORMS]


@pytest.mark.parametrize(
    ("layout", "known", "delimiter"),
    [*FORMS, BY_SPACES[0], *(nightly(*form) for form in BY_SPACES[1:])],
)
def test_blocks_are_told_by_their_values(
    layout: str,
    known: bool,
    delimiter: str,
    arm: NominalArm,
    moved: dict[str, np.ndarray],
    tmp_path: Path,
) -> None:
    names = LAYOUTS[layout]
    table = np.hstack([moved[name] for name in names])
    files = written(tmp_path, table, delimiter=delimiter)
    found = inspected(files, arm if known else None)
    assert taken(found) == in_a_row(names)
    if known:
        read = load_case(drafted(found, tmp_path)).recordings[0]
        np.testing.assert_allclose(read.q, moved["q"], atol=1e-8)
        np.testing.assert_allclose(read.tau, moved["tau"], atol=1e-6)
        if "dq" in names or "t" in names:
            np.testing.assert_allclose(read.t, moved["t"][:, 0], atol=1e-6)


def test_a_torque_that_follows_its_joint_is_no_arm_of_one_joint(
    arm: NominalArm, moved: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """Viscous friction is all that one joint needs, and no velocity is in the log."""
    tau = moved["tau"].copy()
    tau[:, 4] = 1.7 * moved["dq"][:, 4]
    table = np.hstack([moved["t"], moved["q"], tau])
    found = inspected(written(tmp_path, table), arm)
    assert taken(found) == in_a_row(("t", "q", "tau"))


@pytest.mark.parametrize("known", [True, False])
def test_one_joint_after_the_other(known, arm, moved, tmp_path):
    series = np.stack([moved[name] for name in ("q", "dq", "tau")], axis=2)
    table = np.hstack([moved["t"], series.reshape(len(series), -1)])
    found = inspected(written(tmp_path, table), arm if known else None)
    assert taken(found) == {
        name: list(range(first, first + 21, 3))
        for first, name in enumerate(("q", "dq", "tau"), 2)
    }


def test_joints_that_stand_still_belong_to_their_block(arm, moved, tmp_path):
    q, dq = moved["q"].copy(), moved["dq"].copy()
    q[:, [0, 5, 6]], dq[:, [0, 5, 6]] = 0.2, 0.0
    table = np.hstack([moved["t"], moved["tau"], q, dq])
    found = inspected(written(tmp_path, table), arm)
    assert taken(found)["q"] == list(range(9, 16))


def test_a_torque_that_gravity_explains_is_taken_first(arm, moved, tmp_path):
    other = np.random.default_rng(2).standard_normal(moved["tau"].shape)
    table = np.hstack([moved["t"], moved["q"], moved["dq"], other, moved["tau"]])
    found = judge_torques(inspected(written(tmp_path, table), arm))
    assert taken(found)["tau"][0] == 23


@pytest.mark.parametrize("known", [True, False])
def test_the_time_may_stand_in_another_file(known, arm, moved, tmp_path):
    state = np.hstack([moved["q"], moved["dq"], moved["tau"]])
    files = written(tmp_path, state, moved["t"] + 12.5)
    found = inspected(files, arm if known else None)
    assert found.main.time.rate == pytest.approx(200)
    if known:
        read = load_case(drafted(found, tmp_path)).recordings[0]
        np.testing.assert_allclose(read.t, moved["t"][:, 0], atol=1e-6)
        assert read.begun == pytest.approx(12.5)


def test_columns_of_a_file_with_a_header_may_be_given_by_number(arm, motion, tmp_path):
    names = ["when", *"abcdefg"]
    table = np.column_stack([motion.t, motion.q])
    file = tmp_path / "log.csv"
    np.savetxt(file, table, "%.9g", ",", header=",".join(names), comments="")
    (tmp_path / "case.yaml").write_text(
        "name: numbers\nrobot: kuka_iiwa\nrecordings: [log.csv]\n"
        "import: {time: 1, q: [2, 3, 4, 5, 6, 7, 8], tau: null}\n"
    )
    read = load_case(tmp_path).recordings[0]
    np.testing.assert_allclose(read.q, motion.q, atol=1e-8)


@pytest.mark.parametrize("known", [True, False])
def test_lost_rows_and_noise_of_single_rows_do_not_matter(known, arm, moved, tmp_path):
    names = ("t", "q", "dq", "tau", "q_ref")
    table = np.hstack([moved[name] for name in names])
    table = np.delete(table, np.arange(500, 600), axis=0)
    table[[20, 400], 3] = 1e154
    table[700:760, 1:] = np.nan
    found = inspected(written(tmp_path, table), arm if known else None)
    assert taken(found) == in_a_row(names)


@pytest.fixture
def slide(tmp_path: Path) -> NominalArm:
    """A carriage of 95 kg."""
    carriage = Link(
        *("slide", "carriage", "1 0 0"),
        mass=95,
        com="0 0 0",
        inertia="1 1 1",
        limit="-0.1 0.4 400 1",
        kind="prismatic",
    )
    return load_nominal_arm(written_arm(tmp_path / "slide.urdf", "drive", carriage))


@pytest.mark.parametrize(
    "names", [("t", "qm", "qg", "vir", "pulse"), ("t", "q", "q_ref", "tau", "pulse")]
)
def test_names_that_tell_nothing_are_passed_over(names, slide, tmp_path):
    t = np.arange(0, 20, 0.005)
    rng = np.random.default_rng(3)
    q_ref = 0.1 + 0.1 * np.sin(3 * t) * np.sin(0.4 * t)
    q = q_ref - 0.005 * np.gradient(q_ref, t) + 1e-6 * rng.standard_normal(len(t))
    dq = np.gradient(q_ref, t)
    volts = (95 * np.gradient(dq, t) + 200 * dq + 20 * np.tanh(dq / 1e-3)) / 35
    pulse = np.where(t % 7 < 0.3, 5.0, 0.0)
    log = tmp_path / "drive.csv"
    write_columns(dict(zip(names, (t, q, q_ref, volts, pulse), strict=True)), log)
    found = judge_torques(inspected([log], slide))
    chosen = {name: guess.group.names for name, (_, guess) in found.chosen.items()}
    assert chosen == {"q": (names[1],), "q_ref": (names[2],), "tau": (names[3],)}
    # one joint of another mass or of another unit: the unit is said, to be given by the drive's gain
    (unit,) = (r for r in found.misread if "Torque unit" in r.said)
    factor = float(re.search(r"torque: \{scale: ([0-9.]+)\}", unit.remedy)[1])
    assert factor == pytest.approx(35, rel=0.5)
    case = tmp_path / "case.yaml"
    case.write_text(case_text(found, tmp_path, slide.urdf.name))
    np.testing.assert_allclose(load_case(case).recordings[0].q[:, 0], q, atol=1e-8)
