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

# half a minute of commands; what they do with effects from files has tests of its own
pytestmark = pytest.mark.nightly

ROOT = Path(__file__).parents[1]
AGAIN = "gapscope predict arm --recording arm/recording_1.csv --out again.csv --model found/corrected.yaml"


def gapscope(
    folder: Path, command: str, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run a command line in a folder outside the project."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "PYTHONPATH": path, **variables}
    call = [sys.executable, "-m", *shlex.split(command)]
    return subprocess.run(call, cwd=folder, env=env, text=True, capture_output=True)


def run(folder: Path, command: str, **variables: str) -> str:
    """Standard output of a command that succeeds."""
    done = gapscope(folder, command, **variables)
    assert done.returncode == 0, f"{command}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the commands of the page were run."""
    folder = tmp_path_factory.mktemp("outside")
    write_example(folder)
    (folder / "truth.yaml").write_text(blocks("yaml")[0])
    make, use = blocks("sh")[:2]
    for command in [*make.splitlines(), *use.splitlines()]:
        said = run(folder, command)
        (folder / f"{command.split()[1]}.txt").write_text(said)
        if command.startswith("gapscope diagnose"):
            # the answer that the page shows, however the terminal breaks it; engines differ in the last digits
            shown, answer = (
                re.sub(r"\d+\.\d+", "#", " ".join(text.split()))
                for text in (blocks("text")[0], said)
            )
            assert shown in answer
    return folder


def test_the_diagnosis_finds_the_effect_and_its_report_and_an_export_name_it(
    folder: Path,
) -> None:
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
    # an export lists it as left out
    assert "cable_drag, joint 2" in (folder / "export.txt").read_text()


def test_a_command_without_the_file_says_what_is_missing(folder: Path) -> None:
    done = gapscope(folder, "gapscope gap arm --model found/corrected.yaml")
    assert done.returncode == 2
    assert "found/corrected.yaml, effects[0]" in done.stderr
    assert "did you forget --effects-from" in done.stderr


def test_several_files_are_given_one_after_the_other(folder: Path) -> None:
    other = blocks("python")[0].replace('"cable_drag"', '"hose_drag"')
    (folder / "hose_drag.py").write_text(other)
    command = AGAIN.replace(
        "again.csv --model found/corrected.yaml", "two.csv --model two.yaml"
    )
    command += " --effects-from cable_drag.py --effects-from hose_drag.py"
    model = (folder / "found/corrected.yaml").read_text()
    entry = model[model.index("- effect") :]
    other = entry.replace("cable_drag", "hose_drag")
    (folder / "two.yaml").write_text(f"{model}\n{other}")
    run(folder, command)
    assert (folder / "two.csv").read_text() != (folder / "predicted.csv").read_text()


def test_several_cases_are_diagnosed_with_it_in_processes_of_their_own(
    folder: Path,
) -> None:
    how = "--jobs 2 --effects-from cable_drag.py --out both"
    run(folder, f"gapscope diagnose arm arm/case.yaml {how}")
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
        sites = (package(tmp_path / name, place) for name, place in places.items())
        good, bad = ({"PYTHONPATH": site} for site in sites)
        said = "the effects of the package my-arms cannot be loaded"
    run(folder, AGAIN, **good)
    again = (folder / "again.csv").read_text()
    assert again == (folder / "predicted.csv").read_text()
    refused = gapscope(folder, AGAIN, **bad)
    assert refused.returncode == 2 and said in refused.stderr
