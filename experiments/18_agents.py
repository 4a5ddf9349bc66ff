"""What a model is worth to an agent: the same agent, trained on top of each model, tried on arms with hidden effects.

    .venv/bin/python experiments/18_agents.py [--seeds 5] [--first 1] [--agents ppo,sac] [--models pd,corrected]
        [--steps N] [--jobs 2] [--arms out/feedforward] [--out out/agents] [--table]

The hidden arms, and what was identified and diagnosed of them, are the KUKA iiwas of `16_feedforward.py`; those that
are not there are made. Seed i is the arm and the seed of the training; arm 0, on which the shipped settings were tried
out, is left out. Each agent is trained in the simulator made from its model (for `pd` the nominal arm), with the same
gains, reach and number of actions; the agent that is kept is the best in that simulator, and what is told of it comes
from motions that chose nothing. PPO is trained on all models, SAC on those of `OFF_POLICY`; `--agents gains` is what
`gapscope train` does by default.

Each cell (model, agent, seed) is a JSON file, written whole; a rerun continues where the last one ended, within a cell
at the last round. `--table` only prints what is there. Writes `curves.html`. Needs the extras `learn` and `mujoco`.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from feedforward_arms import MODELS, ROBOTS, prepare

from gapscope.agents.summary import mean_of
from gapscope.agents.training.policy import write_agent
from gapscope.agents.training.task import Policy, Task, episodes, held_out, idle
from gapscope.agents.training.training_loop import Training
from gapscope.agents.training.training_settings import (
    RESIDUAL,
    TrainingSettings,
    read_settings,
)
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import write_json
from gapscope.effects.corrected_file import read_corrected

ROBOT, SEVERITY = "iiwa", 1.5
RANDOMISED = "nominal + randomisation"
TRIED = ("pd", "nominal", RANDOMISED, "identified", "corrected", "corrected + network")
OFF_POLICY = ("pd", "nominal", "corrected")
"""Models on top of which SAC and TD3 are trained; without `pd` there would be nothing to compare them with."""
ENGINES = ("pybullet", "mujoco")
GAINS = "gains"
"""PPO as `gapscope train` ships it: it changes gains, on arms with effects drawn around the model."""
AS_THEN: dict[str, Any] = {"randomise": (), "count": (1, 3), "severity": (0.5, 1.5)}
"""Of the table's agents nothing was drawn around the model unless said."""
UNSEEN = 1000
"""Seed of the first motion on which the agents are told of."""
Cells = dict[tuple[str, str, int], Any]


def cell(
    model: str, agent: str, seed: int, steps: int | None, arms: Path, out: Path
) -> str:
    """Train and try one agent, and write its cell; returns what to print."""
    warnings.simplefilter("ignore")
    file = place(model, agent, seed, out)
    folder, source = arms / ROBOT / str(seed), MODELS[model.split(" + rand")[0]]
    settings = (
        read_settings("ppo")
        if agent == GAINS
        else read_settings(RESIDUAL if agent == "ppo" else agent, **AS_THEN)
    )
    settings = replace(settings, steps=steps or settings.steps, seed=seed)
    settings = settings.randomised() if model == RANDOMISED else settings
    source = str(folder / source) if "." in source else source
    task = Task.of(source, ROBOTS[ROBOT](), read_corrected(folder / "truth.yaml"))
    trained = Training(task, settings, file.with_suffix("")).run()
    write_agent(task, trained, file.with_suffix(""))
    found = {
        "model": model,
        "agent": agent,
        "seed": seed,
        "steps": trained.curve[-1].steps,
        "kept": trained.curve[trained.best].steps,
        "curve": [point.plain() for point in trained.curve],
        "untrained": tried(task, settings, None),
        "trained": tried(task, settings, trained.policy),
    }
    write_json(found, file)
    return f"{model}, {agent}, {seed}"


def tried(
    task: Task, settings: TrainingSettings, policy: Policy | None
) -> dict[str, list[dict[str, Any]]]:
    """Episodes on the hidden arm by engine, of a policy or of none."""
    out = {}
    for engine in ENGINES:
        env = task.hidden_arm(settings, engine)
        motions = held_out(settings, env, UNSEEN)
        scores = episodes(env, policy or idle(env), motions)
        env.close()
        out[engine] = [
            {"motion": name, **s.plain()}
            for (name, _), s in zip(motions, scores, strict=True)
        ]
    return out


def place(model: str, agent: str, seed: int, out: Path) -> Path:
    """File of a cell; its training lies in the folder of the same name."""
    return out / ROBOT / str(seed) / f"{model.replace(' + ', '_')}_{agent}.json"


def show(cells: Cells) -> None:
    """Print Markdown tables, one per agent."""
    for agent in dict.fromkeys(key[1] for key in cells):
        own = {
            (model, seed): value
            for (model, name, seed), value in cells.items()
            if name == agent
        }
        steps = max(value["steps"] for value in own.values())
        print(
            f"\n{agent.upper()}, {steps} actions, {len({seed for _, seed in own})} arms; joint errors in mrad\n"
        )
        print(
            "| model | untrained | trained | trained, MuJoCo | last round | kept after | reward | torque rate [N m/s] |"
        )
        print("|" + "---|" * 8)
        for model in TRIED:
            found = [value for (name, _), value in own.items() if name == model]
            if found:
                print(row(model, found))
        print(
            "\n| model | gain of the agent on PD that the model gives alone [%] | actions to reach that agent |"
        )
        print("|---|---|---|")
        for model in TRIED[1:]:
            pairs = [
                (own[model, s], own["pd", s])
                for m, s in own
                if m == model and ("pd", s) in own
            ]
            if pairs:
                print(f"| {model} | {shares(pairs)} | {reached(pairs)} |")


def row(model: str, found: Sequence[Any]) -> str:
    """A row of the first table."""
    texts = [
        spread(found, "untrained", "pybullet", "joint_error", 1e3),
        *(spread(found, "trained", engine, "joint_error", 1e3) for engine in ENGINES),
        ", ".join(number(error(value["curve"][-1])) for value in found),
        ", ".join(str(value["kept"]) for value in found),
        spread(found, "trained", "pybullet", "reward", 1.0),
        spread(found, "trained", "pybullet", "torque_rate", 1.0),
    ]
    return f"| {model} | {' | '.join(texts)} |"


def spread(
    found: Sequence[Any], state: str, engine: str, measure: str, factor: float
) -> str:
    """Interquartile mean with its interval."""
    rows = [episode for value in found for episode in value[state][engine]]
    values = [inf if e[measure] is None else factor * e[measure] for e in rows]
    mean = mean_of(values, [e["motion"] for e in rows], np.random.default_rng(0))
    ended = sum(e["ended"] for e in rows)
    return f"{mean.value:.3g} ({mean.low:.3g}–{mean.high:.3g})" + (
        f", {ended} ended early" if ended else ""
    )


def error(point: dict[str, Any]) -> float:
    """Joint error of a point of a curve on the hidden arm [rad]."""
    found = point["hidden"]["joint_error"]
    return inf if found is None else float(found)


def kept(value: Any) -> float:
    """Joint error on the hidden arm of the agent that is kept [rad]."""
    return next(
        error(point) for point in value["curve"] if point["steps"] == value["kept"]
    )


def shares(pairs: Sequence[tuple[Any, Any]]) -> str:
    """Per arm, the fall of the joint error from PD to the untrained model over that from PD to the agent on PD [%]."""
    out = []
    for value, pd in pairs:
        gain = error(pd["curve"][0]) - kept(pd)
        alone = error(pd["curve"][0]) - error(value["curve"][0])
        out.append(
            f"{100 * alone / gain:.0f}" if gain > 0 else "the agent gains nothing"
        )
    return ", ".join(out)


def reached(pairs: Sequence[tuple[Any, Any]]) -> str:
    """Per arm, actions of training after which the agent on the model is as good as the one on PD in the end."""
    found = [
        next((str(p["steps"]) for p in value["curve"] if error(p) <= kept(pd)), "never")
        for value, pd in pairs
    ]
    return ", ".join(found)


def number(value: float) -> str:
    """A joint error [rad] in mrad."""
    return f"{1e3 * value:.3g}"


def draw(cells: Cells, path: Path) -> None:
    """Learning curves on the hidden arms, geometric means over arms, as a page that opens without a network."""
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    from gapscope.reports.plot_page import COLOURS

    names = list(dict.fromkeys(key[1] for key in cells))
    figure = make_subplots(
        rows=1,
        cols=len(names),
        shared_yaxes=True,
        subplot_titles=[n.upper() for n in names],
    )
    for column, agent in enumerate(names, 1):
        for model, colour in zip(TRIED, COLOURS, strict=False):
            curves = [
                value["curve"]
                for key, value in cells.items()
                if key[:2] == (model, agent)
            ]
            length = min((len(curve) for curve in curves), default=0)
            if not length:
                continue
            errors = np.array(
                [[error(point) for point in curve[:length]] for curve in curves]
            )
            mean = 1e3 * np.exp(np.log(errors).mean(axis=0))
            figure.add_trace(
                Scatter(
                    x=[point["steps"] for point in curves[0][:length]],
                    y=np.where(np.isfinite(mean), mean, None),
                    name=model,
                    legendgroup=model,
                    showlegend=column == 1,
                    line={"color": colour},
                ),
                row=1,
                col=column,
            )
    figure.update_yaxes(type="log")
    figure.update_yaxes(title={"text": "joint error on the hidden arm [mrad]"}, col=1)
    figure.update_xaxes(title={"text": "actions of training"})
    with atomic_write(path) as aside:
        figure.write_html(aside, include_plotlyjs=True)


def main() -> None:
    """Work through the cells, then print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--agents", default="ppo,sac")
    parser.add_argument("--models", default=",".join(TRIED))
    parser.add_argument("--steps", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--arms", type=Path, default=Path("out/feedforward"))
    parser.add_argument("--out", type=Path, default=Path("out/agents"))
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    agents, models = arguments.agents.split(","), arguments.models.split(",")
    if unknown := set(models) - set(TRIED):
        parser.error(
            f"unknown model {sorted(unknown)[0]!r}; known are {', '.join(TRIED)}"
        )
    warnings.simplefilter("ignore")
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    keys = [
        (model, agent, seed)
        for seed in seeds
        for agent in agents
        for model in models
        if agent == "ppo" or model in OFF_POLICY
    ]
    if not arguments.table:
        for seed in seeds:
            prepare(ROBOT, seed, SEVERITY, arguments.arms / ROBOT / str(seed))
        missing = [key for key in keys if not place(*key, arguments.out).is_file()]
        with ProcessPoolExecutor(arguments.jobs) as pool:
            tasks = [
                pool.submit(cell, *key, arguments.steps, arguments.arms, arguments.out)
                for key in missing
            ]
            for task in as_completed(tasks):
                print(task.result(), flush=True)
    files = {key: place(*key, arguments.out) for key in keys}
    cells = {
        key: json.loads(file.read_text(encoding="utf-8"))
        for key, file in files.items()
        if file.is_file()
    }
    if cells:
        show(cells)
        draw(cells, arguments.out / "curves.html")


if __name__ == "__main__":
    main()
