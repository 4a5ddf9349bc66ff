"""The command excite: files that fit the limits, what it prints, and messages that say what to change."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import ModelWarning
from gapscope.arm.robots import load_nominal_arm

Command = Callable[..., object]
QUICK = ("--evaluations", 25, "--seed", 1, "--optimiser", "random")


def _columns(path: Path) -> dict[str, np.ndarray]:
    return {name: own.to_numpy() for name, own in pd.read_csv(path).items()}


def test_writes_csv_ros_trajectory_and_plot(gapscope: Command, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "exciting.csv"
    done = gapscope("excite", "kuka_iiwa", "--out", out, "--velocity", 1.0, *QUICK)
    assert done.code == 0, done.err
    names = [out, out.with_suffix(".yaml"), out.with_suffix(".html")]
    slow = out.with_name("exciting_slow.csv")
    names += [slow, slow.with_suffix(".yaml")]
    assert done.out.splitlines()[-5:] == [f"wrote {path}" for path in names]
    assert "_slow first" in done.out and len(list(out.parent.iterdir())) == 5
    for words in ("condition number", "position [rad]", "distance"):
        assert words in done.out

    columns = _columns(out)
    names_of_series = ("q_ref", "dq_ref", "ddq_ref")
    series = [f"{name}{j}" for name in names_of_series for j in range(1, 8)]
    assert list(columns) == ["t", *series]
    assert columns["t"][-1] == pytest.approx(10.0) and len(columns["t"]) == 2501
    low, high = RigidBody(load_nominal_arm("kuka_iiwa")).position_limits()
    for j in range(1, 8):
        q, dq = columns[f"q_ref{j}"], columns[f"dq_ref{j}"]
        assert (q > low[j - 1]).all() and (q < high[j - 1]).all()
        assert np.abs(dq).max() <= 1.0
        slope = np.gradient(q, columns["t"])
        np.testing.assert_allclose(slope[5:-5], dq[5:-5], atol=1e-3)
        assert abs(dq[0]) < 1e-9 and abs(dq[-1]) < 1e-9

    message = yaml.safe_load(names[1].read_text())
    assert message["joint_names"] == [f"lbr_iiwa_joint_{j}" for j in range(1, 8)]
    third = message["points"][0]["positions"][2]
    assert third == pytest.approx(columns["q_ref3"][0], abs=1e-8)

    page = names[2].read_text(encoding="utf-8")
    assert "<script src" not in page
    assert "Plotly" in page and "Exciting trajectory" in page


def test_same_seed_same_trajectory_and_effects_are_reported(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    """From a case, whose URDF has no meshes beside it."""
    asked = ("--effects", "coulomb_friction, load_friction")
    options = ("--no-collisions", "--singular", 0, *asked, *QUICK)
    outs = [tmp_path / f"{name}.csv" for name in "ab"]
    for out in outs:
        done = gapscope("excite", sick, "--out", out, *options)
        assert done.code == 0, done.err
        said = " ".join(done.out.split())
        assert "collisions were not checked" in said
        assert "coulomb_friction and load_friction" in said
    assert outs[0].read_bytes() == outs[1].read_bytes()


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


@pytest.mark.nightly
def test_boxes_that_stand_in_for_missing_shapes_are_said(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    done = gapscope("excite", sick, "--out", tmp_path / "x.csv")
    assert done.code == 0 and "boxes" in done.out + done.err
