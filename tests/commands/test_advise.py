"""The command advise: files, words, and messages that say what to change."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from gapscope.arm.motions.trajectory import read_sampled

Command = Callable[..., object]
QUICK = ("--evaluations", 150, "--seed", 1, "--no-collisions", "--singular", 0)


def reopen(folder: Path, rival: str) -> None:
    """Puts an alternative to viscous friction into a diagnosis."""
    path = folder / "diagnosis.json"
    document = json.loads(path.read_text())
    document["effects"][0]["alternatives"] = [
        {
            "effect": rival,
            "joints": [2],
            "probability": 0.3,
            "separated_by": "another speed",
        }
    ]
    path.write_text(json.dumps(document))


def test_an_open_question_gets_a_recording(
    gapscope: Command, sick: Path, results: Path, tmp_path: Path
) -> None:
    reopen(results, "coulomb_friction")
    outs = [tmp_path / f"{name}.csv" for name in "ab"]
    for out in outs:
        done = gapscope("advise", sick, "--diagnosis", results, "--out", out, *QUICK)
        assert done.code == 0, done.err
    names = [out, out.with_suffix(".yaml"), out.with_suffix(".html")]
    slow = out.with_name(f"{out.stem}_slow.csv")
    names += [slow, slow.with_suffix(".yaml")]
    assert done.out.splitlines()[-5:] == [f"wrote {path}" for path in names] and all(
        p.is_file() for p in names
    )
    assert (
        "Still open: viscous friction (joint 2), or Coulomb friction (joint 2)"
        in done.out
    )
    assert (
        "times the floor on the new one" in done.out
        and "least margin to each limit" in done.out
    )
    assert read_sampled(out, 2).duration >= 10.0
    assert outs[0].read_bytes() == outs[1].read_bytes(), (
        "the same seed finds the same trajectory"
    )


def test_nothing_open_is_said_and_nothing_written(
    gapscope: Command, healthy: Path, tmp_path: Path
) -> None:
    done = gapscope("advise", healthy, "--out", tmp_path / "next.csv", *QUICK)
    assert (
        done.code == 0
        and "Nothing is open" in done.out
        and not list(tmp_path.glob("next.*"))
    )


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
    gapscope: Command,
    sick: Path,
    results: Path,
    tmp_path: Path,
    options: tuple[object, ...],
    words: tuple[str, ...],
) -> None:
    reopen(results, "coulomb_friction")
    done = gapscope(
        "advise",
        sick,
        "--diagnosis",
        results,
        "--out",
        tmp_path / "x.csv",
        *QUICK,
        *options,
    )
    assert done.code == 2 and "remedy" in done.err
    for word in words:
        assert word in done.err


def test_bad_files_are_refused_with_a_remedy(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    for arguments, word in (
        (("--out", tmp_path / "x.txt"), ".csv"),
        (("--out", tmp_path / "x.csv", "--diagnosis", tmp_path), "diagnosis.json"),
    ):
        done = gapscope("advise", sick, *arguments)
        assert done.code == 2 and word in done.err and "remedy" in done.err
    (tmp_path / "diagnosis.json").write_text('{"schema": 1}')
    done = gapscope(
        "advise", sick, "--out", tmp_path / "x.csv", "--diagnosis", tmp_path
    )
    assert done.code == 2 and "required" in done.err
