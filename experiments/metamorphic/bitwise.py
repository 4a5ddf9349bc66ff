"""The same command twice: results bit by bit equal, whatever the hash seed, the threads of the libraries, and --jobs.

Each command runs in a process of its own. Files of both runs are compared byte by byte; of JSON files what names the
program, the folder or the time of a run is left out.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .case_files import CaseFiles

NOT_COMPARED = {
    "made_from": "versions and hashes",
    "seconds": "time of a run",
    "processor_hours": "time of a run",
    "salt": "secret of a sealed set",
}
"""Keys of JSON files that differ by their nature, and what they hold."""
UNREPEATABLE = ("frozen.json", "labels.json", "plan.json", "commitment.json")
"""Files with the time, the salt or the hashes of a run."""
NUMBER = re.compile(r"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
TEXT = (".json", ".yaml", ".csv", ".npz", ".urdf", ".txt")
"""Endings of the files that are compared; reports and the tables of a fleet hold the same numbers once more."""
RUN = re.compile(r"(?<=_r)[0-9a-f]{10}")
"""Number of a run in the folders of a fleet, which is drawn."""


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
    before, after = _parted(cases / "case03", folder)
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
            ("diagnose", after, "--against", before, "--out", "{out}"),
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
                "--motions",
                "fourier",
                "--seeds",
                "1",
                "--duration",
                "2",
                "--out",
                "{out}",
            ),
        ),
    ]


def _parted(case: Path, folder: Path) -> tuple[str, str]:
    """A case with the first recording of another, and one with its second."""
    places = []
    for number, name in enumerate(("before", "after")):
        place = folder / name
        if not place.is_dir():
            files = CaseFiles.read(case)
            content = {
                **files.content,
                "recordings": files.content["recordings"][number : number + 1],
            }
            replace(files, content=content).write(place)
        places.append(str(place))
    return places[0], places[1]


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
        place = RUN.sub("RUN", str(path.relative_to(folder)))
        found[place] = path.read_bytes()
        if path.suffix == ".json":
            text = path.read_text("utf-8").replace(str(folder), "OUT")
            text = RUN.sub("RUN", text)
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
        # what a run ended with is no file
        cells = [f"`gapscope {command.name}`", str(len(first) - 1)]
        for other in others:
            places = sorted(first.keys() | other.keys())
            differing = [p for p in places if first.get(p) != other.get(p)]
            only_digits = all(_alike(first.get(p), other.get(p)) for p in differing)
            names = ", ".join(f"`{p}`" for p in differing[:4])
            said = f"last digits of {names}" if only_digits else f"{names} differ"
            cells.append(said if differing else "same")
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def _alike(one: Any, other: Any) -> bool:
    """Whether two files differ in what rounding does to their numbers alone."""
    numbers, rest = zip(
        *(_taken_apart(content) for content in (one, other)), strict=True
    )
    same_size = len(numbers[0]) == len(numbers[1])
    return (
        same_size and rest[0] == rest[1] and np.allclose(*numbers, rtol=1e-6, atol=1e-8)
    )


def _taken_apart(content: Any) -> tuple[list[float], Any]:
    """The numbers of a file, and the rest of it."""
    if isinstance(content, bytes) and content.startswith(b"PK"):
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in sorted(stored.files)}
        of_numbers = {n: x for n, x in arrays.items() if x.dtype.kind in "if"}
        numbers = [float(v) for x in of_numbers.values() for v in x.ravel()]
        return numbers, {
            n: x.tolist() for n, x in arrays.items() if n not in of_numbers
        }
    text = content if isinstance(content, str) else (content or b"").decode("latin-1")
    return [float(x) for x in NUMBER.findall(text)], NUMBER.sub("#", text)


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
