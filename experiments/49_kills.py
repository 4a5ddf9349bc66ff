"""Runs disturbed at random moments, and run again: what is lost, and does anything cut short look whole?

Usage, from the top of the repository; a run that was stopped goes on where it was:

    python experiments/49_kills.py out/kills                       200 disturbances
    python experiments/49_kills.py out/kills --kills 1000 --only diagnose --only train

A disturbance comes at a file operation in the folder of results, drawn at random, or up to 20 ms after it, since most
moments of a run write nothing. Kinds: SIGKILL, SIGINT, a full disk (a small tmpfs if run by root, else a limit on the
size of a file), a folder that turns read-only, a clock set back by a day with files from the future. After each,
every file with a final name has to equal that of an undisturbed run, and running the same command again has to end as
an undisturbed run does. Lines that differ between two undisturbed runs are left out of the comparison.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import kill_files

KINDS = ("SIGKILL", "SIGINT", "full disk", "read-only", "clock")
LIMIT = 900.0
"""A run that takes longer hangs [s]."""
HERE = Path(__file__).resolve().parent
ROOT = os.geteuid() == 0


def arguments() -> argparse.Namespace:
    """Of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", action="append", choices=kill_files.COMMANDS)
    return parser.parse_args()


def run(
    command: list[str], out: Path, size: int | None = None, **disturbance: object
) -> subprocess.CompletedProcess[str]:
    """A command of Gapscope in a process of its own, disturbed as ``kill_hook/sitecustomize.py`` says."""
    own = {f"KILL_{key.upper()}": str(value) for key, value in disturbance.items()}
    path = os.pathsep.join([str(HERE / "kill_hook"), str(HERE.parent)])
    environment = {**os.environ, **own, "KILL_OUT": str(out), "PYTHONPATH": path}
    limit = None
    if size is not None:
        limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
    return subprocess.run(
        [sys.executable, "-m", "gapscope", *command, "--out", str(out)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        preexec_fn=limit,
        check=False,
    )


def reference(name: str, command: list[str], work: Path) -> dict[str, Any]:
    """Two undisturbed runs: their folders, and the number of file operations in the first."""
    folders = [work / "undisturbed" / f"{name} {k}".replace(" ", "_") for k in "ab"]
    count = folders[0].with_suffix(".count")
    count.parent.mkdir(parents=True, exist_ok=True)
    for folder in folders:
        if not folder.with_suffix(".count").is_file():
            shutil.rmtree(folder, ignore_errors=True)
            # results name the folder in which they lie, so that all runs are made in the same
            place = work / "run" / "results"
            shutil.rmtree(place.parent, ignore_errors=True)
            place.parent.mkdir(parents=True)
            counted = place.parent / "count"
            ended = run(command, place, count=counted)
            if ended.returncode:
                raise SystemExit(f"{name}: {ended.stderr}")
            shutil.copytree(place, folder)
            counted.replace(folder.with_suffix(".count"))
    return {"folders": folders, "operations": int(count.read_text())}


def disturb(
    name: str, kind: str, command: list[str], known: dict[str, Any], work: Path,
    rng: random.Random,
) -> dict[str, Any]:  # fmt: skip
    """One disturbance and the run after it: codes, and what was at fault."""
    place = work / "run" / "results"
    shutil.rmtree(place.parent, ignore_errors=True)
    place.parent.mkdir(parents=True)
    at = rng.randint(1, known["operations"])
    delay = rng.choice((0.0, rng.uniform(0.0, 0.02)))
    small = kind == "full disk"
    size = int(rng.uniform(0.0, 1.0) * kill_files.bytes_in(known["folders"][0]))
    try:
        if small and ROOT:
            mount(place.parent, max(size, 8192))
        limit = size if small and not ROOT else None
        told = {} if small else {"at": at, "kind": kind, "delay": delay}
        first = run(command, place, limit, **told)
        set_writable(place)
        cut = kill_files.cut_short(name, place, known["folders"])
        there = set(kill_files.finals(place))
        if small and ROOT:
            subprocess.run(
                ["mount", "-o", "remount,size=1g", str(place.parent)], check=True
            )
        again = run(command, place)
        unlike = kill_files.unlike(place, known["folders"])
        done = name == "record" and first.returncode == 0
        return {
            "command": name,
            "kind": kind,
            "at": at,
            "code": first.returncode,
            "said": first.stderr[-400:],
            "lost": len(set(kill_files.finals(known["folders"][0])) - there),
            "left": kill_files.leftovers(place),
            "faults": [
                *(f"cut short: {file}" for file in cut),
                *(f"traceback: {first.stderr[-600:]}" for _ in "1" if _trace(first)),
                *(f"again: {again.stderr[-600:]}" for _ in "1" if again.returncode and not _whole(name, again)),
                *(f"unlike: {file}" for file in unlike),
                *(["ended well, yet its results are not whole"] if done and unlike else []),
            ],
        }  # fmt: skip
    finally:
        set_writable(place)
        if small and ROOT:
            subprocess.run(["umount", str(place.parent)], check=False)


def _trace(ended: subprocess.CompletedProcess[str]) -> bool:
    return "Traceback" in ended.stderr


def _whole(name: str, again: subprocess.CompletedProcess[str]) -> bool:
    """Whether a run refused since the case is there already, which ``record`` never replaces."""
    return name == "record" and "exists already" in again.stderr


def mount(folder: Path, size: int) -> None:
    """A file system of this many bytes."""
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], check=True
    )


def set_writable(folder: Path) -> None:
    """Undo what turned folders read-only."""
    for path in (folder.parent, folder):
        if path.is_dir():
            if ROOT:
                subprocess.run(["chattr", "-i", path], check=False, capture_output=True)
            path.chmod(0o755)


def table(rows: list[dict[str, Any]]) -> str:
    """A line for each command: disturbances of each kind, files that had to be made again, faults."""
    names = list(dict.fromkeys(row["command"] for row in rows))
    lines = [
        f"| command | {' | '.join(KINDS)} | files made again, mean | cut short | rerun unlike | tracebacks |",
        f"|---|{'---|' * (len(KINDS) + 4)}",
    ]
    for name in [*names, "all"]:
        own = [row for row in rows if name in (row["command"], "all")]
        kinds = Counter(row["kind"] for row in own)
        faults = [fault.split(":")[0] for row in own for fault in set(row["faults"])]
        found = Counter(faults)
        cells = [*(str(kinds[kind]) for kind in KINDS)]
        cells.append(f"{sum(row['lost'] for row in own) / len(own):.1f}")
        cells += [str(found["cut short"]), str(found["unlike"] + found["again"])]
        lines.append(f"| {name} | {' | '.join(cells)} | {found['traceback']} |")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing and print the table."""
    asked = arguments()
    work = asked.out.resolve()
    work.mkdir(parents=True, exist_ok=True)
    commands = kill_files.commands(work / "inputs")
    names = asked.only or list(commands)
    log = work / "kills.jsonl"
    rows = (
        [json.loads(line) for line in log.read_text().splitlines()]
        if log.is_file()
        else []
    )
    done = {row["number"] for row in rows}
    for number in range(asked.kills):
        if number in done:
            continue
        name = names[number % len(names)]
        kind = KINDS[number // len(names) % len(KINDS)]
        known = reference(name, commands[name], work)
        rng = random.Random(f"{asked.seed} {number}")
        row = disturb(name, kind, commands[name], known, work, rng)
        row["number"] = number
        rows.append(row)
        with log.open("a") as file:
            file.write(json.dumps(row) + "\n")
        found = row["faults"] or "nothing lost"
        print(f"{number + 1}: {name}, {kind}, code {row['code']}: {found}", flush=True)
    text = table(rows)
    (work / "kills.md").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    main()
