"""What a model is worth fed forward: tracking by model, without learning, under an agent, and on another simulator.

    .venv/bin/python experiments/16_feedforward.py PART [--out out/...] [--table]

Each cell is a JSON file, written whole; a rerun continues where the last one ended. ``--table`` only prints what is
there. Needs the extra ``learn``, the agents ``mujoco`` as well.

``models [--robots iiwa,panda] [--engines pybullet,mujoco] [--seeds 3] [--severity 1.5]``: tracking error at equal gains
on arms with hidden effects. Per robot and seed, three effects that ``gapscope demo`` may hide are drawn at the given
severity (1 is what real arms show), and a session of four recordings is made. From its files alone the arm is
identified, diagnosed, and a residual network is trained on what the diagnosis leaves. Each model then feeds torque
forward on held-out motions: Fourier, pick, place and weld seam, undisturbed and pushed, with a loop of 4 Hz. Gains are
raised for both laws (``docs/agents.md``) until the arm does not settle any more. Tables are of one engine each; the
recordings are made in PyBullet for both. Another severity needs another folder.

``agents [--seeds 5] [--first 1] [--agents ppo,sac] [--models pd,corrected] [--steps N] [--jobs 2] [--arms
out/feedforward]``: the same agent, trained on top of each model. The hidden arms are the KUKA iiwas of ``models``;
those that are not there are made. Seed i is the arm and the seed of the training; arm 0, on which the shipped settings
were tried out, is left out. Each agent is trained in the simulator made from its model (for ``pd`` the nominal arm),
with the same gains, reach and number of actions; the agent that is kept is the best in that simulator, and what is told
of it comes from motions that chose nothing. PPO is trained on all models, SAC on those of
``OFF_POLICY``; ``--agents gains`` is what ``gapscope train`` does by default. A rerun goes
on within a cell at the last round. Writes ``curves.html``.

``other_simulator [--arms 0,1,2] [--steps 20480] [--picture docs/pictures/tracking_over_gain.svg]``: tracking error over
gain. The arms are those of the blind check's generator (``generator_arms.py``): MuJoCo's rigid bodies with its own
friction, transmissions and drives, inertials 10 % off the nominal ones, two strong effects each. An arm is recorded
there as the blind check records it; from these files alone it is identified and diagnosed, and a network is trained on
what that leaves. Each model then feeds torque forward on that same simulator, on motions of other seeds, under PD of
bandwidths from 0.5 to 32 Hz: joint error, reward, and the largest bandwidth at which the arm forgets a pulse. ``truth``
is no model: its torque is learnt on the arm itself, motion by motion (``GeneratorArm.true_torque``). PPO is trained in
our environment, on top of ``pd``, ``nominal`` and ``corrected``, without a look at the arm; the agent after the last
round acts there.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, replace
from itertools import product
from math import inf, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from common import run_part
from generator_arms import ARMS, MOTIONS, Fed, GeneratorArm

from gapscope.agents.evaluation import EvaluationPlan, TrackingBench
from gapscope.agents.models import ArmModel, read_model
from gapscope.agents.summary import interquartile_mean, mean_of
from gapscope.agents.training.policy import (
    DOCUMENT,
    LAST,
    read_agent_model,
    write_agent,
)
from gapscope.agents.training.task import Policy, Task, episodes, held_out, idle
from gapscope.agents.training.training_loop import Training
from gapscope.agents.training.training_settings import (
    RESIDUAL,
    TrainingSettings,
    read_settings,
)
from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import plain, write_json
from gapscope.arm.io.write_case import write_case
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.arms import SHEETS
from gapscope.blind_check.scoring import wilson
from gapscope.commands.diagnose_path import diagnose_path
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected, write_corrected
from gapscope.effects.residual import write_residual
from gapscope.envs.mystery_arm import HIDDEN, iiwa
from gapscope.envs.randomisation import Randomisation, draw_effects
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.residual.fit import ResidualSettings, fit_residual, from_segment
from gapscope.interface.identify import identify
from gapscope.model.conditioning import condition, position_cutoff

# Arms with hidden effects: recorded, identified and diagnosed

LIMITS = [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0]
"""Torque limits of the Panda, as its maker states them [N m]."""


def panda() -> NominalArm:
    """Franka Panda with rotors and friction of its class, and encoders of 17 bits per turn."""
    sheet = {
        name: getattr(SHEETS["franka_panda"], name)
        for name in ("armature", "coulomb", "viscous")
    }
    return load_nominal_arm(
        "franka_panda",
        sheet={**sheet, "torque_limit": LIMITS, "encoder_step": 2 * np.pi / 2**17},
    )


ROBOTS: dict[str, Callable[[], NominalArm]] = {
    "iiwa": iiwa,
    "panda": panda,
}
MODELS = {
    "pd": "pd",
    "gravity": "gravity",
    "nominal": "nominal",
    "identified": "identified/identification.json",
    "corrected": "diagnosis/corrected.yaml",
    "corrected + network": "diagnosis/with_network.yaml",
    "truth": "truth.yaml",
}
"""Models, in a table's order, with their files; the last one is the bound."""


def prepare(robot: str, seed: int, severity: float, folder: Path) -> None:
    """Draw an arm, record it, identify and diagnose it, and train a network; what is there is left as it is."""
    arm = ROBOTS[robot]()
    if not (folder / "truth.yaml").is_file():
        rng = np.random.default_rng((16, list(ROBOTS).index(robot), seed))
        wanted = Randomisation(HIDDEN, count=(3, 3), severity=(severity, severity))
        effects = draw_effects(rng, arm, wanted, ArmScale.of(arm))
        case = record_case(f"{robot}_{seed}", arm, effects, Plan(), rng)
        write_case(case, folder / "case", overwrite=True)
        write_corrected(case.name, effects, folder / "truth.yaml")
    find_models(folder)


def find_models(folder: Path) -> None:
    """Identify and diagnose the case of a folder, and train a network; what is there is left as it is."""
    if not (folder / MODELS["identified"]).is_file():
        identify(folder / "case").save(folder / "identified")
    if not (folder / "diagnosis" / "diagnosis.json").is_file():
        diagnose_path(folder / "case", folder / "diagnosis")
    if not (folder / MODELS["corrected + network"]).is_file():
        learn(folder)


def learn(folder: Path) -> None:
    """Train a network on what the diagnosis of a case leaves, and write the corrected arm with it."""
    case, effects = (
        load_case(folder / "case"),
        read_corrected(folder / MODELS["corrected"]),
    )
    corrected, body, cutoff = (
        CorrectedArm(case.arm, effects),
        RigidBody(case.arm),
        position_cutoff(case.recordings),
    )
    parts = [
        from_segment(corrected, body, s)
        for r in case.recordings
        for s in condition(r, cutoff)
    ]
    write_residual(
        fit_residual(parts, ResidualSettings())[0],
        folder / "diagnosis" / "residual.npz",
    )
    write_corrected(
        case.name, effects, folder / MODELS["corrected + network"], "residual.npz"
    )


# Models fed forward

INSIDE_LOOP = tuple(MODELS)[2:]
"""Models that can stand inside the loop."""
MODEL_COLUMNS = (
    ("joint_error", "none", 1e3),
    ("joint_error", "push", 1e3),
    ("tool_error", "none", 1e3),
    ("reward", "none", 1.0),
    ("torque_error", "none", 1e2),
)
"""Measure, disturbance and factor of a table's columns."""


def model_cell(
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
    if model in INSIDE_LOOP:
        out["margin"]["computed"] = TrackingBench(
            arm, effects, replace(plan, law="computed")
        ).margin(tried, engine)
    return out


def show_models(cells: dict[tuple[str, str, str, int], Any]) -> None:
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
                print(model_row(model, found))
        ratios = [nominal_over_corrected(own, robot, engine, seed) for seed in seeds]
        known = [ratio for ratio in ratios if ratio is not None]
        if known:
            print(
                f"\nundisturbed joint error, nominal over corrected, by arm: {', '.join(f'{r:.1f}' for r in known)}"
            )


def model_row(model: str, found: list[Any]) -> str:
    """A row of the table."""
    episodes = [episode for value in found for episode in value["episodes"]]
    texts = []
    for name, kind, factor in MODEL_COLUMNS:
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


def nominal_over_corrected(
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


def models() -> None:
    """Work through the cells, then print the tables."""
    parser = argparse.ArgumentParser(description=models.__doc__)
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
                        found = model_cell(
                            ROBOTS[robot](), effects, model, engine, seed, folder
                        )
                        write_json(found, file)
                        print(f"{robot} {seed} {engine} {model}", flush=True)
                    cells[robot, model, engine, seed] = json.loads(
                        file.read_text(encoding="utf-8")
                    )
    show_models(cells)


# Agents on top of models

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


def agent_cell(
    model: str, agent: str, seed: int, steps: int | None, arms: Path, out: Path
) -> str:
    """Train and try one agent, and write its cell; returns what to print."""
    warnings.simplefilter("ignore")
    file = agent_file(model, agent, seed, out)
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
        count = settings.seeds * len(settings.motions)
        env = task.trials(settings, count, hidden=True, engine=engine)
        motions = held_out(settings, env.setup.space, UNSEEN)
        scores = episodes(env, policy or idle(env), motions)
        env.close()
        out[engine] = [
            {"motion": name, **s.plain()}
            for (name, _), s in zip(motions, scores, strict=True)
        ]
    return out


def agent_file(model: str, agent: str, seed: int, out: Path) -> Path:
    """File of a cell; its training lies in the folder of the same name."""
    return out / ROBOT / str(seed) / f"{model.replace(' + ', '_')}_{agent}.json"


def show_agents(cells: Cells) -> None:
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
                print(agent_row(model, found))
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


def agent_row(model: str, found: Sequence[Any]) -> str:
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


def draw_curves(cells: Cells, path: Path) -> None:
    """Learning curves on the hidden arms, geometric means over arms, as a page that opens without a network."""
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    from gapscope.reports.pages import COLOURS

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


def on_top_of_models() -> None:
    """Work through the cells, then print the tables."""
    parser = argparse.ArgumentParser(description=on_top_of_models.__doc__)
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
        missing = [key for key in keys if not agent_file(*key, arguments.out).is_file()]
        with ProcessPoolExecutor(arguments.jobs) as pool:
            tasks = [
                pool.submit(
                    agent_cell, *key, arguments.steps, arguments.arms, arguments.out
                )
                for key in missing
            ]
            for task in as_completed(tasks):
                print(task.result(), flush=True)
    files = {key: agent_file(*key, arguments.out) for key in keys}
    cells = {
        key: json.loads(file.read_text(encoding="utf-8"))
        for key, file in files.items()
        if file.is_file()
    }
    if cells:
        show_agents(cells)
        draw_curves(cells, arguments.out / "curves.html")


# Another simulator

BANDWIDTHS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Of the loop [Hz]; the inertia that gains are computed with is that of 4 Hz."""
USUAL = 4.0
"""Bandwidth of the tables [Hz]."""
AGENTS_ON = ("pd", "nominal", "corrected")
"""Models on top of which PPO is trained."""
WANTED = 1e-3
"""Joint error for which the table says what bandwidth it takes [rad]."""
RESOLUTION = 1.05
"""The search for the largest stable bandwidth ends when its interval is this narrow [1]."""


def prepare_generated(number: int, folder: Path) -> GeneratorArm:
    """An arm by its number, recorded in its simulator; from the files alone it is identified, diagnosed, learnt."""
    arm = GeneratorArm(number)
    if not (folder / "case").is_dir():
        arm.write(folder)
    find_models(folder)
    return arm


def trained_agent(
    model: str, number: int, steps: int, arm: GeneratorArm, here: Path
) -> Path:
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
        folder = trained_agent(name.removeprefix("agent on "), number, steps, arm, here)
        return [read_agent_model(folder, arm.arm)] * len(MOTIONS)
    return [read_model(source(name, here), arm.arm)] * len(MOTIONS)


def bandwidth_cell(fed: list[Fed], arm: GeneratorArm) -> dict[str, Any]:
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


def mean_measure(found: Any, name: str, bandwidth: float) -> float:
    """Mean over motions of a measure at a bandwidth; an error is infinite if the arm was lost."""
    rows = [row for row in found["rows"] if row["bandwidth"] == bandwidth]
    return float(np.mean([inf if row[name] is None else row[name] for row in rows]))


def needed(found: Any) -> str:
    """Bandwidth at which the joint error falls below ``WANTED`` [Hz], between those tried, and at least the lowest."""
    before = None
    for bandwidth in BANDWIDTHS:
        error = mean_measure(found, "joint_error", bandwidth)
        if error <= WANTED:
            if before is None or not np.isfinite(before[1]):
                return f"≤ {bandwidth:.2g}"
            share = np.log(before[1] / WANTED) / np.log(before[1] / error)
            return f"{before[0] * (bandwidth / before[0]) ** share:.2g}"
        before = (bandwidth, error)
    return "never"


def show_bandwidths(cells: dict[tuple[int, str], Any]) -> None:
    """Print Markdown tables, one per arm."""
    for number in sorted({key[0] for key in cells}):
        robot, laws = ARMS[number]
        print(f"\n{robot}, {' and '.join(laws)}\n")
        print(
            f"| fed forward | joint error at 1 Hz [mrad] | at 2 Hz | at {USUAL:g} Hz | at 8 Hz | reward at 1 Hz "
            f"| at {USUAL:g} Hz | bandwidth for {1e3 * WANTED:g} mrad [Hz] | stable to [Hz] |"
        )
        print("|" + "---|" * 9)
        for name in all_fed():
            found = cells.get((number, name))
            if found is None:
                continue
            errors = [
                1e3 * mean_measure(found, "joint_error", b)
                for b in (1.0, 2.0, USUAL, 8.0)
            ]
            rewards = [mean_measure(found, "reward", b) for b in (1.0, USUAL)]
            texts = [f"{error:.2g}" for error in errors]
            texts += [f"{reward:.2f}" for reward in rewards]
            stable = found["stable_to"]
            texts += [needed(found), "–" if stable is None else f"{stable:.3g}"]
            print(f"| {name} | {' | '.join(texts)} |")


def all_fed() -> list[str]:
    """All that is fed forward, in a table's order."""
    return [*MODELS, *(f"agent on {model}" for model in AGENTS_ON)]


def draw_bandwidths(cells: dict[tuple[int, str], Any], path: Path) -> None:
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
        for name in all_fed():
            if (number, name) not in cells:
                continue
            found = cells[number, name]
            model = name.removeprefix("agent on ")
            errors = [1e3 * mean_measure(found, "joint_error", b) for b in BANDWIDTHS]
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


def other_simulator() -> None:
    """Work through the cells, then print the tables and draw the picture."""
    parser = argparse.ArgumentParser(description=other_simulator.__doc__)
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
    for name, number in product(all_fed(), numbers):
        here = arguments.out / str(number)
        file = here / f"{name.replace(' ', '_')}.json"
        if not file.is_file() and not arguments.table:
            if number not in arms:
                here.mkdir(parents=True, exist_ok=True)
                arms[number] = prepare_generated(number, here)
                arms[number].open(here)
            fed = feeds(name, number, arguments.steps, arms[number], here)
            write_json(bandwidth_cell(fed, arms[number]), file)
            print(f"{ARMS[number][0]}, {name}", flush=True)
        if file.is_file():
            cells[number, name] = json.loads(file.read_text(encoding="utf-8"))
    show_bandwidths(cells)
    if arguments.picture is not None and cells:
        draw_bandwidths(cells, arguments.picture)


PARTS = {
    "models": models,
    "agents": on_top_of_models,
    "other_simulator": other_simulator,
}
"""What the first word of the command line may be."""

if __name__ == "__main__":
    run_part(__doc__, PARTS)
