"""The command excite: files that fit the limits, what it prints, and messages that say what to change."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import ModelWarning
from gapscope.arm.robots import load_nominal_arm

Command = Callable[..., object]
QUICK = ("--evaluations", 25, "--seed", 1, "--optimiser", "random")


def _columns(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


def test_writes_csv_ros_trajectory_and_plot(gapscope: Command, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "exciting.csv"
    done = gapscope("excite", "kuka_iiwa", "--out", out, "--velocity", 1.0, *QUICK)
    assert done.code == 0, done.err
    names = [out, out.with_suffix(".yaml"), out.with_suffix(".html")]
    slow = out.with_name("exciting_slow.csv")
    names += [slow, slow.with_suffix(".yaml")]
    assert done.out.splitlines()[-5:] == [f"wrote {path}" for path in names]
    assert "_slow first" in done.out and len(list(out.parent.iterdir())) == 5
    assert (
        "condition number" in done.out
        and "position [rad]" in done.out
        and "distance" in done.out
    )

    columns = _columns(out)
    expected = [
        "t",
        *(f"{name}{j}" for name in ("q_ref", "dq_ref", "ddq_ref") for j in range(1, 8)),
    ]
    assert list(columns) == expected
    assert columns["t"][-1] == pytest.approx(10.0) and len(columns["t"]) == 2501
    low, high = RigidBody(load_nominal_arm("kuka_iiwa")).position_limits()
    for j in range(1, 8):
        q, dq = columns[f"q_ref{j}"], columns[f"dq_ref{j}"]
        assert (
            (q > low[j - 1]).all()
            and (q < high[j - 1]).all()
            and np.abs(dq).max() <= 1.0
        )
        np.testing.assert_allclose(
            np.gradient(q, columns["t"])[5:-5], dq[5:-5], atol=1e-3
        )
        assert abs(dq[0]) < 1e-9 and abs(dq[-1]) < 1e-9

    message = yaml.safe_load(names[1].read_text())
    assert message["joint_names"] == [f"lbr_iiwa_joint_{j}" for j in range(1, 8)]
    assert message["points"][0]["positions"][2] == pytest.approx(
        columns["q_ref3"][0], abs=1e-8
    )

    page = names[2].read_text(encoding="utf-8")
    assert (
        "Plotly" in page and "<script src" not in page and "Exciting trajectory" in page
    )


def test_same_seed_same_trajectory_and_effects_are_reported(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    """From a case, whose URDF has no meshes beside it."""
    options = (
        "--no-collisions",
        "--singular",
        0,
        "--effects",
        "coulomb_friction, load_friction",
        *QUICK,
    )
    outs = [tmp_path / f"{name}.csv" for name in "ab"]
    for out in outs:
        done = gapscope("excite", sick, "--out", out, *options)
        assert done.code == 0, done.err
        said = " ".join(done.out.split())
        assert "collisions were not checked" in said
        assert "coulomb_friction and load_friction" in said
    assert outs[0].read_bytes() == outs[1].read_bytes()


@pytest.mark.parametrize(
    ("robot", "options", "words"),
    [
        ("kuka_iwa", (), ("kuka_iiwa",)),
        ("kuka_iiwa", ("--rate", 4), ("10 times", "5 Hz")),
        ("kuka_iiwa", ("--frequency", 0.01, "--duration", 20), ("period", "100 s")),
        ("kuka_iiwa", ("--kind", "chirp"), ("fourier",)),
        ("kuka_iiwa", ("--order", 0), ("order",)),
        ("kuka_iiwa", ("--criterion", "separation"), ("effects",)),
        ("kuka_iiwa", ("--torque", 0.0001), ("allow no trajectory", "gravity")),
        ("kuka_iiwa", ("--singular", 5), ("allow no trajectory", "singular")),
        ("kuka_iiwa", ("--margin", 2.5), ("allow no trajectory", "position")),
        ("kuka_iiwa", ("--clearance", 2), ("allow no trajectory", "clearance")),
        ("kuka_iiwa", ("--effects", "stiction,payload"), ("stiction",)),
        (
            "kuka_iiwa",
            ("--acceleration", 1e-4, *QUICK),
            ("acceleration keeps it small", "raise --acceleration"),
        ),
        (
            "kuka_iiwa",
            ("--surface", 0.7, *QUICK),
            ("broken most: distance", "lower --surface"),
        ),
        ("kuka_iiwa", ("--surface", 2), ("whole arm lies below", "lower --surface")),
    ],
)
def test_bad_input_is_refused_with_a_remedy(
    gapscope: Command,
    tmp_path: Path,
    robot: str,
    options: tuple[object, ...],
    words: tuple[str, ...],
) -> None:
    done = gapscope("excite", robot, "--out", tmp_path / "x.csv", *options)
    assert done.code == 2 and "remedy" in done.err
    for word in words:
        assert word in done.err
    assert not list(tmp_path.iterdir())


def test_a_starved_trajectory_is_written_with_a_warning(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    options = ("--velocity", 0.01, "--no-collisions", "--singular", 0, *QUICK)
    with warnings.catch_warnings():
        warnings.simplefilter("always", ModelWarning)
        done = gapscope("excite", sick, "--out", tmp_path / "x.csv", *options)
    assert done.code == 0 and (tmp_path / "x.csv").exists()
    assert "velocity keeps it small; raise --velocity" in done.err


def test_help_names_units_and_fits_a_narrow_terminal(
    gapscope: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = gapscope("excite", "--help").out.splitlines()
    text = " ".join(line.strip() for line in lines)
    for unit in ("[Hz]", "[s]", "[rad/s]", "[rad/s^2]", "[rad]", "[m]", "[1]"):
        assert unit in text
    assert max(map(len, lines)) <= 80 and len(lines) < 60


def test_another_ending_is_refused(gapscope: Command, tmp_path: Path) -> None:
    done = gapscope("excite", "kuka_iiwa", "--out", tmp_path / "x.txt")
    assert done.code == 2 and ".csv" in done.err


@pytest.mark.nightly
def test_boxes_that_stand_in_for_missing_shapes_are_said(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    done = gapscope("excite", sick, "--out", tmp_path / "x.csv")
    assert done.code == 0 and "boxes" in done.out + done.err
