"""Mutated inputs for every reader: a million in all, each in a process with bounded memory and a watch on what it does.

Usage, from the top of the repository; a run that was stopped goes on where it was:

    python experiments/48_fuzz.py out/fuzz
    python experiments/48_fuzz.py out/fuzz --reader csv --inputs 5000
    python experiments/48_fuzz.py out/fuzz --reader csv --number 1234          one input, with its traceback

An input follows from the name of its reader and its number alone. Two ends are accepted: the reader returns, or it
raises a ``GapscopeError`` that names the file. ``OUT/READER.json`` counts both and lists all others: exceptions, hangs,
memory, ends of the process, files written or opened elsewhere, programs or sockets opened, objects unpickled.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fuzz"))

import fuzz_run
import fuzz_targets
from common import command_line

TOTAL = 1_000_000
"""Inputs in all, by default [1]."""
CHUNK = 2000
"""Inputs in one process [1]."""
STUCK = 900.0
"""A process that stays at one input for so long hangs in a library [s]; a busy machine takes minutes to import."""


def arguments() -> argparse.Namespace:
    """Of the command line."""
    return command_line(
        __doc__,
        "out",
        reader={"action": "append", "choices": fuzz_targets.targets()},
        inputs=(int, "in all of each reader"),
        number=(int, "one input, with its traceback"),
        chunk={"type": int, "nargs": 2, "help": argparse.SUPPRESS},
    ).parse_args()


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
        target.fill(place)
        content = (place / target.file).read_bytes()
        changed = fuzz_run.mutated(target, content, number)
        if changed is None:
            print(f"no regular file, kind {number % 6}")
            return
        (place / target.file).write_bytes(changed)
        target.finish(place)
        print(changed[:2000])
        print(target.read(place))


def summary(out: Path) -> str:
    """A line for each reader, and all of them."""
    rows = ["| reader | inputs | read | refused | faults | peak MB | ms each |"]
    rows.append("|---|---:|---:|---:|---:|---:|---:|")
    sums = [0, 0, 0, 0]
    for file in sorted(out.glob("*.json")):
        state = json.loads(file.read_text())
        counts = [state[key] for key in ("inputs", "read", "refused")]
        counts.append(len(state["faults"]))
        sums = [a + b for a, b in zip(sums, counts, strict=True)]
        each = 1e3 * state["seconds"] / max(state["inputs"], 1)
        cells = [file.stem, *map(str, counts), f"{state['peak_mb']:.0f}", f"{each:.1f}"]
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
    else:
        total = asked.inputs or -(-TOTAL // len(names))
        # a share at a time of all of them, so that each has been tried when the run is stopped
        for share in range(CHUNK, total + CHUNK, CHUNK):
            for name in names:
                run_reader(name, min(share, total), asked.out)
        print(summary(asked.out))


if __name__ == "__main__":
    main()
