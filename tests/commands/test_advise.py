"""The command advise: files, words, and messages that say what to change."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gapscope.arm.motions.trajectory import read_sampled

Command = Callable[..., Any]
QUICK = ("--evaluations", 150, "--seed", 1, "--no-collisions", "--singular", 0)


@pytest.fixture
def advise(gapscope: Command, sick: Path, results: Path, tmp_path: Path) -> Command:
    """Runs ``advise`` on a diagnosis in which friction may be of another law."""
    path = results / "diagnosis.json"
    document = json.loads(path.read_text())
    rival = {"effect": "coulomb_friction", "joints": [2], "probability": 0.3}
    rival["separated_by"] = "another speed"
    document["effects"][0]["alternatives"] = [rival]
    path.write_text(json.dumps(document))

    def call(*options: object, out: str = "x.csv", diagnosis: Path = results) -> Any:
        more = ("--diagnosis", diagnosis, "--out", tmp_path / out)
        return gapscope("advise", sick, *more, *QUICK, *options)

    return call


def test_an_open_question_gets_a_recording(advise: Command, tmp_path: Path) -> None:
    """The same seed finds the same trajectory."""
    done = [advise(out=name) for name in ("a.csv", "b.csv")][-1]
    assert done.code == 0, done.err
    endings = (".csv", ".yaml", ".html", "_slow.csv", "_slow.yaml")
    names = [tmp_path / f"b{ending}" for ending in endings]
    assert done.out.splitlines()[-5:] == [f"wrote {path}" for path in names]
    assert all(path.is_file() for path in names)
    rivals = "viscous friction (joint 2), or Coulomb friction (joint 2)"
    said = " ".join(done.out.split())
    assert f"Still open: {rivals}" in said
    assert "times the floor on the new one" in said
    assert "least margin to each limit" in done.out
    assert read_sampled(names[0], 2).duration >= 10.0
    assert names[0].read_bytes() == (tmp_path / "a.csv").read_bytes()


def test_nothing_open_is_said_and_nothing_written(
    gapscope: Command, healthy: Path, tmp_path: Path
) -> None:
    done = gapscope("advise", healthy, "--out", tmp_path / "next.csv", *QUICK)
    assert done.code == 0 and "Nothing is open" in done.out
    assert not list(tmp_path.glob("next.*"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--payload", -2), ("payload", "kg")),
        (("--payload", 2, "--payload-com", "up"), ("--payload-com", "x,y,z")),
        (("--fastest", 0.1), ("0.25 Hz",)),
        (("--torque", 0.0001), ("allow no trajectory", "gravity")),
        (("--margin", 3.5), ("allow no trajectory", "position")),
    ],
)
def test_bad_options_are_refused_with_a_remedy(
    advise: Command, options: tuple[object, ...], words: tuple[str, ...]
) -> None:
    done = advise(*options)
    assert done.code == 2 and "remedy" in done.err
    assert all(word in done.err for word in words)


def test_bad_files_are_refused_with_a_remedy(advise: Command, tmp_path: Path) -> None:
    for more, word in (
        ({"out": "x.txt"}, ".csv"),
        ({"diagnosis": tmp_path}, "diagnosis.json"),
    ):
        done = advise(**more)
        assert done.code == 2 and word in done.err and "remedy" in done.err
    (tmp_path / "diagnosis.json").write_text('{"schema": 1}')
    done = advise(diagnosis=tmp_path)
    assert done.code == 2 and "required" in done.err
