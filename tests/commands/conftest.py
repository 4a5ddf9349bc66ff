"""A case on disk, and the command line called as a user would."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import cache
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


def run_once(*arguments: object) -> str:
    """What a command that succeeds writes to standard output, for fixtures of more than one test."""
    with redirect_stdout(io.StringIO()) as said, pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert not ended.value.code
    return said.getvalue()


@pytest.fixture(scope="session")
def _results(_cases: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results")
    run_once("diagnose", _cases / "sick", _cases / "healthy", "--out", out)
    return out


class Identified(NamedTuple):
    """What ``identify`` left: its folder, which no test changes, its document, and standard output."""

    out: Path
    document: dict[str, Any]
    said: str


@pytest.fixture(scope="session")
def identified(
    _cases: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Identified]:
    """Identifies ``sick`` or ``healthy``, once."""

    @cache
    def made(name: str) -> Identified:
        out = tmp_path_factory.mktemp(f"{name}_identified")
        said = run_once("identify", _cases / name, "--out", out)
        text = (out / "identification.json").read_text(encoding="utf-8")
        return Identified(out, json.loads(text), said)

    return made


@pytest.fixture
def both_results(_results: Path, tmp_path: Path) -> Path:
    """What ``diagnose sick healthy --out both`` leaves; a copy that may be damaged."""
    return Path(shutil.copytree(_results, tmp_path / "both"))


@pytest.fixture
def results(_results: Path, tmp_path: Path) -> Path:
    """What ``diagnose sick --out results`` leaves; a copy that may be damaged."""
    return Path(shutil.copytree(_results / "sick", tmp_path / "results"))


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
