"""Feedforward on another simulator: tracking error over gain by model, with and without an agent.

    .venv/bin/python experiments/30_other_simulator.py [--arms 0,1,2] [--steps 20480] [--out out/other_simulator]
        [--picture docs/pictures/tracking_over_gain.svg] [--table]

The arms are those of the blind check's generator (`generator_arms.py`): MuJoCo's rigid bodies with its own friction,
transmissions and drives, inertials 10 % off the nominal ones, two strong effects each. An arm is recorded there as the
blind check records it; from these files alone it is identified and diagnosed, and a network is trained on what that
leaves. Each model then feeds torque forward on that same simulator, on motions of other seeds, under PD of bandwidths
from 0.5 to 32 Hz: joint error, reward, and the largest bandwidth at which the arm forgets a pulse. `truth` is no model:
its torque is learnt on the arm itself, motion by motion (`GeneratorArm.true_torque`).

PPO is trained in our environment, on top of `pd`, `nominal` and `corrected`, without a look at the arm; the agent after
the last round acts there. Each cell is a JSON file; a rerun continues. Needs the extras `learn` and `blind`.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import asdict
from itertools import product
from math import inf, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from feedforward_arms import MODELS
from generator_arms import ARMS, MOTIONS, Fed, GeneratorArm, prepare

from gapscope.agents.models import ArmModel, read_model
from gapscope.agents.training.policy import (
    DOCUMENT,
    LAST,
    read_agent_model,
    write_agent,
)
from gapscope.agents.training.task import Task
from gapscope.agents.training.training_loop import Training
from gapscope.agents.training.training_settings import RESIDUAL, read_settings
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import plain, write_json
from gapscope.effects.corrected import CorrectedArm

BANDWIDTHS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Of the loop [Hz]; the inertia that gains are computed with is that of 4 Hz."""
USUAL = 4.0
"""Bandwidth of the tables [Hz]."""
AGENTS = ("pd", "nominal", "corrected")
"""Models on top of which PPO is trained."""
WANTED = 1e-3
"""Joint error for which the table says what bandwidth it takes [rad]."""
RESOLUTION = 1.05
"""The search for the largest stable bandwidth ends when its interval is this narrow [1]."""


def trained(model: str, number: int, steps: int, arm: GeneratorArm, here: Path) -> Path:
    """Folder of the agent after the last round of a training on top of a model."""
    folder = here / f"agent_{model}"
    if not (folder / DOCUMENT).is_file():
        task = Task.of(source(model, here), arm.arm)
        settings = read_settings(RESIDUAL, steps=steps, seed=number, randomise=())
        write_agent(task, Training(task, settings, folder).run(), folder)
    return folder / LAST


def source(model: str, here: Path) -> str:
    """A model's name or file."""
    return str(here / MODELS[model]) if "." in MODELS[model] else MODELS[model]


def feeds(
    name: str, number: int, steps: int, arm: GeneratorArm, here: Path
) -> list[Fed]:
    """What is fed forward under a name, for each motion."""
    if name == "truth":
        nominal = ArmModel(CorrectedArm(arm.arm))
        return [arm.true_torque(i, nominal, USUAL) for i in range(len(MOTIONS))]
    if name.startswith("agent on "):
        folder = trained(name.removeprefix("agent on "), number, steps, arm, here)
        return [read_agent_model(folder, arm.arm)] * len(MOTIONS)
    return [read_model(source(name, here), arm.arm)] * len(MOTIONS)


def cell(fed: list[Fed], arm: GeneratorArm) -> dict[str, Any]:
    """Measures of every motion at every bandwidth, and the largest stable bandwidth [Hz]."""
    rows = [
        {"bandwidth": bandwidth, "motion": MOTIONS[i]}
        | plain(asdict(arm.measure(fed[i], i, bandwidth)), null_if_not_finite=True)
        for bandwidth in BANDWIDTHS
        for i in range(len(MOTIONS))
    ]
    low, high = USUAL, 2 * USUAL
    if not arm.settles(fed[0], low):
        return {"rows": rows, "stable_to": None}
    while arm.settles(fed[0], high) and high < 8 * BANDWIDTHS[-1]:
        low, high = high, 2 * high
    while high / low > RESOLUTION:
        middle = sqrt(low * high)
        low, high = (middle, high) if arm.settles(fed[0], middle) else (low, middle)
    return {"rows": rows, "stable_to": low}


def mean(found: Any, name: str, bandwidth: float) -> float:
    """Mean over motions of a measure at a bandwidth; an error is infinite if the arm was lost."""
    rows = [row for row in found["rows"] if row["bandwidth"] == bandwidth]
    return float(np.mean([inf if row[name] is None else row[name] for row in rows]))


def needed(found: Any) -> str:
    """Bandwidth at which the joint error falls below ``WANTED`` [Hz], between those tried, and at least the lowest."""
    before = None
    for bandwidth in BANDWIDTHS:
        error = mean(found, "joint_error", bandwidth)
        if error <= WANTED:
            if before is None or not np.isfinite(before[1]):
                return f"≤ {bandwidth:.2g}"
            share = np.log(before[1] / WANTED) / np.log(before[1] / error)
            return f"{before[0] * (bandwidth / before[0]) ** share:.2g}"
        before = (bandwidth, error)
    return "never"


def show(cells: dict[tuple[int, str], Any]) -> None:
    """Print Markdown tables, one per arm."""
    for number in sorted({key[0] for key in cells}):
        robot, laws = ARMS[number]
        print(f"\n{robot}, {' and '.join(laws)}\n")
        print(
            f"| fed forward | joint error at 1 Hz [mrad] | at 2 Hz | at {USUAL:g} Hz | at 8 Hz | reward at 1 Hz "
            f"| at {USUAL:g} Hz | bandwidth for {1e3 * WANTED:g} mrad [Hz] | stable to [Hz] |"
        )
        print("|" + "---|" * 9)
        for name in names():
            found = cells.get((number, name))
            if found is None:
                continue
            errors = [
                1e3 * mean(found, "joint_error", b) for b in (1.0, 2.0, USUAL, 8.0)
            ]
            rewards = [mean(found, "reward", b) for b in (1.0, USUAL)]
            texts = [f"{error:.2g}" for error in errors]
            texts += [f"{reward:.2f}" for reward in rewards]
            stable = found["stable_to"]
            texts += [needed(found), "–" if stable is None else f"{stable:.3g}"]
            print(f"| {name} | {' | '.join(texts)} |")


def names() -> list[str]:
    """All that is fed forward, in a table's order."""
    return [*MODELS, *(f"agent on {model}" for model in AGENTS)]


def draw(cells: dict[tuple[int, str], Any], path: Path) -> None:
    """Joint error over bandwidth, one panel per arm; dashed with an agent, dotted where the loop is unstable."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.fonttype"] = "none"
    matplotlib.rcParams["svg.hashsalt"] = "gapscope"
    from matplotlib import pyplot

    colours = dict(zip(MODELS, pyplot.get_cmap("tab10").colors, strict=False))
    numbers = sorted({key[0] for key in cells})
    figure, axes = pyplot.subplots(
        1, len(numbers), figsize=(4 * len(numbers), 4.4), sharey=True, squeeze=False
    )
    for axis, number in zip(axes[0], numbers, strict=True):
        stable = [cells[number, name]["stable_to"] for name in MODELS]
        limit = min(value for value in stable if value is not None)
        for name in names():
            if (number, name) not in cells:
                continue
            found = cells[number, name]
            model = name.removeprefix("agent on ")
            errors = [1e3 * mean(found, "joint_error", b) for b in BANDWIDTHS]
            style = "-" if model == name else "--"
            # the network's curve lies on that of the corrected arm
            style = ":" if "network" in name else style
            axis.plot(
                BANDWIDTHS, errors, style, marker=".", color=colours[model], label=name
            )
        axis.axvspan(limit, BANDWIDTHS[-1] * 1.2, color="0.9")
        axis.text(limit, 0.011, " unstable", color="0.4", fontsize=8, clip_on=True)
        axis.axhline(1e3 * WANTED, color="0.6", linewidth=0.8)
        axis.set(xscale="log", yscale="log", xlim=(0.45, 38), ylim=(0.01, 3000))
        axis.set_title(f"{ARMS[number][0]}: {', '.join(ARMS[number][1])}", fontsize=8)
        axis.set_xticks(BANDWIDTHS, [f"{b:g}" for b in BANDWIDTHS])
        axis.minorticks_off()
        axis.set_xlabel("bandwidth of the PD loop [Hz]")
    axes[0][0].set_ylabel("joint error, RMS [mrad]")
    axes[0][0].legend(fontsize=7, ncols=2, handlelength=4)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as aside:
        figure.savefig(aside, format="svg", metadata={"Date": None})


def main() -> None:
    """Work through the cells, then print the tables and draw the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", default="0,1,2")
    parser.add_argument("--steps", type=int, default=20480)
    parser.add_argument("--out", type=Path, default=Path("out/other_simulator"))
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    numbers = [int(number) for number in arguments.arms.split(",")]
    arms: dict[int, GeneratorArm] = {}
    cells: dict[tuple[int, str], Any] = {}
    # models first: training agents takes longest
    for name, number in product(names(), numbers):
        here = arguments.out / str(number)
        file = here / f"{name.replace(' ', '_')}.json"
        if not file.is_file() and not arguments.table:
            if number not in arms:
                here.mkdir(parents=True, exist_ok=True)
                arms[number] = prepare(number, here)
                arms[number].open(here)
            fed = feeds(name, number, arguments.steps, arms[number], here)
            write_json(cell(fed, arms[number]), file)
            print(f"{ARMS[number][0]}, {name}", flush=True)
        if file.is_file():
            cells[number, name] = json.loads(file.read_text(encoding="utf-8"))
    show(cells)
    if arguments.picture is not None and cells:
        draw(cells, arguments.picture)


if __name__ == "__main__":
    main()
