"""The command export: the file, what it prints, and messages that say what to change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gapscope.arm.robots import load_nominal_arm

Command = Callable[..., object]


@pytest.mark.parametrize("form", ["urdf", "mjcf", "sdf"])
def test_writes_the_arm_of_a_case(
    gapscope: Command, sick: Path, corrected: Path, tmp_path: Path, form: str
) -> None:
    out = tmp_path / "new" / f"arm.{form}"
    done = gapscope("export", corrected, "--case", sick, "--format", form, "--out", out)
    assert done.code == 0, done.err
    assert done.out.splitlines()[-1] == f"wrote {out}"
    assert ("left out of" in done.out and "armature" in done.out) == (form != "mjcf")
    assert out.is_file() and sorted(p.name for p in out.parent.iterdir()) == [out.name]
    if form == "urdf":
        assert load_nominal_arm(out).viscous == pytest.approx([1.0, 4.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "one of --case and --robot"),
        (("--robot", "kuka_iiwa", "--case", "CASE"), "one of --case and --robot"),
        (("--robot", "kuka_iwa"), "did you mean 'kuka_iiwa'"),
        (("--case", "CASE", "--format", "urd"), "did you mean 'urdf'"),
        (("--case", "missing"), "missing"),
    ],
)
def test_bad_input_is_told(
    gapscope: Command,
    sick: Path,
    corrected: Path,
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    given = [sick if x == "CASE" else x for x in arguments]
    given += [] if "--format" in given else ["--format", "urdf"]
    done = gapscope("export", corrected, *given, "--out", tmp_path / "arm.urdf")
    assert done.code == 2 and message in done.err and "Traceback" not in done.err
    assert not (tmp_path / "arm.urdf").exists()


def test_an_effect_at_fault_is_named_with_its_place(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(
        "schema: 1\neffects:\n  - {effect: coulomb_friction, joints: [1], parameters: {torque: [-9.0]}}\n"
    )
    done = gapscope(
        "export", bad, "--case", sick, "--format", "sdf", "--out", tmp_path / "arm.sdf"
    )
    assert done.code == 2 and "bad.yaml" in done.err and "effects[0]" in done.err


def test_the_nominal_arm_is_not_overwritten(
    gapscope: Command, sick: Path, corrected: Path
) -> None:
    source = next(sick.glob("*.urdf"))
    done = gapscope(
        "export", corrected, "--case", sick, "--format", "urdf", "--out", source
    )
    assert done.code == 2 and "overwritten" in done.err


def test_writes_a_snippet_with_the_friction_of_the_case(
    gapscope: Command, sick: Path, corrected: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mjlab.py"
    done = gapscope(
        "export", corrected, "--case", sick, "--format", "mjlab", "--out", out
    )
    assert done.code == 0, done.err
    assert "viscous_damping=4.0" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--format", "mjlab", "--randomise"), "diagnosis.json"),
        (("--format", "mjlab", "--unit", "other"), "add --randomise"),
        (("--format", "playground"), "ranges alone"),
    ],
)
def test_ranges_that_cannot_be_written_are_told(
    gapscope: Command,
    sick: Path,
    corrected: Path,
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    out = tmp_path / "snippet.py"
    done = gapscope("export", corrected, "--case", sick, *arguments, "--out", out)
    assert done.code == 2 and message in done.err and "Traceback" not in done.err
    assert not out.exists()
