"""The command evaluate: files, what it prints, and messages that say what to change."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

Command = Callable[..., object]
QUICK = (
    "--motions",
    "fourier",
    "--seeds",
    1,
    "--duration",
    2.0,
    "--disturbances",
    "none",
)


def test_writes_page_document_and_csv(
    gapscope: Command, sick: Path, corrected: Path, tmp_path: Path
) -> None:
    out = tmp_path / "deep" / "out"
    (sick / "identification.json").write_text(
        json.dumps({"files": {"case": "case.yaml", "effects": "effects.yaml"}}),
        encoding="utf-8",
    )
    shutil.copy(corrected, sick / "effects.yaml")
    models = (
        "pd",
        "nominal",
        f"mine={corrected}",
        f"fitted={sick / 'identification.json'}",
    )
    done = gapscope(
        "evaluate",
        *models,
        "--robot",
        sick,
        "--effects",
        corrected,
        "--out",
        out,
        *QUICK,
    )
    assert done.code == 0, done.err
    files = ["evaluation.html", "evaluation.json", "evaluation.csv"]
    assert done.out.splitlines()[-3:] == [f"wrote {out / name}" for name in files]
    assert sorted(path.name for path in out.iterdir()) == sorted(files)
    assert "mine" in done.out and "rank correlation" in done.out

    content = json.loads((out / "evaluation.json").read_text())
    models = {line["model"]: line for line in content["models"]}
    assert list(models) == ["pd", "nominal", "mine", "fitted"]
    assert (
        models["mine"]["joint_error"]["value"]
        < 0.3 * models["nominal"]["joint_error"]["value"]
    )
    assert models["fitted"]["joint_error"] == models["mine"]["joint_error"]
    assert models["pd"]["diverged"]["count"] == 0 and models["pd"]["margin"] > 4.0
    assert content["effects"][0]["effect"] == "viscous_friction"
    with (out / "evaluation.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert (
        len(rows) == 4 == len(content["episodes"]) and float(rows[0]["joint_error"]) > 0
    )

    page = (out / "evaluation.html").read_text(encoding="utf-8")
    assert (
        "Plotly" in page
        and "<script src" not in page
        and "Tracking of" in page
        and "mine" in page
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nominal", "--motions", "fourie"), "did you mean 'fourier'"),
        (("nominal", "--motions", "pick"), "three joints"),
        (("nominal", "--engine", "unity"), "unity"),
        (("nominal", "--law", "fuzzy"), "fuzzy"),
        (("nominal", "--bandwidth", 0), "above zero"),
        (("missing.yaml",), "missing.yaml"),
        (("missing.json",), "missing.json"),
        (("nominl",), "did you mean 'nominal'"),
        (("pd", "pd"), "two models"),
        (("pd", "--law", "computed", "--motions", "fourier"), "inertia"),
        (("nominal", "--effects", "missing.yaml"), "missing.yaml"),
    ],
)
def test_bad_input_is_told(
    gapscope: Command,
    sick: Path,
    tmp_path: Path,
    arguments: tuple[object, ...],
    message: str,
) -> None:
    done = gapscope("evaluate", *arguments, "--robot", sick, "--out", tmp_path / "out")
    assert done.code == 2 and message in done.err and "Traceback" not in done.err
    assert not (tmp_path / "out" / "evaluation.json").exists()


def test_a_model_of_other_joints_is_told(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    far = tmp_path / "far.yaml"
    far.write_text(
        "schema: 1\neffects:\n  - {effect: coulomb_friction, joints: [7], parameters: {torque: [1.0]}}\n"
    )
    done = gapscope("evaluate", far, "--robot", sick, "--out", tmp_path / "out")
    assert done.code == 2 and "far.yaml" in done.err and "effects[0]" in done.err
    (sick / "identification.json").write_text(
        json.dumps({"files": {"case": "case.yaml", "effects": "x.yaml"}})
    )
    done = gapscope(
        "evaluate",
        sick / "identification.json",
        "--robot",
        "kuka_iiwa",
        "--out",
        tmp_path / "out",
    )
    assert (
        done.code == 2
        and "identification.json" in done.err
        and "yaw, pitch" in done.err
    )
