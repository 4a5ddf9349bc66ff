"""Robots as they come: which of many published robot files load, and how far each gets.

    .venv/bin/python experiments/34_robots.py --folder ROBOTS --out out/robots [--only NAME] [--quick]

`--folder` holds robot files (URDF, MJCF, xacro), at any depth; each is one row, named by its file. For the table of
`docs/robots.md` it held the wheels of `example-robot-data` 6.0.0, `rtb-data` 2.0.0, `robosuite` 1.5.2 and
`robosuite-models` 1.0.0, unpacked without meshes, and the robots of PyBullet (`pybullet_data`).

The arm of a file is its longest chain of joints, without joints at its tip that move less than 1 % of the mass of the
chain (fingers), and of what is left the last seven joints. Then: the number of inertial base parameters; an exciting
trajectory of 8 s within the limits, collisions unchecked; three recordings of 8 s at 200 Hz of the healthy arm and of
the arm with Coulomb friction of 40 % of the scale of its torque on a middle joint, a quarter of that, up to three
times, if the joint does not follow its controller; a diagnosis of both. Injected and explained by the same formula,
this is a recovery check. A row that exists is not computed again; each robot has its own process with a time limit.
With `--quick` robots without a row end after their base parameters. `robots.json` and `robots.md` hold the table.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.robot_file import tree_of
from gapscope.arm.dynamics.tree.kinematic_tree import KinematicTree
from gapscope.arm.errors import GapscopeError, ModelWarning
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.excitation.excitation_plan import ExcitationPlan, LimitPlan
from gapscope.ident.excitation.trajectory_search import Budget
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.regressor import Regressor

MOST_JOINTS = 7
"""Joints of an arm."""
LIGHT = 0.01
"""Joints at the tip that move less than this share of the mass are no joints of the arm [1]."""
LIMIT = 240.0
"""Time that a robot may take [s]."""
MOST_TRIES = 4
"""Amounts of friction that are tried."""
PLAN = Plan(recordings=3, duration=8.0, rate=200.0)
STEPS = ("loads", "base", "excited", "recorded", "healthy", "found")
ENDINGS = ("*.urdf", "*.xacro", "*.xml")


def longest_chain(tree: KinematicTree) -> tuple[str, ...]:
    """Movable joints on the way from the root to the leaf that has most of them above it."""
    parents = {joint.parent for joint in tree.joints}
    leaves = [joint.child for joint in tree.joints if joint.child not in parents]
    chains = [
        tuple(joint.name for joint in tree.upwards(leaf) if joint.moves)[::-1]
        for leaf in leaves
    ]
    return max(chains, key=len, default=())


def arm_of(file: Path) -> NominalArm:
    """The arm of a file: the part of its longest chain that the page's head describes."""
    chain = longest_chain(tree_of(file))
    arm = load_nominal_arm(file, joints=chain or None)
    mass = np.abs(RigidBody(arm).inertial_parameters().reshape(-1, 10)[:, 0])
    moved = mass[::-1].cumsum()[::-1]
    heavy = [
        name for name, m in zip(chain, moved, strict=True) if m >= LIGHT * moved[0]
    ]
    return load_nominal_arm(file, joints=heavy[-MOST_JOINTS:])


def excited(arm: NominalArm) -> str:
    """Condition number of an exciting trajectory."""
    plan = ExcitationPlan(duration=8.0, frequency=0.125, budget=Budget(evaluations=300))
    limits = LimitPlan(collisions=False, singular=0.0)
    found = gapscope.excite(arm, plan, limits, seed=0).excitation
    return f"{found.condition:.3g}"


def recorded(arm: NominalArm, joint: int | None) -> Case:
    """The arm as it is, or with as much friction on a joint (from 1) as its controller can move it against."""
    if joint is None:
        return record_case("case", arm, (), PLAN, np.random.default_rng(1))
    torque = 0.4 * ArmScale.of(arm).torque[joint - 1]
    for _ in range(MOST_TRIES):
        friction = AppliedEffect("coulomb_friction", (joint,), {"torque": torque})
        case = record_case("case", arm, (friction,), PLAN, np.random.default_rng(1))
        if all(_follows(recording, joint - 1) for recording in case.recordings):
            break
        torque = torque / 4
    return case


def _follows(recording: Recording, j: int) -> bool:
    """Whether a joint, from 0, moves by half of what its reference does."""
    assert recording.q_ref is not None
    return bool(np.ptp(recording.q[:, j]) > 0.5 * np.ptp(recording.q_ref[:, j]))


def diagnosed(arm: NominalArm, joint: int | None, notes: dict[str, Any]) -> str:
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


def row(file: Path, quick: bool = False) -> dict[str, Any]:
    """How far a robot gets, and the message where it stops; ``quick``: no further than its base parameters."""
    out: dict[str, Any] = {"robot": file.stem}
    begin = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ModelWarning)
        try:
            arm = arm_of(file)
            out |= {
                "joints": arm.n_joints,
                "slides": sum(arm.sliding),
                "loads": "yes",
            }
            middle = arm.n_joints // 2 + 1
            steps: dict[str, Callable[[], str]] = {
                "base": lambda: str(
                    structural_base(
                        Regressor(arm, quantities=()), np.random.default_rng(0), 300
                    ).count
                ),
                "excited": lambda: excited(arm),
                "healthy": lambda: diagnosed(arm, None, out),
                "found": lambda: diagnosed(arm, middle, out),
            }
        except GapscopeError as error:
            steps = {}
            out["loads"] = _short(error, file)
        for name, step in steps.items():
            if quick and name != "base":
                continue
            try:
                out[name] = step()
            except GapscopeError as error:
                out[name] = _short(error, file)
    out["notes"] = sorted(
        {str(w.message).replace(str(file), file.name) for w in caught}
    )
    out["seconds"] = round(time.process_time() - begin, 1)
    return out


def _short(error: GapscopeError, file: Path) -> str:
    return error.message.replace(str(file), file.name)


def run(file: Path, name: str, out: Path) -> dict[str, Any]:
    """The row of a robot, from a process of its own, unless it is there."""
    target = out / "rows" / f"{name}.json"
    if not target.exists():
        command = [sys.executable, __file__, "--one", str(file), "--out", str(target)]
        failed = ""
        try:
            done = subprocess.run(
                command, timeout=LIMIT, check=False, capture_output=True, text=True
            )
            failed = "" if done.returncode == 0 else done.stderr.strip()[-300:]
        except subprocess.TimeoutExpired:
            failed = f"not done within {LIMIT:g} s"
        if failed:
            write_json({"robot": name, "loads": failed}, target)
    return read_json(target, "remove it")


def as_table(rows: list[dict[str, Any]]) -> str:
    """The table as Markdown; messages stand below it."""
    head = ("robot", "joints", "slides", *STEPS)
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    messages: dict[str, list[str]] = {}
    for each in rows:
        cells = []
        for name in head:
            text = str(each.get(name, "–"))
            if len(text) > 40 and name != "robot":
                messages.setdefault(text, []).append(each["robot"])
                text = f"({list(messages).index(text) + 1})"
            cells.append(text)
        lines.append("| " + " | ".join(cells) + " |")
    lines.append("")
    for number, text in enumerate(messages, 1):
        lines.append(f"{number}. {' '.join(text.split())}")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Compute the missing rows and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/robots"))
    parser.add_argument("--only")
    parser.add_argument("--one", type=Path)
    parser.add_argument("--quick", action="store_true", help="no new recordings")
    args = parser.parse_args()
    if args.one:
        write_json(row(args.one), args.out)
        return
    (args.out / "rows").mkdir(parents=True, exist_ok=True)
    files = sorted({f.resolve() for e in ENDINGS for f in args.folder.rglob(e)})
    names = [f.name for f in files]
    rows = []
    for file in files:
        name = file.name
        if names.count(name) > 1:
            name = f"{file.parent.name}_{name}"
        if args.only and args.only not in name:
            continue
        begin = time.time()
        done = (args.out / "rows" / f"{name}.json").exists()
        found = (
            row(file, True) if args.quick and not done else run(file, name, args.out)
        )
        rows.append({**found, "robot": name})
        last = {k: v for k, v in rows[-1].items() if k != "notes"}
        print(f"{time.time() - begin:5.0f} s  {last}", flush=True)
    write_json({"rows": rows}, args.out / "robots.json")
    (args.out / "robots.md").write_text(as_table(rows), encoding="utf-8")
    print(as_table(rows))


if __name__ == "__main__":
    main()
