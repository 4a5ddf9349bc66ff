"""Mutated inputs for every reader: a million in all, each in a process with bounded memory and a watch on what it does.

Usage, from the top of the repository; a run that was stopped goes on where it was:

    python experiments/48_fuzz.py out/fuzz
    python experiments/48_fuzz.py out/fuzz --reader csv --inputs 5000
    python experiments/48_fuzz.py out/fuzz --reader csv --number 1234          one input, with its traceback
    python experiments/48_fuzz.py out/fuzz --reader case_yaml --atheris 20000  guided by coverage, needs atheris

An input follows from the name of its reader and its number alone. Two ends are accepted: the reader returns, or it
raises a ``GapscopeError`` that names the file. ``OUT/READER.json`` counts both and lists all others: exceptions, hangs,
memory, ends of the process, files written or opened elsewhere, programs or sockets opened, objects unpickled.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import json
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import FunctionType
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fuzz"))

import fuzz_mutations
import fuzz_run
import fuzz_targets

TOTAL = 1_000_000
"""Inputs in all, by default [1]."""
CHUNK = 2000
"""Inputs in one process [1]."""
NOTED = 500
"""Inputs guided by coverage after which the outcome is written [1]."""
STUCK = 900.0
"""A process that stays at one input for so long hangs in a library [s]; a busy machine takes minutes to import."""


def arguments() -> argparse.Namespace:
    """Of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--reader", action="append", choices=fuzz_targets.targets())
    parser.add_argument("--inputs", type=int, help="in all of each reader")
    parser.add_argument("--number", type=int, help="one input, with its traceback")
    parser.add_argument("--atheris", type=int, help="inputs guided by coverage")
    parser.add_argument("--chunk", type=int, nargs=2, help=argparse.SUPPRESS)
    return parser.parse_args()


def chunk(name: str, first: int, last: int, progress: Path) -> dict[str, Any]:
    """Outcome of the inputs ``first`` to ``last`` - 1, in this process."""
    begun = time.process_time()
    with tempfile.TemporaryDirectory(prefix="gapscope_fuzz_") as folder:
        target = fuzz_targets.targets()[name]
        found = fuzz_run.run(target, range(first, last), Path(folder) / "w", progress)
    return {
        "read": found.read,
        "refused": found.refused,
        "faults": found.faults,
        "seconds": time.process_time() - begun,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def run_reader(name: str, total: int, out: Path) -> None:
    """Go on with a reader until it has ``total`` inputs."""
    file, progress = out / f"{name}.json", out / f".{name}.number"
    state = (
        json.loads(file.read_text())
        if file.is_file()
        else {"inputs": 0, "read": 0, "refused": 0, "seconds": 0.0, "peak_mb": 0.0}
        | {"faults": []}
    )
    while state["inputs"] < total:
        first = state["inputs"]
        last = min(first + CHUNK, total)
        progress.write_text(f"{first:012d}")
        call = [sys.executable, __file__, str(out), "--reader", name, "--chunk"]
        ended, found = _watched([*call, str(first), str(last)], progress)
        if found is None:
            # the inputs before the one that ended the process are tried again without it
            last = int(progress.read_text()) + 1
            fault = {"number": last - 1, "what": ended, "where": "process"}
            found = {"faults": [fault], "read": 0, "refused": 0}
            if last - 1 > first:
                _, before = _watched([*call, str(first), str(last - 1)], progress)
                found |= before or {}
                found["faults"] = [*found["faults"], fault]
        for key in ("read", "refused", "seconds"):
            state[key] += found.get(key, 0)
        state["peak_mb"] = max(state["peak_mb"], found.get("peak_mb", 0.0))
        state["faults"] = (state["faults"] + found["faults"])[:500]
        state["inputs"] = last
        aside = file.with_suffix(".aside")
        aside.write_text(json.dumps(state, indent=1))
        aside.replace(file)
        print(f"{name}: {last} inputs, {len(state['faults'])} faults", flush=True)
    progress.unlink(missing_ok=True)


def _watched(call: list[str], progress: Path) -> tuple[str, dict[str, Any] | None]:
    """How a process of a chunk ended, and its outcome; ``None`` if it did not come to its end."""
    process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    seen, since = "", time.monotonic()
    while True:
        try:
            text, _ = process.communicate(timeout=5.0)
            break
        except subprocess.TimeoutExpired:
            number = progress.read_text()
            if number != seen:
                seen, since = number, time.monotonic()
            elif time.monotonic() - since > STUCK:
                process.kill()
                process.communicate()
                return "hangs in a library", None
    if process.returncode:
        return f"ends the process with {process.returncode}", None
    return "", json.loads(text.splitlines()[-1])


def one(name: str, number: int) -> None:
    """Read one input and show what comes of it."""
    target = fuzz_targets.targets()[name]
    with tempfile.TemporaryDirectory(prefix="gapscope_fuzz_") as folder:
        place = Path(folder) / "seeds"
        place.mkdir()
        target.make(place)
        content = (place / target.file).read_bytes()
        changed = fuzz_run.mutated(target, content, number)
        if changed is None:
            print(f"no regular file, kind {number % 6}")
            return
        (place / target.file).write_bytes(changed)
        target.finish(place)
        print(changed[:2000])
        print(target.read(place))


def _is_own(function: FunctionType) -> bool:
    """Whether a function is of the package."""
    return str(function.__module__).split(".")[0] == "gapscope"


def guided(name: str, inputs: int, out: Path) -> None:
    """Inputs that libFuzzer makes from those that reached new lines of the package; those kept lie in ``out``.

    What became of them stands in ``OUT/guided/READER.json``; an input that is a fault is kept beside it.
    """
    import atheris

    target, place = fuzz_targets.targets()[name], out / "guided"
    folder, corpus = place / f"{name}.work" / "input", place / f"{name}.corpus"
    for each in (folder, corpus):
        each.mkdir(parents=True, exist_ok=True)
    target.make(folder)
    (folder.parent / fuzz_mutations.OUTSIDE).write_text("t,q1\n0,0\n")
    (corpus / "seed").write_bytes((folder / target.file).read_bytes())
    # read once, so that all that the reader imports is there; functions of libraries would take minutes
    target.read(folder)
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and _is_own(function):
            atheris.instrument_func(function)
    outcome, watch = fuzz_run.Outcome(), fuzz_run.Watch(folder)
    begun, numbers = time.process_time(), itertools.count(1)

    def read(content: bytes) -> None:
        faults, number = len(outcome.faults), next(numbers)
        (folder / target.file).write_bytes(content)
        with suppress(OSError, ValueError, TypeError, KeyError):
            target.finish(folder)
        fuzz_run.judge(target, number, folder, watch, outcome)
        if len(outcome.faults) > faults:
            (place / f"{name}.{faults}").write_bytes(content)
        if number % NOTED == 0:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            seconds = time.process_time() - begun
            measured = {"inputs": number, "seconds": seconds, "peak_mb": peak}
            text = json.dumps(asdict(outcome) | measured, indent=1)
            (place / f"{name}.json").write_text(text)

    longest = max(20_000, 2 * (folder / target.file).stat().st_size)
    options = [f"-runs={inputs}", f"-max_len={longest}", "-timeout=60"]
    options += ["-rss_limit_mb=4000", f"-artifact_prefix={place}/"]
    atheris.Setup([sys.argv[0], str(corpus), *options], read)
    atheris.Fuzz()


def summary(out: Path) -> str:
    """A line for each reader, and all of them."""
    rows = ["| reader | inputs | read | refused | faults | peak MB | ms each |"]
    rows.append("|---|---:|---:|---:|---:|---:|---:|")
    sums = [0, 0, 0, 0]
    files = [*out.glob("*.json"), *out.glob("guided/*.json")]
    for file in sorted(files, key=lambda file: (file.stem, file.parent != out)):
        state = json.loads(file.read_text())
        counts = [state[key] for key in ("inputs", "read", "refused")]
        counts.append(len(state["faults"]))
        sums = [a + b for a, b in zip(sums, counts, strict=True)]
        each = 1e3 * state["seconds"] / max(state["inputs"], 1)
        guided = file.stem + (", guided" if file.parent != out else "")
        cells = [guided, *map(str, counts), f"{state['peak_mb']:.0f}", f"{each:.1f}"]
        rows.append(f"| {' | '.join(cells)} |")
        for kind, count in fuzz_run.kinds(state["faults"]).most_common(5):
            print(f"{file.stem}: {count} x {kind}")
    rows.append(f"| all | {' | '.join(map(str, sums))} | | |")
    return "\n".join(rows)


def main() -> None:
    """Run what the command line asks for."""
    asked = arguments()
    asked.out.mkdir(parents=True, exist_ok=True)
    names = asked.reader or list(fuzz_targets.targets())
    if asked.chunk:
        first, last = asked.chunk
        progress = asked.out / f".{names[0]}.number"
        print(json.dumps(chunk(names[0], first, last, progress)))
    elif asked.number is not None:
        one(names[0], asked.number)
    elif asked.atheris:
        guided(names[0], asked.atheris, asked.out)
    else:
        total = asked.inputs or -(-TOTAL // len(names))
        # a share at a time of all of them, so that each has been tried when the run is stopped
        for share in range(CHUNK, total + CHUNK, CHUNK):
            for name in names:
                run_reader(name, min(share, total), asked.out)
        print(summary(asked.out))


if __name__ == "__main__":
    main()
