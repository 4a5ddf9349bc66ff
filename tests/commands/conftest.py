"""A case on disk, and the command line called as a user would."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from arms import HEAVY, chain
from cases import simulated_case

from gapscope.arm.io.write_case import write_case
from gapscope.cli import main
from gapscope.effects.applied import AppliedEffect

HIDDEN = AppliedEffect("viscous_friction", (2,), {"coefficient": [3.0]})
"""What the arm of ``sick`` has and its data sheet lacks."""


def _make(folder: Path, name: str, effects: tuple[AppliedEffect, ...]) -> Path:
    sheet = {"armature": [0.5, 0.2], "coulomb": [1.5, 1.0], "viscous": [1.0, 1.0]}
    arm = chain(folder, "two", *HEAVY, **sheet)
    case = simulated_case(
        folder,
        name,
        arm,
        effects,
        seed=3,
        frequencies=(0.15, 0.25, 0.35),
        duration=6.0,
        rate=250.0,
        noise=0.05,
    )
    write_case(case, folder / name)
    return folder / name


@pytest.fixture(scope="session")
def _cases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cases")
    _make(folder, "sick", (HIDDEN,))
    _make(folder, "healthy", ())
    return folder


@pytest.fixture
def sick(_cases: Path, tmp_path: Path) -> Path:
    """A case with hidden viscous friction on joint 2; a copy that may be damaged."""
    return Path(shutil.copytree(_cases / "sick", tmp_path / "sick"))


@pytest.fixture
def healthy(_cases: Path, tmp_path: Path) -> Path:
    """A healthy case; a copy that may be damaged."""
    return Path(shutil.copytree(_cases / "healthy", tmp_path / "healthy"))


class Made(NamedTuple):
    """What a command left: its folder, which no test changes, its document, and all that it said."""

    out: Path
    document: dict[str, Any]
    said: str


@pytest.fixture(scope="session")
def _made(
    _cases: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str, str], Made]:
    """Runs a command on a file of ``sick`` or ``healthy``, once."""
    folder = tmp_path_factory.mktemp("made")

    @cache
    def made(command: str, case: str) -> Made:
        out, said = folder / command / Path(case).parts[0], io.StringIO()
        with (
            redirect_stdout(said),
            redirect_stderr(said),
            pytest.raises(SystemExit) as ended,
        ):
            main([command, str(_cases / case), "--out", str(out)])
        assert not ended.value.code
        (file,) = out.glob("*.json")
        return Made(out, json.loads(file.read_text(encoding="utf-8")), said.getvalue())

    return made


@pytest.fixture(scope="session")
def identified(_made: Callable[[str, str], Made]) -> Callable[[str], Made]:
    """Identifies ``sick`` or ``healthy``, once."""
    return partial(_made, "identify")


@pytest.fixture(scope="session")
def diagnosed(_made: Callable[[str, str], Made]) -> Made:
    """The diagnosis of ``sick``."""
    return _made("diagnose", "sick")


@pytest.fixture
def results(diagnosed: Made, tmp_path: Path) -> Path:
    """What ``diagnose sick --out results`` leaves; a copy that may be damaged."""
    return Path(shutil.copytree(diagnosed.out, tmp_path / "results"))


@pytest.fixture
def both_results(
    results: Path, _made: Callable[[str, str], Made], tmp_path: Path
) -> Path:
    """The same beside what ``diagnose healthy/case.yaml`` leaves."""
    healthy = _made("diagnose", "healthy/case.yaml").out
    shutil.copytree(healthy, tmp_path / "both" / "healthy")
    shutil.copytree(results, tmp_path / "both" / "sick")
    return tmp_path / "both"


@pytest.fixture
def open_question(results: Path) -> Path:
    """The same, but friction may be of another law."""
    path = results / "diagnosis.json"
    document = json.loads(path.read_text())
    rival = {"effect": "coulomb_friction", "joints": [2], "probability": 0.3}
    rival["separated_by"] = "another speed"
    document["effects"][0]["alternatives"] = [rival]
    path.write_text(json.dumps(document))
    return results


@pytest.fixture
def corrected(tmp_path: Path) -> Path:
    """A corrected.yaml that tells the truth about ``sick``."""
    path = tmp_path / "corrected.yaml"
    path.write_text(
        "schema: 1\neffects:\n  - {effect: viscous_friction, joints: [2], parameters: {coefficient: [3.0]}}\n"
    )
    return path
