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
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import zipfile
from collections import Counter
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from common import command_line, kept, markdown

# Inputs of the commands, and how folders of results are compared

URDF_LINK = """<link name="link_{k}"><inertial><origin xyz="0.1 0 0.02"/><mass value="{mass}"/>
<inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint_{k}" type="revolute"><parent link="link_{parent}"/><child link="link_{k}"/><origin xyz="{x} 0 0.1"/>
<axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="3" effort="80"/></joint>"""
EFFECTS = {
    "schema": 1,
    "effects": [
        {
            "effect": "viscous_friction",
            "joints": [2],
            "parameters": {"coefficient": [3.0]},
        }
    ],
}
AGENT = {
    "algorithm": "ppo",
    "steps": 192,
    "round_steps": 64,
    "environments": 1,
    "network": [8],
    "motion": "fourier",
    "motions": ["fourier"],
    "episode_length": 0.4,
    "duration": 0.4,
    "hyperparameters": {"n_steps": 64, "batch_size": 64},
}
NO_CASES = "--singles 0 --pairs 0 --triples 0 --outside 0 --ladder 0"
COMMANDS = {
    "record": "record {robot} --effects {effects} --recordings 2 --duration 5 --rate 100 --seed 3",
    "diagnose": "diagnose {one}",
    "diagnose several": "diagnose {one} {two}",
    "identify": "identify {one}",
    "train": "train nominal --robot {robot} --agent {agent}",
    "evaluate": "evaluate pd nominal --robot {robot} --effects {effects} --engine mujoco --motions fourier "
    "--disturbances none --seeds 2 --duration 1",
    "blind run": "blind run {blind}",
    "fleet": "fleet {cases}",
    "residual": "residual {one}",
}
"""Arguments of each command without ``--out``."""
UNFINISHED = {
    "diagnose several": ("summary.html", "units.json"),
    "blind run": ("frozen.json",),
    "train": ("checkpoints/", "tensorboard/"),
    "evaluate": ("unfinished/",),
}
"""What a command keeps to go on from, what it writes line by line, and summaries, which list cases that failed."""
EVENTS = "tfevents"
"""In the names of TensorBoard's files: one for each process that trained."""
ID = re.compile(r"[0-9a-f]{8,}|\d{9,}")


def commands_of(folder: Path) -> dict[str, list[str]]:
    """Arguments of each command without ``--out``; makes their inputs."""
    place = {x: folder / f"{x}.yaml" for x in ("effects", "agent")}
    place |= {"robot": folder / "robot.urdf", "blind": folder / "blind"}
    place |= {"cases": folder / "cases"}
    place |= {x: folder / "cases" / x for x in ("one", "two")}
    if not (folder / "done").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        place["robot"].write_text(_urdf())
        place["effects"].write_text(yaml.safe_dump(EFFECTS))
        place["agent"].write_text(yaml.safe_dump(AGENT))
        for seed, case in enumerate(("one", "two"), 1):
            if not place[case].is_dir():
                record = COMMANDS["record"].replace("--seed 3", f"--seed {seed}")
                _gapscope(f"{record} --out {{{case}}}", place)
        make = f"blind make --robots small {NO_CASES} --healthy 2 --seed 1"
        _gapscope(f"{make} --out {{blind}}", place)
        # a run refuses to start if it can read the labels, wherever they are
        shutil.rmtree(folder / "blind-labels")
        (folder / "done").touch()
    return {name: _words(command, place) for name, command in COMMANDS.items()}


def _words(command: str, place: dict[str, Path]) -> list[str]:
    return [word.format(**place) for word in command.split()]


def _gapscope(command: str, place: dict[str, Path]) -> None:
    words = _words(command, place)
    subprocess.run([sys.executable, "-m", "gapscope", *words], check=True)


def _urdf() -> str:
    """An arm of three joints."""
    axes = ("0 0 1", "0 1 0", "0 1 0")
    links = [
        URDF_LINK.format(k=k, parent=k - 1, mass=4 - k, axis=axis, x=0.3 * (k > 1))
        for k, axis in enumerate(axes, start=1)
    ]
    return f'<robot name="three"><link name="link_0"/>{"".join(links)}</robot>'


def finals(folder: Path) -> list[str]:
    """Files with a final name, relative to the folder: neither they nor a folder of theirs are hidden."""
    if not folder.is_dir():
        return []
    found = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return sorted(
        path.as_posix() for path in found if not any(p[0] == "." for p in path.parts)
    )


def cut_short(command: str, folder: Path, whole: list[Path]) -> list[str]:
    """Files that cannot be read, or differ from those of undisturbed runs under the same name."""
    known = {_plain(name): name for name in finals(whole[0])}
    wrong = []
    for name in finals(folder):
        grows = name.startswith(UNFINISHED.get(command, ()))
        if EVENTS not in name and not parses(folder / name):
            wrong.append(f"{name} cannot be read")
        elif not grows and _plain(name) in known and not _alike(name, folder, whole):
            wrong.append(f"{name} differs")
    return wrong


def files_unlike(folder: Path, whole: list[Path]) -> list[str]:
    """Files that are missing, too many or different, compared with undisturbed runs."""
    names = {_plain(name): name for name in finals(folder) if EVENTS not in name}
    known = {_plain(name) for name in finals(whole[0]) if EVENTS not in name}
    wrong = [f"{name} is {'missing' if name in known else 'too many'}" for name in known ^ set(names)]  # fmt: skip
    for plain in sorted(known & set(names)):
        if not _alike(names[plain], folder, whole):
            wrong.append(f"{names[plain]} differs")
    return wrong


def _plain(name: str) -> str:
    """A name without what is drawn for each run."""
    return ID.sub("ID", name)


def _alike(name: str, folder: Path, whole: list[Path]) -> bool:
    """Whether a file equals that of undisturbed runs wherever these equal each other."""
    texts = [(folder / name).read_bytes()]
    for other in whole:
        named = [found for found in finals(other) if _plain(found) == _plain(name)]
        if not named:
            return True  # not made by every undisturbed run
        texts.append((other / named[0]).read_bytes())
    mine, first, second = texts
    if first == second:
        return mine == first
    if Path(name).suffix in (".parquet", ".zip", ".npz"):
        return True  # holds stamps, and compressed; it was read
    lines = zip_longest(*(text.splitlines() for text in texts))
    return all(m == a for m, a, b in lines if a == b)


def parses(path: Path) -> bool:
    """Whether a file can be read to its end."""
    content = path.read_bytes()
    try:
        if path.suffix == ".json":
            json.loads(content)
        elif path.suffix == ".jsonl":
            [json.loads(line) for line in content.splitlines()]
        elif path.suffix in (".yaml", ".yml"):
            assert yaml.safe_load(content) is not None
        elif path.suffix == ".npz":
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                [arrays[key] for key in arrays]
        elif path.suffix == ".zip":
            assert zipfile.ZipFile(io.BytesIO(content)).testzip() is None
        elif path.suffix == ".parquet":
            pd.read_parquet(io.BytesIO(content))
        elif path.suffix in (".html", ".urdf"):
            assert content.rstrip().endswith((b"</html>", b"</robot>"))
        return bool(content)
    except Exception:
        # readers raise what they like at a file that is cut short
        return False


# Disturbances

KINDS = ("SIGKILL", "SIGINT", "full disk", "read-only", "clock")
LIMIT = 900.0
"""A run that takes longer hangs [s]."""
HERE = Path(__file__).resolve().parent
ROOT = os.geteuid() == 0


def arguments() -> argparse.Namespace:
    """Of the command line."""
    return command_line(
        __doc__,
        "out",
        kills=200,
        seed=0,
        only={"action": "append", "choices": COMMANDS},
    ).parse_args()


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
    files = [x for x in known["folders"][0].rglob("*") if x.is_file()]
    whole = sum(file.stat().st_size for file in files)
    size = int(rng.uniform(0.0, 1.0) * whole)
    try:
        if small and ROOT:
            mount(place.parent, max(size, 8192))
        limit = size if small and not ROOT else None
        told = {} if small else {"at": at, "kind": kind, "delay": delay}
        first = run(command, place, limit, **told)
        set_writable(place)
        cut = cut_short(name, place, known["folders"])
        there = set(finals(place))
        if small and ROOT:
            subprocess.run(
                ["mount", "-o", "remount,size=1g", str(place.parent)], check=True
            )
        again = run(command, place)
        unlike = files_unlike(place, known["folders"])
        done = name == "record" and first.returncode == 0
        return {
            "command": name,
            "kind": kind,
            "at": at,
            "code": first.returncode,
            "said": first.stderr[-400:],
            "lost": len(set(finals(known["folders"][0])) - there),
            # hidden files and folders at or beside the results
            "left": sorted(path.name for path in place.parent.rglob(".*")),
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
    head = ("command", *KINDS, "files made again, mean", "cut short", "rerun unlike")
    lines = []
    for name in [*names, "all"]:
        own = [row for row in rows if name in (row["command"], "all")]
        kinds = Counter(row["kind"] for row in own)
        faults = [fault.split(":")[0] for row in own for fault in set(row["faults"])]
        found = Counter(faults)
        lost = f"{sum(row['lost'] for row in own) / len(own):.1f}"
        unlike = found["unlike"] + found["again"]
        ends = (lost, found["cut short"], unlike, found["traceback"])
        lines.append([name, *(kinds[kind] for kind in KINDS), *ends])
    return markdown((*head, "tracebacks"), lines)


def main() -> None:
    """Run what is missing and print the table."""
    asked = arguments()
    work = asked.out.resolve()
    work.mkdir(parents=True, exist_ok=True)
    commands = commands_of(work / "inputs")
    names = asked.only or list(commands)
    rows = []
    for number in range(asked.kills):
        name = names[number % len(names)]
        kind = KINDS[number // len(names) % len(KINDS)]
        rng = random.Random(f"{asked.seed} {number}")

        def disturbed(name: str = name, kind: str = kind, rng: Any = rng) -> Any:
            known = reference(name, commands[name], work)
            return disturb(name, kind, commands[name], known, work, rng)

        rows.append(kept(work / "kills" / f"{number:05d}.json", disturbed))
        found = rows[-1]["faults"] or "nothing lost"
        print(f"{name}, {kind}, code {rows[-1]['code']}: {found}", flush=True)
    text = table(rows)
    (work / "kills.md").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    main()
