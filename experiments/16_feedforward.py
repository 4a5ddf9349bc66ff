"""Feedforward without learning: tracking error by model, on arms with hidden effects, at equal gains.

    .venv/bin/python experiments/16_feedforward.py [--robots iiwa,panda] [--engines pybullet,mujoco] [--seeds 3]
        [--severity 1.5] [--out out/feedforward] [--table]

Per robot and seed, three effects that `gapscope demo` may hide are drawn at the given severity (1 is what real arms
show), and a session of four recordings is made. From its files alone the arm is identified, diagnosed, and a residual
network is trained on what the diagnosis leaves. Each model then feeds torque forward on held-out motions: Fourier,
pick, place and weld seam, undisturbed and pushed, with a loop of 4 Hz. Gains are raised for both laws
(`docs/agents.md`) until the arm does not settle any more.

Each cell (robot, model, engine, seed) is a JSON file, written whole; a rerun continues where the last one ended. Tables
are of one engine each; the recordings are made in PyBullet for both. Another severity needs another folder.
`--table` only prints what is there. Needs the extra `learn`.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from feedforward_arms import MODELS, ROBOTS, prepare

from gapscope.agents.evaluation import EvaluationPlan, TrackingBench
from gapscope.agents.models import read_model
from gapscope.agents.summary import interquartile_mean, mean_of
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import write_json
from gapscope.arm.nominal import NominalArm
from gapscope.blind_check.scoring.statistics import wilson
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import read_corrected

INSIDE = tuple(MODELS)[2:]
"""Models that can stand inside the loop."""
COLUMNS = (
    ("joint_error", "none", 1e3),
    ("joint_error", "push", 1e3),
    ("tool_error", "none", 1e3),
    ("reward", "none", 1.0),
    ("torque_error", "none", 1e2),
)
"""Measure, disturbance and factor of a table's columns."""


def cell(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    model: str,
    engine: str,
    seed: int,
    folder: Path,
) -> Any:
    """Episodes of one model, and the largest stable bandwidths [Hz] of both laws."""
    source = MODELS[model]
    tried = read_model(str(folder / source) if "." in source else source, arm)
    plan = EvaluationPlan(engines=(engine,), seeds=(seed,))
    bench = TrackingBench(arm, effects, plan)
    out: dict[str, Any] = {
        "episodes": [
            episode.row() for episode in bench.episodes(model, tried, engine, seed)
        ],
        "margin": {"feedforward": bench.margin(tried, engine)},
    }
    if model in INSIDE:
        out["margin"]["computed"] = TrackingBench(
            arm, effects, replace(plan, law="computed")
        ).margin(tried, engine)
    return out


def show(cells: dict[tuple[str, str, str, int], Any]) -> None:
    """Print Markdown tables, one per robot and engine."""
    for robot, engine in sorted({(key[0], key[2]) for key in cells}):
        own = {
            key: value
            for key, value in cells.items()
            if (key[0], key[2]) == (robot, engine)
        }
        seeds = sorted({key[3] for key in own})
        print(f"\n{robot}, {engine}, {len(seeds)} arms\n")
        print(
            "| model | joints [mrad] | pushed [mrad] | tool [mm] | reward | torque NRMSE [%] | diverged |",
            end="",
        )
        print(
            " stable to [Hz], feedforward | computed |\n|---|---|---|---|---|---|---|---|---|"
        )
        for model in MODELS:
            found = [value for key, value in own.items() if key[1] == model]
            if found:
                print(row(model, found))
        ratios = [compared(own, robot, engine, seed) for seed in seeds]
        known = [ratio for ratio in ratios if ratio is not None]
        if known:
            print(
                f"\nundisturbed joint error, nominal over corrected, by arm: {', '.join(f'{r:.1f}' for r in known)}"
            )


def row(model: str, found: list[Any]) -> str:
    """A row of the table."""
    episodes = [episode for value in found for episode in value["episodes"]]
    texts = []
    for name, kind, factor in COLUMNS:
        own = [e for e in episodes if e["disturbance"] == kind]
        values = [inf if e[name] is None else factor * e[name] for e in own]
        mean = mean_of(values, [e["motion"] for e in own], np.random.default_rng(0))
        texts.append(f"{mean.value:.3g} ({mean.low:.3g}–{mean.high:.3g})")
    count = sum(e["diverged"] for e in episodes)
    low, high = wilson(count, len(episodes))
    texts.append(f"{count} of {len(episodes)} ({100 * low:.0f}–{100 * high:.0f} %)")
    for law in ("feedforward", "computed"):
        margins = [value["margin"][law] for value in found if law in value["margin"]]
        texts.append(
            f"{np.mean(margins):.1f} ({min(margins):.1f}–{max(margins):.1f})"
            if margins
            else "–"
        )
    return f"| {model} | {' | '.join(texts)} |"


def compared(
    cells: dict[tuple[str, str, str, int], Any], robot: str, engine: str, seed: int
) -> float | None:
    """Joint error of the nominal over that of the corrected feedforward [1] on one arm, or ``None``."""
    pair = [
        cells.get((robot, model, engine, seed)) for model in ("nominal", "corrected")
    ]
    if None in pair:
        return None
    calm = [
        [e["joint_error"] for e in c["episodes"] if e["disturbance"] == "none"]
        for c in pair
        if c
    ]
    nominal, corrected = (
        float(interquartile_mean(np.array([inf if e is None else e for e in errors])))
        for errors in calm
    )
    return nominal / corrected


def main() -> None:
    """Work through the cells, then print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", default="iiwa,panda")
    parser.add_argument("--engines", default="pybullet,mujoco")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--severity", type=float, default=1.5)
    parser.add_argument("--out", type=Path, default=Path("out/feedforward"))
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    cells: dict[tuple[str, str, str, int], Any] = {}
    for robot in arguments.robots.split(","):
        for seed in range(arguments.seeds):
            folder = arguments.out / robot / str(seed)
            if not arguments.table:
                try:
                    prepare(robot, seed, arguments.severity, folder)
                except GapscopeError as error:
                    print(f"{robot} {seed}: {error}", flush=True)
                    continue
            for engine in arguments.engines.split(","):
                for model in MODELS:
                    file = folder / f"{model.replace(' + ', '_')}_{engine}.json"
                    if not file.is_file():
                        if arguments.table:
                            continue
                        effects = read_corrected(folder / "truth.yaml")
                        found = cell(
                            ROBOTS[robot](), effects, model, engine, seed, folder
                        )
                        write_json(found, file)
                        print(f"{robot} {seed} {engine} {model}", flush=True)
                    cells[robot, model, engine, seed] = json.loads(
                        file.read_text(encoding="utf-8")
                    )
    show(cells)


if __name__ == "__main__":
    main()
