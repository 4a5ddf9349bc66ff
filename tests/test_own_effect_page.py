"""What ``docs/own_effect.md`` shows works from outside the package, as it stands there."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest
from own_effect_page import blocks, write_example

ROOT = Path(__file__).parents[1]


def gapscope(
    folder: Path, command: str, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run a command line in a folder outside the project."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    run = {"env": {**os.environ, "PYTHONPATH": path, **variables}, "cwd": folder}
    words = [sys.executable, "-m", *shlex.split(command)]
    return subprocess.run(words, text=True, capture_output=True, **run)


def done(folder: Path, command: str, **variables: str) -> str:
    """What a command writes that succeeds."""
    ended = gapscope(folder, command, **variables)
    assert ended.returncode == 0, f"{command}\n{ended.stderr}"
    return ended.stdout


RECORD, *REST = blocks("sh")[0].splitlines() + blocks("sh")[1].splitlines()
"""Commands of the page."""
PREDICT = "gapscope predict arm --recording arm/recording_1.csv --model truth.yaml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recordings of the page, and with a prediction by the effect that they have."""
    folder = tmp_path_factory.mktemp("outside")
    write_example(folder)
    (folder / "truth.yaml").write_text(blocks("yaml")[0])
    done(folder, RECORD)
    done(folder, f"{PREDICT} --out predicted.csv --effects-from cable_drag.py")
    return folder


@pytest.mark.nightly
def test_the_other_commands_of_the_page_find_predict_and_export_the_effect(
    folder: Path,
) -> None:
    said = {command.split()[1]: done(folder, command) for command in REST}
    # the answer that the page shows, however the terminal breaks it; engines differ in the last digits
    shown, answer = (
        re.sub(r"\d+\.\d+", "#", " ".join(text.split()))
        for text in (blocks("text")[0], said["diagnose"])
    )
    assert shown in answer
    document = json.loads((folder / "found/diagnosis.json").read_text())
    (found,) = document["effects"]
    assert (found["effect"], found["joints"]) == ("cable_drag", [2])
    parameters = found["parameters"]
    assert parameters["torque"]["unit"] == "N m"
    assert parameters["torque"]["value"][0] == pytest.approx(6.0, rel=0.02)
    assert parameters["width"]["value"][0] == pytest.approx(0.5, rel=0.02)
    report = unescape((folder / "found/report.html").read_text(encoding="utf-8"))
    for text in ("Cable drag", "c (1 - exp(-(q / w)^2))", "N m", "larger towards"):
        assert text in report
    assert "cable_drag, joint 2" in said["export"]


def test_a_command_without_the_file_says_what_is_missing(folder: Path) -> None:
    ended = gapscope(folder, "gapscope gap arm --model truth.yaml")
    assert ended.returncode == 2
    assert "truth.yaml, effects[0]" in ended.stderr
    assert "did you forget --effects-from" in ended.stderr


def test_several_files_are_given_one_after_the_other(folder: Path) -> None:
    other = blocks("python")[0].replace('"cable_drag"', '"hose_drag"')
    (folder / "hose_drag.py").write_text(other)
    model = (folder / "truth.yaml").read_text()
    entry = model[model.index("  - effect") :].replace("cable_drag", "hose_drag")
    (folder / "two.yaml").write_text(model + entry)
    both = "--effects-from cable_drag.py --effects-from hose_drag.py --out two.csv"
    done(folder, f"{PREDICT.replace('truth', 'two')} {both}")
    assert (folder / "two.csv").read_text() != (folder / "predicted.csv").read_text()


@pytest.mark.nightly
def test_several_cases_are_diagnosed_with_it_in_processes_of_their_own(
    folder: Path,
) -> None:
    options = "--jobs 2 --effects-from cable_drag.py --out both"
    done(folder, f"gapscope diagnose arm arm/case.yaml {options}")
    for name in ("arm", "arm-2"):
        document = json.loads((folder / "both" / name / "diagnosis.json").read_text())
        assert [found["effect"] for found in document["effects"]] == ["cable_drag"]


def package(site: Path, place: str) -> str:
    """A path on which a package lies with what pip leaves of an entry point."""
    about = site / "my_arms-1.2.dist-info"
    about.mkdir(parents=True, exist_ok=True)
    write_example(site)
    version = "Metadata-Version: 2.1\nName: my-arms\nVersion: 1.2\n"
    (about / "METADATA").write_text(version)
    entry = f"[gapscope.effects]\ndrag = {place}\n"
    (about / "entry_points.txt").write_text(entry)
    return os.pathsep.join([str(ROOT), str(site)])


@pytest.mark.parametrize("way", ["variable", "package"])
def test_a_variable_or_an_installed_package_stands_for_the_option(
    folder: Path, tmp_path: Path, way: str
) -> None:
    if way == "variable":
        good, bad = ({"GAPSCOPE_EFFECTS": x} for x in ("cable_drag.py", "none.py"))
        said = "none.py, named in GAPSCOPE_EFFECTS"
    else:
        places = {"one": "cable_drag:CABLE_DRAG", "other": "no_such:X"}
        good, bad = (
            {"PYTHONPATH": package(tmp_path / name, place)}
            for name, place in places.items()
        )
        said = "the effects of the package my-arms cannot be loaded"
    done(folder, f"{PREDICT} --out again.csv", **good)
    again = (folder / "again.csv").read_text()
    assert again == (folder / "predicted.csv").read_text()
    refused = gapscope(folder, f"{PREDICT} --out again.csv", **bad)
    assert refused.returncode == 2 and said in refused.stderr
