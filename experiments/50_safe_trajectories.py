"""Trajectories for random arms, limits and loads, checked by another program: none may break a limit.

Usage, from the top of the repository; a run that was stopped goes on where it was:

    python experiments/50_safe_trajectories.py out/safe
    python experiments/50_safe_trajectories.py out/safe --arms 50
    python experiments/50_safe_trajectories.py out/safe --number 17      one arm, with its violations

An arm follows from its number alone: a chain of 2 to 7 joints about random axes with boxes as bodies, ranges, speeds
and torque limits of its own, half of them with a load. For each a trajectory is designed with few evaluations and
written as ``gapscope excite`` does. All four files (CSV and ROS, full and slow) are read here by other means,
interpolated by scipy's quintic splines at 1777 points per second of the path, and checked with pinocchio alone:
position, velocity, acceleration, jerk, torque by its own sum, rest at both ends, and distances of the boxes to each
other and to the floor.
``OUT`` has a file for each arm; the end prints the counts.
"""

from __future__ import annotations

import csv
import json
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
import yaml
from common import command_line, run_missing
from scipy.interpolate import BPoly

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.design import (
    Excitation,
    ExcitationPlan,
    LimitPlan,
    design,
    prepare,
)
from gapscope.ident.excitation.trajectory_search import Budget
from gapscope.reports.trajectory import write_trajectory

RATE = 1777.0
"""Points per second of the full trajectory [Hz]; no multiple of any rate that is written."""
EVERY = 6
"""Distances are measured on every so many of these points."""
ROUNDING = 1e-6
"""Share of a limit that counts as rounding [1]."""
JERK_TIME = 0.02
"""Jerk may be the acceleration's limit over this time [s], as docs/excitation.md says."""
LIMIT = 900.0
"""Longest processor time of an arm [s]."""
SLOW = 0.2
"""Speed of the slow version, as docs/excitation.md says [1]."""


class Task(NamedTuple):
    """An arm as drawn, what it carries, and what is asked: all that the check needs to know."""

    urdf: str
    arm: NominalArm
    load: KnownLoad | None
    plan: ExcitationPlan
    limits: LimitPlan


def drawn(number: int, folder: Path) -> Task:
    """The task of a number; its URDF is written to the folder."""
    rng = np.random.default_rng([50, number])
    n = int(rng.integers(2, 8))
    path = folder / "arm.urdf"
    path.write_text(_urdf(n, rng), encoding="utf-8")
    joints = tuple(f"joint_{j}" for j in range(1, n + 1))
    arm = NominalArm(
        "drawn",
        path,
        joints,
        armature=rng.uniform(0.0, 0.3, n),
        coulomb=rng.uniform(0.0, 4.0, n),
        viscous=rng.uniform(0.0, 4.0, n),
    )
    load = None
    if rng.uniform() < 0.5:
        load = KnownLoad(float(rng.uniform(0.2, 3.0)), tuple(rng.uniform(-0.1, 0.1, 3)))
    effort = _effort(arm, load, rng)
    arm = replace(arm, torque_limit=effort)
    frequency = float(rng.uniform(0.1, 0.5))
    plan = ExcitationPlan(
        kind=str(rng.choice(["fourier", "quintic", "multisine"])),
        order=int(rng.integers(2, 7)),
        frequency=frequency,
        duration=float(rng.uniform(max(3.0, 1 / frequency), 12.0)),
        rate=float(rng.choice([100.0, 125.0, 250.0, 500.0])),
        optimiser=str(rng.choice(["random", "random", "gradient"])),
        budget=Budget(int(rng.integers(60, 200))),
    )
    limits = LimitPlan(
        velocity=float(rng.uniform(0.3, 3.0)),
        acceleration=float(rng.uniform(1.0, 15.0)),
        torque=float(rng.uniform(0.6, 1.0)),
        # about random axes few arms have six degrees of freedom
        singular=0.0,
        clearance=float(rng.uniform(0.0, 0.03)),
        surface=float(rng.choice([0.0, -0.5])),
    )
    return Task(path.read_text(encoding="utf-8"), arm, load, plan, limits)


def _urdf(n: int, rng: np.random.Generator) -> str:
    """A chain of boxes about random axes."""
    lines = ['<robot name="drawn"><link name="link_0"/>']
    origin = "0 0 0.3"
    for j in range(1, n + 1):
        size = np.array([*rng.uniform(0.03, 0.1, 2), rng.uniform(0.1, 0.45)])
        mass = float(rng.uniform(0.3, 8.0) / j)
        moments = mass * (np.sum(size**2) - size**2) / 12
        low, high = -rng.uniform(0.8, 3.0), rng.uniform(0.8, 3.0)
        axis = "xyz"[int(rng.integers(3))] if j > 1 else "z"
        direction = " ".join(str(int(axis == a)) for a in "xyz")
        middle = f"0 0 {size[2] / 2 + 0.03}"
        inertia = " ".join(
            f'i{a}{a}="{m}"' for a, m in zip("xyz", moments, strict=True)
        )
        lines.append(
            f'<joint name="joint_{j}" type="revolute"><parent link="link_{j - 1}"/><child link="link_{j}"/>'
            f'<origin xyz="{origin}"/><axis xyz="{direction}"/>'
            f'<limit lower="{low}" upper="{high}" effort="1000" velocity="{rng.uniform(0.5, 4.0)}"/></joint>'
            f'<link name="link_{j}"><inertial><origin xyz="{middle}"/><mass value="{mass}"/>'
            f'<inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial>'
            f'<collision><origin xyz="{middle}"/><geometry><box size="{size[0]} {size[1]} {size[2]}"/>'
            "</geometry></collision></link>"
        )
        origin = f"0 0 {size[2] + 0.06}"
    return "".join([*lines, "</robot>"])


def _effort(
    arm: NominalArm, load: KnownLoad | None, rng: np.random.Generator
) -> np.ndarray:
    """Torque limits of 1.2 to 3 times what gravity and friction need at most [N m], (n,)."""
    body = RigidBody(arm).carrying(load)
    q = rng.uniform(*body.position_limits(), (200, arm.n_joints))
    gravity = np.abs(body.inverse_dynamics(q, 0 * q, 0 * q)).max(axis=0)
    return rng.uniform(1.2, 3.0, arm.n_joints) * (gravity + arm.coulomb + 3.0)


def tried(number: int) -> dict[str, Any]:
    """What became of an arm: designed or refused, and its violations."""
    with tempfile.TemporaryDirectory(prefix="gapscope_safe_") as name:
        folder = Path(name)
        task = drawn(number, folder)
        out = {"number": number, "joints": task.arm.n_joints, "kind": task.plan.kind}
        body = RigidBody(task.arm).carrying(task.load)
        rng = np.random.default_rng(number)
        try:
            found = design(prepare(task.arm, task.plan, task.limits, body=body), rng)
        except InputError as error:
            return out | {"end": "refused by design", "reason": error.problem[:160]}
        try:
            write_trajectory(found, task.arm, task.plan, folder / "x.csv")
        except GapscopeError as error:
            reason = error.message.replace(name, "")[:200]
            return out | {"end": "refused at writing", "reason": reason}
        return out | {
            "end": "written",
            "violations": [*violations(task, found, folder)],
        }


def violations(task: Task, found: Excitation, folder: Path) -> Iterator[str]:
    """Every limit that a written file breaks, in words."""
    files = {
        "x.csv": (_read_csv, 1.0),
        "x.yaml": (_read_ros, 1.0),
        "x_slow.csv": (_read_csv, SLOW),
        "x_slow.yaml": (_read_ros, SLOW),
    }
    for name, (read, speed) in files.items():
        times, q, dq, ddq = read(folder / name)
        curve = BPoly.from_derivatives(times, np.stack([q, dq, ddq], axis=1))
        t = np.linspace(0.0, times[-1], int(times[-1] * RATE * speed) + 2)
        series = [curve(t, order) for order in range(4)]
        for ends in (dq[[0, -1]], ddq[[0, -1]]):
            if np.abs(ends).max() > 1e-6:
                yield f"{name}: does not rest at an end"
        for kind, excess in _excesses(task, series, found):
            if excess > 0:
                yield f"{name}: {kind} by {excess:.3g}"


def _read_csv(path: Path) -> tuple[np.ndarray, ...]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = np.array([*csv.reader(file)][1:], dtype=float)
    return rows[:, 0], *np.split(rows[:, 1:], 3, axis=1)


def _read_ros(path: Path) -> tuple[np.ndarray, ...]:
    points = yaml.load(path.read_text(encoding="utf-8"), yaml.CSafeLoader)["points"]
    stamps = [p["time_from_start"] for p in points]
    t = np.array([x["sec"] + x["nanosec"] / 1e9 for x in stamps])
    names = ("positions", "velocities", "accelerations")
    return t, *(np.array([p[name] for p in points]) for name in names)


def _excesses(
    task: Task, series: list[np.ndarray], found: Excitation
) -> Iterator[tuple[str, float]]:
    """By how much each limit is broken at most, as a share; distances in m. Not above 0 if it is kept."""
    q, dq, ddq, jerk = series
    model = pin.buildModelFromXML(task.urdf)
    lower = model.lowerPositionLimit + task.limits.margin
    upper = model.upperPositionLimit - task.limits.margin
    span = upper - lower
    yield "position", _above(np.maximum(q - upper, lower - q) / span + 1, 1.0)
    velocity = np.minimum(model.velocityLimit, task.limits.velocity)
    yield "velocity", _above(dq, velocity)
    yield "acceleration", _above(ddq, task.limits.acceleration)
    yield "jerk", _above(jerk, task.limits.acceleration / JERK_TIME)
    if task.load is not None:
        inertia = pin.Inertia(task.load.mass, np.array(task.load.com), np.zeros((3, 3)))
        model.inertias[model.njoints - 1] += inertia
    data, arm = model.createData(), task.arm
    torque = np.array(
        [pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)]
    )
    friction = arm.coulomb * np.tanh(dq / 0.005) + arm.viscous * dq
    torque += arm.armature * ddq + friction
    yield "torque", _above(torque, task.limits.torque * arm.torque_limit)
    yield from _too_near(task, model, q[::EVERY], found)


def _above(values: np.ndarray, limit: np.ndarray | float) -> float:
    return float((np.abs(values) / limit).max()) - 1 - ROUNDING


def _too_near(
    task: Task, model: pin.Model, q: np.ndarray, found: Excitation
) -> Iterator[tuple[str, float]]:
    """How much nearer than the clearance boxes come to each other and to the floor [m]."""
    shapes = pin.buildGeomFromUrdfString(model, task.urdf, pin.GeometryType.COLLISION)
    count = shapes.ngeoms
    # neighbours touch by construction, and what the command names as not checked
    ignored = {frozenset(pair) for pair in found.left_out}
    for i in range(count):
        for j in range(i + 2, count):
            objects = shapes.geometryObjects[i], shapes.geometryObjects[j]
            if frozenset(x.name for x in objects) not in ignored:
                shapes.addCollisionPair(pin.CollisionPair(i, j))
    data, places = model.createData(), shapes.createData()
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1)
    floor, nearest, surface = np.inf, np.inf, task.limits.surface
    free = {name for pair in found.left_out if "surface" in pair for name in pair}
    for row in q:
        pin.updateGeometryPlacements(model, data, shapes, places, row)
        for shape, place in zip(shapes.geometryObjects, places.oMg, strict=True):
            assert isinstance(shape.geometry, coal.Box)
            if shape.parentJoint > 0 and shape.name not in free:
                corners = place.rotation @ (signs * shape.geometry.halfSide[:, None])
                floor = min(floor, float((place.translation[2] + corners[2]).min()))
        pin.computeDistances(shapes, places)
        distances = [result.min_distance for result in places.distanceResults]
        nearest = min([nearest, *distances])
    yield "floor", task.limits.clearance - (floor - surface) - ROUNDING
    yield "distance", task.limits.clearance - nearest - ROUNDING


def main() -> None:
    """Run, go on, and count."""
    args = command_line(
        __doc__, "out", arms=1000, number=(int, "one arm alone")
    ).parse_args()
    warnings.simplefilter("ignore")
    if args.number is not None:
        print(json.dumps(tried(args.number), indent=1))
        return
    files = {args.out / f"{k:06d}.json": k for k in range(args.arms)}
    entries = run_missing(tried, files, 1, LIMIT, say=lambda entry: str(entry["end"]))
    for end, count in Counter(entry["end"] for entry in entries).most_common():
        print(f"{end}: {count}")
    broken = [x for entry in entries for x in entry.get("violations", ())]
    print(f"violations in written files: {len(broken)}")


if __name__ == "__main__":
    main()
