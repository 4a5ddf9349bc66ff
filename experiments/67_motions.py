"""Healthy arms whose motions are not those of a set: they move little, or some of their joints rest.

    .venv/bin/python experiments/67_motions.py --out out/motions [--robots ur5_like,kuka_iiwa] [--draws 2] [--seed 1]

An arm of the blind check's generator that has no effect is recorded twice under its own controller, with the motions of
a set changed as the table says. All that is named is false, but for Stribeck friction: each of these arms has a rise of
friction at low speed, which is most of what its data sheet misses of a slow motion. Run it again for the rest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import command_line, diagnosis, kept, markdown
from generator_arms import recorded, write_side
from threadpoolctl import threadpool_limits

from gapscope.arm.motions.motion import Motion
from gapscope.blind_check.generator.case import (
    CaseSetup,
    draw_setup,
    fed_forward,
    needed_torque,
)
from gapscope.blind_check.generator.simulate import Conditions

Share = Callable[[int], np.ndarray]

MOTIONS: dict[str, Share] = {
    "as they are": np.ones,
    "a fifth of them": lambda n: np.full(n, 0.2),
    "a tenth": lambda n: np.full(n, 0.1),
    "a twentieth": lambda n: np.full(n, 0.05),
    "the first half of the joints alone": lambda n: (np.arange(n) < n // 2) * 1.0,
    "the last three joints alone": lambda n: (np.arange(n) >= n - 3) * 1.0,
    "the last joint alone": lambda n: (np.arange(n) == n - 1) * 1.0,
}
"""What is left of the motion of each joint of n, about where it starts."""
ATTEMPTS = 30


def changed(setup: CaseSetup, share: np.ndarray) -> CaseSetup:
    """The same arm with its motions changed, and fed forward what these ask for."""
    motions = [
        Motion(m.t, m.q[0] + share * (m.q - m.q[0]), share * m.dq, share * m.ddq)
        for m in setup.motions
    ]
    kind, model = setup.loop.feedforward, setup.model
    torques = [needed_torque(setup.arm, model, motion) for motion in motions]
    pairs = zip(motions, torques, strict=True)
    ahead = [fed_forward(kind, model, *pair) for pair in pairs]
    return replace(setup, motions=motions, ahead=ahead)


def recorded_case(robot: str, motion: str, seed: tuple[int, ...], folder: Path) -> None:
    """A case of the arm of a seed, which is the same for all motions."""
    conditions = Conditions(robot, recordings=2, duration=(9.0, 11.0))
    for attempt in range(ATTEMPTS):
        setup = draw_setup(conditions, np.random.default_rng((*seed, attempt)))
        if setup is None:
            continue
        moved = changed(setup, MOTIONS[motion](setup.arm.n))
        rows = recorded(moved, moved.plant(()), (0, 1))
        if rows is not None:
            write_side(moved, rows, folder, bare=False, poor=False)
            return
    raise RuntimeError(f"no {robot} runs well with {motion} in {ATTEMPTS} draws")


def document(robot: str, motion: str, seed: tuple[int, ...], folder: Path) -> Any:
    """The diagnosis of a case, which is recorded if it is not there."""
    if not folder.is_dir():
        recorded_case(robot, motion, seed, folder)
    return diagnosis(folder, None)


def main() -> None:
    """Record and diagnose what is missing, and print the table."""
    arguments = command_line(
        __doc__,
        out=Path("out/motions"),
        robots="ur5_like,franka_panda,kuka_iiwa,xarm6,ur10_like",
        draws=1,
        seed=1,
    ).parse_args()
    threadpool_limits(1)
    table = []
    for number, motion in enumerate(MOTIONS):
        verdicts, names = Counter[str](), Counter[str]()
        for robot in arguments.robots.split(","):
            for draw in range(arguments.draws):
                folder = arguments.out / "cases" / f"{robot}_{number}_{draw}"
                file = arguments.out / f"{folder.name}.json"
                seed = (arguments.seed, draw)
                found = kept(file, document, robot, motion, seed, folder)
                verdicts[
                    "another robot" if "misread" in found else found["verdict"]
                ] += 1
                names.update(effect["effect"] for effect in found["effects"])
        print(motion, dict(verdicts), dict(names), flush=True)
        said = ("no_gap", "effects_found", "unexplained", "another robot")
        counts = [verdicts[one] for one in said]
        listed = ", ".join(f"{name} {count}" for name, count in names.most_common())
        table.append([motion, *counts, listed or "-"])
    print(f"\n{markdown(('motion', *said, 'named'), table)}")


if __name__ == "__main__":
    main()
