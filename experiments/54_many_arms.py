"""Effects on many arms, with all joints and with two or three of them: which kind of arm does the search not suit?

    .venv/bin/python experiments/54_many_arms.py --folder ROBOTS --out out/many_arms [--per-arm 4] [--only NAME]

``--folder`` holds robot files as for ``34_robots.py``, whose rule chooses the arm of a file. Of an arm with five joints
or more a second one is made, two or three of its joints free and the others locked at zero: planar arms, arms without a
base parameter of some joint, light wrists alone. The first is as its file says, the second has rotors as well, a fifth
of what each joint moves, so that elasticities and backlash can be put into it.

Each arm is recorded healthy and with one effect of the catalogue at a time, ``--per-arm`` of them, which follow from
its name: two recordings of 10 s at 100 Hz. Injected and explained by the same formulas: a recovery check, on arms that
no setting was made on. A healthy recording should be `no_gap`; the other answers are counted as *exact* (this effect
alone), *first* (others beside it, or a rest that stays), *another* effect, `unexplained`, and `no_gap`, which is right
for what lies below the floor. Results that are there are kept; ``OUT/results.jsonl`` has one line per diagnosis.
"""

from __future__ import annotations

import argparse
import json
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from case_runs import run_tasks

import gapscope
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, ModelWarning
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.severity import draw, possible
from gapscope.envs.recorder import Plan, record_case

robots = import_module("34_robots")

PLAN = Plan(recordings=2, duration=10.0, rate=100.0, engine="mujoco")
LEAST_JOINTS = 5
"""Arms with fewer joints are taken whole alone."""
ROTORS = 0.2
"""Rotor inertia over the largest own inertia of a joint that is free beside locked ones [1]."""
LIMIT = 240.0
"""Processor time that a diagnosis may take [s]."""
HEALTHY = "healthy"
ANSWERS = ("exact", "first", "another", "unexplained", "no_gap", "refused")


class Task(NamedTuple):
    """One diagnosis: an arm by its name, its robot file, its free joints from 1 (none: all), and an effect."""

    arm: str
    file: Path
    free: tuple[int, ...]
    effect: str


def load(file: Path, free: tuple[int, ...]) -> NominalArm:
    """The arm of a file, or that with some joints free alone."""
    arm: NominalArm = robots.arm_of(file)
    if not free:
        return arm
    kept = [arm.joints[j - 1] for j in free]
    locked = {name: 0.0 for name in arm.joints if name not in kept}
    part = load_nominal_arm(file, joints=tuple(kept), locked=locked)
    own = np.diag(RigidBody(part).mass_matrix(np.zeros(part.n_joints)))
    return replace(part, armature=np.maximum(part.armature, ROTORS * own))


def tasks(folder: Path, per_arm: int, only: str | None) -> Iterator[Task]:
    """What is to be done, arm by arm; files without an arm are named and left out."""
    files = {f.resolve() for ending in robots.ENDINGS for f in folder.rglob(ending)}
    for file in sorted(files):
        if only and only not in file.name:
            continue
        try:
            n = robots.arm_of(file).n_joints
        except GapscopeError as error:
            print(f"{file.stem}: {error.message.splitlines()[0]}", flush=True)
            continue
        rng = np.random.default_rng(zlib.crc32(file.stem.encode()))
        variants: list[tuple[int, ...]] = [()]
        if n >= LEAST_JOINTS:
            some = rng.choice(n, int(rng.integers(2, 4)), replace=False) + 1
            variants.append(tuple(sorted(some.tolist())))
        for free in variants:
            name = file.stem + "".join(f" {j}" for j in free)
            names = possible(load(file, free))
            drawn = rng.choice(names, min(per_arm, len(names)), replace=False)
            for effect in (HEALTHY, *drawn.tolist()):
                yield Task(name, file, free, effect)


def diagnosed(task: Task, file: Path) -> None:
    """Record, diagnose, and append what came of it to a file."""
    row: dict[str, Any] = {"arm": task.arm, "effect": task.effect}
    try:
        arm = load(task.file, task.free)
        rng = np.random.default_rng(zlib.crc32(f"{task.arm} {task.effect}".encode()))
        effects = ()
        if task.effect != HEALTHY:
            effects = (draw(task.effect, rng, ArmScale.of(arm)),)
            given = effects[0].parameters
            values = {name: np.asarray(value).tolist() for name, value in given.items()}
            row |= {"joints": effects[0].joints, "values": values}
        case = record_case(task.arm, arm, effects, PLAN, rng)
        document = gapscope.diagnose(case).document
        row |= {key: document[key] for key in ("verdict", "effects", "possible")}
        row["gap"] = document["gap"]["before"]
    except GapscopeError as error:
        row["refused"] = error.message
    _append(row, file)


def _append(row: dict[str, Any], file: Path) -> None:
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(row) + "\n")


def answer(row: dict[str, Any]) -> str:
    """Which of ``ANSWERS`` a diagnosis gave."""
    if "refused" in row:
        return "refused"
    named = [effect["effect"] for effect in row["effects"]]
    if row["effect"] == HEALTHY:
        return "another" if named else str(row["verdict"])
    if not named:
        return str(row["verdict"])
    if named[0] != row["effect"]:
        return "another"
    return "exact" if len(named) == 1 and row["verdict"] != "unexplained" else "first"


def table(rows: list[dict[str, Any]]) -> str:
    """Answers to each effect, as Markdown."""
    counts = Counter((row["effect"], answer(row)) for row in rows)
    lines = ["| effect | cases | " + " | ".join(ANSWERS) + " |"]
    lines.append("|---" * (len(ANSWERS) + 2) + "|")
    for effect in sorted({row["effect"] for row in rows}):
        of_it = [counts[effect, each] for each in ANSWERS]
        lines.append(
            f"| {effect} | {sum(of_it)} | " + " | ".join(map(str, of_it)) + " |"
        )
    return "\n".join(lines)


def main() -> None:
    """Do what is missing, list what is not exact, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path("out/many_arms"))
    parser.add_argument("--per-arm", type=int, default=4)
    parser.add_argument("--only", help="files whose name has this")
    args = parser.parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "results.jsonl"
    read = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    done = {(row["arm"], row["effect"]) for row in map(json.loads, read)}
    every = list(tasks(args.folder, args.per_arm, args.only))
    left = [task for task in every if (task.arm, task.effect) not in done]
    print(f"{len(every)} diagnoses, {len(left)} of them to be made", flush=True)

    def ended(task: Task, how: str, seconds: float) -> None:
        if how != "ended":
            _append({"arm": task.arm, "effect": task.effect, "refused": how}, file)
        print(f"{task.arm}, {task.effect}: {how}, {seconds:.0f} s", flush=True)

    # one at a time: they append to one file
    run_tasks(partial(diagnosed, file=file), left, 1, LIMIT, ended)
    rows = [json.loads(line) for line in file.read_text("utf-8").splitlines()]
    for row in rows:
        if answer(row) not in ("exact", "no_gap"):
            named = [(e["effect"], e["joints"]) for e in row.get("effects", [])]
            truth = f"{row['effect']} {row.get('joints', '')} {row.get('values', '')}"
            said = row.get("refused") or f"{row['verdict']}, {named}"
            print(f"{row['arm']}: {truth} -> {said}")
    print(table(rows))


if __name__ == "__main__":
    main()
