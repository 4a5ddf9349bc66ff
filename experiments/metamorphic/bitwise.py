"""The same command twice: results bit by bit equal, whatever the hash seed, the threads of the libraries, and --jobs.

Each command runs in a process of its own. Files of both runs are compared byte by byte; of JSON files what names the
program, the folder or the time of a run is left out.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

NOT_COMPARED = {
    "made_from": "versions and hashes",
    "seconds": "time of a run",
    "salt": "secret of a sealed set",
}
"""Keys of JSON files that differ by their nature, and what they hold."""
UNREPEATABLE = ("frozen.json", "labels.json", "plan.json", "commitment.json")
"""Files with the time, the salt or the hashes of a run."""
TEXT = (".json", ".yaml", ".csv", ".npz", ".urdf", ".txt", ".parquet")
"""Endings of the files that are compared; reports hold the same numbers once more."""


BLIND = "--seed 7 --singles 2 --pairs 0 --triples 0 --outside 0 --healthy 1 --ladder 0 --robots small"
"""What ``gapscope blind make`` makes."""


class Variant(NamedTuple):
    """One of the ways to run a command: environment and further options."""

    name: str
    environment: dict[str, str]
    options: tuple[str, ...] = ()


BASE = {"PYTHONHASHSEED": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
TWO_THREADS = {**BASE, "OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
FIRST = Variant("first", BASE)
AGAIN = Variant("again", BASE)
OTHER_HASH = Variant("other hash seed", {**BASE, "PYTHONHASHSEED": "2"})
THREADS = Variant("two threads", TWO_THREADS)


class Command(NamedTuple):
    """A command of ``gapscope`` that is repeated: its arguments, ``{out}`` in them, and whether it takes ``--jobs``."""

    name: str
    arguments: tuple[str, ...]
    jobs: bool = False


def commands(cases: Path, folder: Path) -> list[Command]:
    """The commands, on two cases with three joints."""
    one, other = str(cases / "case03"), str(cases / "case13")
    motion = "--trajectory fourier --recordings 2 --duration 4 --engine mujoco --seed 3"
    effects = folder / "effects.yaml"
    effects.write_text(
        "schema: 1\neffects:\n- {effect: coulomb_friction, joints: [1], parameters: {torque: [2.0]}}\n"
    )
    return [
        Command("diagnose", ("diagnose", one, "--out", "{out}")),
        Command(
            "diagnose, two cases", ("diagnose", one, other, "--out", "{out}"), True
        ),
        Command(
            "diagnose --against",
            ("diagnose", one, "--against", other, "--out", "{out}"),
        ),
        Command("identify", ("identify", one, "--out", "{out}")),
        Command("agree", ("agree", one, "--out", "{out}")),
        Command("fleet", ("fleet", one, other, "--out", "{out}"), True),
        Command(
            "excite",
            (
                "excite",
                one,
                "--seed",
                "1",
                "--evaluations",
                "60",
                "--out",
                "{out}/e.csv",
            ),
        ),
        Command(
            "record",
            (
                "record",
                one,
                "--effects",
                str(effects),
                *motion.split(),
                "--out",
                "{out}/case",
            ),
        ),
        Command(
            "blind make", ("blind", "make", *BLIND.split(), "--out", "{out}/set"), True
        ),
        Command(
            "blind run", ("blind", "run", str(_sealed(folder)), "--out", "{out}"), True
        ),
        Command(
            "evaluate",
            (
                "evaluate",
                "nominal",
                "--robot",
                one,
                "--engine",
                "mujoco",
                "--seeds",
                "1",
                "--duration",
                "2",
                "--out",
                "{out}",
            ),
        ),
    ]


def _sealed(folder: Path) -> Path:
    """A small set of blind cases, whose labels are taken away as the check asks."""
    place = folder / "sealed"
    if not place.is_dir():
        call = [sys.executable, "-m", "gapscope", "blind", "make", *BLIND.split()]
        subprocess.run([*call, "--out", str(place)], check=True)
        shutil.rmtree(folder / "sealed-labels")
    return place


def variants(command: Command) -> Iterator[Variant]:
    """The ways to run a command, the first one being what the others are compared with."""
    if command.jobs:
        yield FIRST._replace(options=("--jobs", "1"))
        yield Variant("--jobs 2", BASE, ("--jobs", "2"))
    else:
        yield FIRST
        yield AGAIN
    yield OTHER_HASH
    yield THREADS


def results(folder: Path) -> dict[str, Any]:
    """What a run wrote: bytes of files by their place, of JSON files the data."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix not in TEXT or path.name in UNREPEATABLE or not path.is_file():
            continue
        place = str(path.relative_to(folder))
        found[place] = path.read_bytes()
        if path.suffix == ".json":
            text = path.read_text("utf-8").replace(str(folder), "OUT")
            found[place] = json.dumps(_comparable(json.loads(text)))
    return found


def _comparable(data: Any) -> Any:
    """JSON data without the keys that differ by their nature."""
    if isinstance(data, dict):
        return {
            key: _comparable(value)
            for key, value in data.items()
            if key not in NOT_COMPARED
        }
    return [_comparable(value) for value in data] if isinstance(data, list) else data


def repeat(cases: Path, out: Path, only: str | None = None) -> str:
    """Run all commands in all ways; a table of which results are bit by bit the same.

    What has been run is kept.
    """
    folder = out / "bitwise"
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        "| command | files | run again, or with `--jobs 2` | other hash seed | two threads |"
    ]
    lines.append("|---|---:|---|---|---|")
    for command in commands(cases, folder):
        if only and only != command.name:
            continue
        found = [_run(command, variant, folder) for variant in variants(command)]
        first, others = found[0], found[1:]
        cells = [f"`gapscope {command.name}`", str(len(first))]
        for other in others:
            places = sorted(first.keys() | other.keys())
            differing = [p for p in places if first.get(p) != other.get(p)]
            cells.append(", ".join(differing[:4]) or "same")
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def _run(command: Command, variant: Variant, folder: Path) -> dict[str, Any]:
    """What one run of a command wrote."""
    name = f"{command.name}_{variant.name}".translate(str.maketrans(" ,", "__"))
    place, done = folder / name, folder / f"{name}.done"
    if not done.is_file():
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        arguments = [text.format(out=place) for text in command.arguments]
        call = [sys.executable, "-m", "gapscope", *arguments, *variant.options]
        with (folder / f"{name}.log").open("w") as log:
            process = subprocess.run(
                call,
                env={**os.environ, **variant.environment},
                stdout=log,
                stderr=log,
                check=False,
            )
        done.write_text(f"{process.returncode}\n")
    return {"exit": done.read_text(), **results(place)}
