"""What a long run leaves behind: memory, file handles, temporary files and threads over time, and their slopes.

    .venv/bin/python experiments/47_long_run.py [--steps 1000000] [--diagnoses 10000] [--part NAME ...]

Parts ``pybullet`` and ``mujoco``: environment steps as in training, four environments in vector form that
reset themselves, other effects in every episode, random actions. Part ``diagnosis``: short cases (two joints, two
recordings of 3 s at 100 Hz), each read from a folder of its own, diagnosed, written with its report, and removed, in
one process. Every part runs in a process and a temporary folder of its own; memory is the resident set after a
collection of garbage.

The first fifth of a run fills caches and is left out. The rest is averaged over ten stretches, which makes neighbouring
readings, which are alike, nearly independent; the slope is that of a line through the ten means, its error that of the
line's scatter. The readings, a hundred of a run, are written to ``--out`` as CSV; ``--again`` prints their table.
"""

from __future__ import annotations

import csv
import gc
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np
from common import command_line, markdown, run_tasks
from rich.console import Console
from rich.progress import track
from scipy.stats import linregress

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.io.write_case import write_case
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm, shifted_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.engines import ENGINES, installed
from gapscope.envs.randomisation import Randomisation
from gapscope.envs.recorder import Plan, record_case

PARTS = (*ENGINES, "diagnosis")
LIMIT = 1e6
"""Longest processor time of a part [s]."""
COPIES = 4
"""Environments side by side."""
EPISODE = 1.0
"""Length of an episode [s]: 50 actions, so that a million steps hold 20 000 resets."""
READINGS = 100
"""Readings of a run, at most."""
STRETCHES = 10
"""Means that the line goes through."""
WARM_UP = 0.2
"""Share of a run that is left out."""
JOINTS = ("lbr_iiwa_joint_2", "lbr_iiwa_joint_4")
"""Joints of the short cases; the iiwa's others are locked."""


class Reading(NamedTuple):
    """What the process holds after ``count`` steps or diagnoses: memory [MB], and numbers of the others."""

    count: int
    memory: float
    handles: int
    temporary: int
    threads: int


def reading(count: int) -> Reading:
    """What this process holds now."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return Reading(
        count,
        pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        len(os.listdir("/proc/self/fd")) - 1,  # that of the listing itself
        len(os.listdir(tempfile.gettempdir())),
        len(os.listdir("/proc/self/task")),
    )


def environment(engine: str, steps: int) -> Iterator[Reading]:
    """Steps of environments that reset themselves, with random actions, as an algorithm of stable-baselines3 takes."""
    effects = ["coulomb_friction", "payload", "actuator_delay", "joint_elasticity"]
    env = gymnasium.make_vec(
        "gapscope/ArmTracking-v0",
        num_envs=COPIES,
        vectorization_mode="sync",
        engine=engine,
        episode_length=EPISODE,
        randomisation=Randomisation(effects, joints=(2, 4), count=(1, 2)),
    )
    env.reset(seed=0)
    env.action_space.seed(0)
    calls = steps // COPIES
    every = max(1, calls // READINGS)
    for call in track(range(1, calls + 1), engine, console=Console(stderr=True)):
        env.step(env.action_space.sample())
        if call % every == 0:
            yield reading(call * COPIES)
    env.close()


def diagnoses(count: int) -> Iterator[Reading]:
    """Diagnoses of short cases in turn, each from a folder of its own, written and removed."""
    work = Path(tempfile.mkdtemp())
    cases = [
        write_case(case, work / str(k)).parent for k, case in enumerate(short_cases())
    ]
    every = max(1, count // READINGS)
    for k in track(range(1, count + 1), "diagnoses", console=Console(stderr=True)):
        folder, out = work / f"case_{k}", work / f"out_{k}"
        shutil.copytree(cases[k % len(cases)], folder)
        gapscope.diagnose(folder).save(out)
        shutil.rmtree(folder)
        shutil.rmtree(out)
        if k % every == 0:
            yield reading(k)
    shutil.rmtree(work)


def short_cases() -> Iterator[Case]:
    """A case with friction and a load, a healthy one, and one whose URDF has its inertials on the wrong links."""
    names = load_nominal_arm("kuka_iiwa").joints
    locked = {name: 0.0 for name in names if name not in JOINTS}
    arm = load_nominal_arm("kuka_iiwa", joints=JOINTS, locked=locked)
    friction = AppliedEffect("coulomb_friction", (1, 2), {"torque": [4.0, 2.0]})
    load = AppliedEffect("payload", (), {"mass": 2.0, "com": [0.0, 0.0, 0.08]})
    yield recorded("friction_and_load", arm, (friction, load))
    healthy = recorded("healthy", arm, ())
    yield healthy
    wrong = shifted_arm(arm, 1)
    yield Case("wrong_links", Path(), wrong, healthy.recordings, (), healthy.controller)


def recorded(name: str, arm: NominalArm, effects: tuple[AppliedEffect, ...]) -> Case:
    """A short case of a simulated arm."""
    plan = Plan(recordings=2, duration=3.0, rate=100.0, engine="mujoco")
    return record_case(name, arm, effects, plan, np.random.default_rng(0))


def run(part: str, size: int, file: Path) -> None:
    """Run a part in this process, whose temporary files lie in a folder of their own, and write its readings."""
    warnings.simplefilter("ignore", category=UserWarning)
    file.parent.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix="long_run_") as folder,
        file.open("w", newline="", encoding="utf-8") as opened,
    ):
        os.environ["TMPDIR"] = tempfile.tempdir = folder
        writer = csv.writer(opened, lineterminator="\n")
        writer.writerow(Reading._fields)
        for sample in environment(part, size) if part in ENGINES else diagnoses(size):
            writer.writerow(sample)
            opened.flush()


class Drift(NamedTuple):
    """Slope of a quantity per 1000 steps or diagnoses, its standard error, and its first and last mean."""

    slope: float
    error: float
    first: float
    last: float

    def __str__(self) -> str:
        """As a cell of the table."""
        change = f"{self.first:.5g} to {self.last:.5g}"
        return f"{change} ({self.slope:+.2g} ± {self.error:.1g})"


def drift(count: np.ndarray, value: np.ndarray) -> Drift:
    """Line through the means of the stretches after the warm-up."""
    late = count > WARM_UP * count[-1]
    stretches = np.array_split(np.flatnonzero(late), STRETCHES)
    x = np.array([count[rows].mean() for rows in stretches]) / 1000
    y = np.array([value[rows].mean() for rows in stretches])
    line = linregress(x, y)
    return Drift(line.slope, line.stderr, y[0], y[-1])


def row(part: str, file: Path) -> list[str]:
    """Row of the table."""
    readings = np.genfromtxt(file, delimiter=",", skip_header=1)
    count, values = readings[:, 0], readings[:, 1:].T
    return [part, f"{count[-1]:.0f}", *(str(drift(count, value)) for value in values)]


def main() -> None:
    """Run the parts asked for, or read their files again, and print the table."""
    given = command_line(
        __doc__,
        steps=1_000_000,
        diagnoses=10_000,
        out=Path("out/long_run"),
        again=False,
        part={"nargs": "+", "choices": PARTS, "default": PARTS},
    ).parse_args()
    files = {part: (given.out / f"{part}.csv").resolve() for part in given.part}
    for part in set(files) & set(ENGINES):
        if not installed(part):
            print(f"{part}: not installed, left out")
            files.pop(part)

    def apart(part: str) -> None:
        size = given.steps if part in ENGINES else given.diagnoses
        run(part, size, files[part])

    if not given.again:
        run_tasks(apart, list(files), 1, LIMIT, print)
    rows = [row(part, file) for part, file in files.items()]
    head = ("part", "count", "memory [MB]", "handles", "temporary files", "threads")
    print(markdown(head, rows))


if __name__ == "__main__":
    main()
