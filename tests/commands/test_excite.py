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


def test_writes_csv_ros_trajectory_and_plot(gapscope: Command, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "exciting.csv"
    few = ("--evaluations", 10, *QUICK[2:], "--velocity", 1.0)
    done = gapscope("excite", "kuka_iiwa", "--out", out, *few)
    assert done.code == 0, done.err
    names = [out, out.with_suffix(".yaml"), out.with_suffix(".html")]
    slow = out.with_name("exciting_slow.csv")
    names += [slow, slow.with_suffix(".yaml")]
    assert done.out.splitlines()[-5:] == [f"wrote {path}" for path in names]
    assert "_slow first" in done.out and len(list(out.parent.iterdir())) == 5
    for words in ("condition number", "position [rad]", "distance"):
        assert words in done.out

    table = pd.read_csv(out)
    names_of_series = ("q_ref", "dq_ref", "ddq_ref")
    series = [f"{name}{j}" for name in names_of_series for j in range(1, 8)]
    assert list(table) == ["t", *series]
    t, q, dq, _ = np.split(table.to_numpy(), [1, 8, 15], axis=1)
    assert t[-1] == pytest.approx(10.0) and len(t) == 2501
    low, high = RigidBody(load_nominal_arm("kuka_iiwa")).position_limits()
    assert (q > low).all() and (q < high).all() and np.abs(dq).max() <= 1.0
    slope = np.gradient(q, t[:, 0], axis=0)
    np.testing.assert_allclose(slope[5:-5], dq[5:-5], atol=1e-3)
    np.testing.assert_allclose(dq[[0, -1]], 0.0, atol=1e-9)

    message = yaml.safe_load(names[1].read_text())
    assert message["joint_names"] == [f"lbr_iiwa_joint_{j}" for j in range(1, 8)]
    third = message["points"][0]["positions"][2]
    assert third == pytest.approx(q[0, 2], abs=1e-8)

    page = names[2].read_text(encoding="utf-8")
    assert "<script src" not in page
    assert "Plotly" in page and "Exciting trajectory" in page


def test_same_seed_same_trajectory_and_effects_are_reported(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    """From a case, whose URDF has no meshes beside it; a limit that starves it is warned of."""
    asked = ("--effects", "coulomb_friction, load_friction", "--velocity", 0.01)
    options = ("--no-collisions", "--singular", 0, *asked, *QUICK)
    outs = [tmp_path / f"{name}.csv" for name in "ab"]
    for out in outs:
        with warnings.catch_warnings():
            warnings.simplefilter("always", ModelWarning)
            done = gapscope("excite", sick, "--out", out, *options)
        assert done.code == 0, done.err
        assert "collisions were not checked" in done.said
        assert "coulomb_friction and load_friction" in done.said
        assert "velocity keeps it small; raise --velocity" in done.said
    assert outs[0].read_bytes() == outs[1].read_bytes()


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
