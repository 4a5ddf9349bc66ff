"""Robots as they come: which of many published robot files load and how far each gets, and effects on their arms.

    .venv/bin/python experiments/34_robots.py files --folder ROBOTS --out out/robots [--only NAME]
    .venv/bin/python experiments/34_robots.py effects --folder ROBOTS --out out/many_arms [--per-arm 4] [--only NAME]

``--folder`` holds robot files (URDF, MJCF, xacro), at any depth; each is one row, named by its file. For the table of
``docs/robots.md`` it held the wheels of ``example-robot-data`` 6.0.0, ``rtb-data`` 2.0.0, ``robosuite`` 1.5.2 and
``robosuite-models`` 1.0.0, unpacked without meshes, and the robots of PyBullet (``pybullet_data``).

The arm of a file is its longest chain of joints, without joints at its tip that move less than 1 % of the mass of the
chain (fingers), and of what is left the last seven joints.

``files``: the number of inertial base parameters; three recordings of 8 s at 200 Hz of the healthy arm and of the arm
with Coulomb friction of 40 % of the scale of its torque on a middle joint, a quarter of that, up to three times, if the
joint does not follow its controller; a diagnosis of both. Injected and explained by the same formula: a recovery check.
A row that exists is not computed again; each robot has its own process with a time limit. ``robots.md`` is the table.

``effects``: of an arm with five joints or more a second one is made, two or three of its joints free and the others
locked at zero: planar arms, arms without a base parameter of some joint, light wrists alone. The first is as its file
says, the second has rotors as well, a fifth of what each joint moves, so that elasticities and backlash can be put into
it. Each arm is recorded healthy and with one effect of the catalogue at a time, ``--per-arm`` of them, which follow
from its name: two recordings of 10 s at 100 Hz. A recovery check too, on arms that no setting was made on. A healthy
recording should be ``no_gap``; the other answers are counted as *exact* (this effect alone), *first* (others beside it,
or a rest that stays), *another* effect, ``unexplained``, and ``no_gap``, which is right for what lies below the floor.
Results that are there are kept.
"""

from __future__ import annotations

import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import command_line, markdown, run_missing, run_part

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.dynamics.description import read_description
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, ModelWarning
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.severity import draw, possible
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.regressor import Regressor

MAX_JOINTS = 7
"""Joints of an arm."""
LIGHT = 0.01
"""Joints at the tip that move less than this share of the mass are no joints of the arm [1]."""
MAX_TRIES = 4
"""Amounts of friction that are tried."""
FILE_PLAN = Plan(recordings=3, duration=8.0, rate=200.0)
STEPS = ("loads", "base", "recorded", "healthy", "found")
ENDINGS = ("*.urdf", "*.xacro", "*.xml")


def arm_of(file: Path) -> NominalArm:
    """The arm of a file: the part of its longest chain that the page's head describes."""
    tree = read_description(file)
    parents = {joint.parent for joint in tree.joints}
    leaves = [joint.child for joint in tree.joints if joint.child not in parents]
    # movable joints on the way from the root to each leaf
    chains = [[j.name for j in tree.upwards(x) if j.moves][::-1] for x in leaves]
    chain = max(chains, key=len, default=[])
    arm = load_nominal_arm(file, joints=chain or None)
    mass = np.abs(RigidBody(arm).inertial_parameters().reshape(-1, 10)[:, 0])
    moved = mass[::-1].cumsum()[::-1]
    heavy = [
        name for name, m in zip(chain, moved, strict=True) if m >= LIGHT * moved[0]
    ]
    return load_nominal_arm(file, joints=heavy[-MAX_JOINTS:])


def recorded(arm: NominalArm, joint: int | None) -> Case:
    """The arm as it is, or with as much friction on a joint (from 1) as its controller can move it against."""
    if joint is None:
        return record_case("case", arm, (), FILE_PLAN, np.random.default_rng(1))
    torque = 0.4 * ArmScale.of(arm).torque[joint - 1]
    for _ in range(MAX_TRIES):
        friction = AppliedEffect("coulomb_friction", (joint,), {"torque": torque})
        case = record_case(
            "case", arm, (friction,), FILE_PLAN, np.random.default_rng(1)
        )
        # the joint moves by half of what its reference does
        moves = (
            np.ptp(r.q, axis=0) > 0.5 * np.ptp(r.q_ref, axis=0) for r in case.recordings
        )
        if all(own[joint - 1] for own in moves):
            break
        torque = torque / 4
    return case


def diagnosed_file(arm: NominalArm, joint: int | None, notes: dict[str, Any]) -> str:
    """The verdict on the arm as it is, ``no gap`` if right, or whether friction on a joint (from 1) is found."""
    case = recorded(arm, joint)
    notes["recorded"] = "yes"
    document = gapscope.diagnose(case).document
    named = [(e["effect"], e["joints"]) for e in document["effects"]]
    said = ", ".join(f"{name} {joints}" for name, joints in named)
    if joint is None:
        right = document["verdict"] == "no_gap"
        return "no gap" if right else said or document["verdict"]
    right = named == [("coulomb_friction", [joint])]
    return "yes" if right else said or document["verdict"]


def row(file: Path) -> dict[str, Any]:
    """How far a robot gets, and the message where it stops."""
    out = {"robot": file.stem}
    try:
        arm = arm_of(file)
        out |= {"joints": arm.n_joints, "slides": sum(arm.sliding), "loads": "yes"}
    except GapscopeError as error:
        return {**out, "loads": _short(error, file)}
    middle, rng = arm.n_joints // 2 + 1, np.random.default_rng(0)
    bodies = Regressor(arm, quantities=())
    steps = {
        "base": lambda: str(structural_base(bodies, rng).count),
        "healthy": lambda: diagnosed_file(arm, None, out),
        "found": lambda: diagnosed_file(arm, middle, out),
    }
    for name, step in steps.items():
        try:
            out[name] = step()
        except GapscopeError as error:
            out[name] = _short(error, file)
    return out


def _short(error: GapscopeError, file: Path) -> str:
    return error.message.replace(str(file), file.name)


def as_table(rows: list[dict[str, Any]]) -> str:
    """The table as Markdown; messages stand below it."""
    head = ("robot", "joints", "slides", *STEPS)
    messages = {}
    table = []
    for each in rows:
        cells = []
        for name in head:
            text = str(each.get(name, "–"))
            if len(text) > 40 and name != "robot":
                messages.setdefault(text, []).append(each["robot"])
                text = f"({list(messages).index(text) + 1})"
            cells.append(text)
        table.append(cells)
    lines = [markdown(head, table), ""]
    for number, text in enumerate(messages, 1):
        lines.append(f"{number}. {' '.join(text.split())}")
    return "\n".join(lines) + "\n"


def files_part() -> None:
    """Compute the missing rows and print the table."""
    args = command_line(
        files_part.__doc__,
        out=Path("out/robots"),
        only=str,
        folder={"type": Path, "required": True},
    ).parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    files = robot_files(args.folder, args.only)
    names = Counter(file.name for file in files)
    rows = {}
    for file in files:
        unique = (
            file.name if names[file.name] == 1 else f"{file.parent.name}_{file.name}"
        )
        rows[args.out / "rows" / f"{unique}.json"] = file

    def failed(file: Path, how: str, seconds: float) -> dict[str, Any]:
        return {"robot": file.stem, "loads": how}

    found = run_missing(row, rows, 1, LIMIT, failed, str)
    named = [{**one, "robot": x.stem} for one, x in zip(found, rows, strict=True)]
    (args.out / "robots.md").write_text(as_table(named), encoding="utf-8")
    print(as_table(named))


def robot_files(folder: Path, only: str | None) -> list[Path]:
    """Robot files below a folder, or those whose name has a text in it."""
    files = {f.resolve() for ending in ENDINGS for f in folder.rglob(ending)}
    return sorted(file for file in files if not only or only in file.name)


# Effects on the arms

PLAN = Plan(recordings=2, duration=10.0, rate=100.0, engine="mujoco")
MIN_JOINTS = 5
"""Arms with fewer joints are taken whole alone."""
ROTORS = 0.2
"""Rotor inertia over the largest own inertia of a joint that is free beside locked ones [1]."""
LIMIT = 240.0
"""Processor time that a robot file, or the diagnosis of an arm, may take [s]."""
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
    arm = arm_of(file)
    if not free:
        return arm
    kept = [arm.joints[j - 1] for j in free]
    locked = {name: 0.0 for name in arm.joints if name not in kept}
    part = load_nominal_arm(file, joints=tuple(kept), locked=locked)
    own = np.diag(RigidBody(part).mass_matrix(np.zeros(part.n_joints)))
    return replace(part, armature=np.maximum(part.armature, ROTORS * own))


def tasks(folder: Path, per_arm: int, only: str | None) -> Iterator[Task]:
    """What is to be done, arm by arm; files without an arm are named and left out."""
    for file in robot_files(folder, only):
        try:
            n = arm_of(file).n_joints
        except GapscopeError as error:
            print(f"{file.stem}: {error.message.splitlines()[0]}", flush=True)
            continue
        rng = np.random.default_rng(zlib.crc32(file.stem.encode()))
        variants = [()]
        if n >= MIN_JOINTS:
            some = rng.choice(n, int(rng.integers(2, 4)), replace=False) + 1
            variants.append(tuple(sorted(some.tolist())))
        for free in variants:
            name = file.stem + "".join(f" {j}" for j in free)
            names = possible(load(file, free))
            drawn = rng.choice(names, min(per_arm, len(names)), replace=False)
            for effect in (HEALTHY, *drawn.tolist()):
                yield Task(name, file, free, effect)


def diagnosed(task: Task) -> dict[str, Any]:
    """Record and diagnose; what came of it."""
    row = {"arm": task.arm, "effect": task.effect}
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
    return row


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
    lines = []
    for effect in sorted({row["effect"] for row in rows}):
        of_it = [counts[effect, each] for each in ANSWERS]
        lines.append([effect, sum(of_it), *of_it])
    return markdown(("effect", "cases", *ANSWERS), lines)


def effects_part() -> None:
    """Do what is missing, list what is not exact, and print the table."""
    args = command_line(
        effects_part.__doc__,
        out=Path("out/many_arms"),
        per_arm=4,
        folder={"type": Path, "required": True},
        only=(str, "files whose name has this"),
    ).parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    every = tasks(args.folder, args.per_arm, args.only)
    files = {
        args.out / "rows" / f"{task.arm} {task.effect}.json": task for task in every
    }

    def failed(task: Task, how: str, seconds: float) -> dict[str, Any]:
        return {"arm": task.arm, "effect": task.effect, "refused": how}

    rows = run_missing(diagnosed, files, 1, LIMIT, failed, answer)
    for row in rows:
        if answer(row) not in ("exact", "no_gap"):
            named = [(e["effect"], e["joints"]) for e in row.get("effects", [])]
            truth = f"{row['effect']} {row.get('joints', '')} {row.get('values', '')}"
            said = row.get("refused") or f"{row['verdict']}, {named}"
            print(f"{row['arm']}: {truth} -> {said}")
    print(table(rows))


if __name__ == "__main__":
    run_part(__doc__, files=files_part, effects=effects_part)
