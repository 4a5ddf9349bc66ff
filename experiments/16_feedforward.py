"""What a model is worth fed forward: tracking by model, without learning, under an agent, and on another simulator.

    .venv/bin/python experiments/16_feedforward.py PART [--out out/...] [--table]

Each cell is a JSON file, written whole; a rerun continues where the last one ended. ``--table`` only prints what is
there. Needs the extra ``learn``, the agents ``mujoco`` as well.

``models [--robots iiwa,panda] [--seeds 3] [--severity 1.5]``: tracking error at equal gains, arms with hidden effects.
Per robot and seed, three effects that ``gapscope demo`` may hide are drawn at the given severity (1 is what real arms
show), and a session of four recordings is made. From its files alone the arm is identified, diagnosed, and a residual
network is trained on what the diagnosis leaves. Each model then feeds torque forward on held-out motions in PyBullet:
Fourier, pick, place and weld seam, undisturbed and pushed, with a loop of 4 Hz. Gains are raised for both laws
(``docs/agents.md``) until the arm does not settle any more. Another severity needs another folder.

``agents [--seeds 5] [--first 1] [--agents ppo,sac] [--models pd,corrected] [--steps N] [--jobs 2] [--arms
out/feedforward]``: the same agent, trained on top of each model. The hidden arms are the KUKA iiwas of ``models``;
those that are not there are made. Seed i is the arm and the seed of the training; arm 0, on which the shipped settings
were tried out, is left out. Each agent is trained in the simulator made from its model (for ``pd`` the nominal arm),
with the same gains, reach and number of actions; the agent that is kept is the best in that simulator, and what is told
of it comes from motions that chose nothing. PPO is trained on all models, SAC on those of
``OFF_POLICY``; ``--agents gains`` is what ``gapscope train`` does by default. A rerun goes on within a cell at the last
round.

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

import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import inf, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from common import command_line, kept, markdown, run_missing, run_part
from generator_arms import ARMS, MOTIONS, Fed, GeneratorArm
from scipy.stats import trim_mean

from gapscope.agents.evaluation import EvaluationPlan, TrackingBench, mean_of
from gapscope.agents.models import ArmModel, read_model
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
from gapscope.arm.io.json_file import plain, read_json, write_json
from gapscope.arm.io.write_case import write_case
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.arms import SHEETS
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected, write_corrected
from gapscope.effects.residual import write_residual
from gapscope.envs.mystery_arm import HIDDEN, iiwa
from gapscope.envs.randomisation import Randomisation, draw_effects
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.residual.fit import ResidualSettings, fit_residual, from_segment
from gapscope.interface.identify import identify
from gapscope.many.batch import diagnose_path
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


ROBOTS = {"iiwa": iiwa, "panda": panda}
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
    case = load_case(folder / "case")
    effects = read_corrected(folder / MODELS["corrected"])
    corrected, body = CorrectedArm(case.arm, effects), RigidBody(case.arm)
    cutoff = position_cutoff(case.recordings)
    segments = [s for r in case.recordings for s in condition(r, cutoff)]
    parts = [from_segment(corrected, body, segment) for segment in segments]
    network, _ = fit_residual(parts, ResidualSettings())
    write_residual(network, folder / "diagnosis" / "residual.npz")
    with_network = folder / MODELS["corrected + network"]
    write_corrected(case.name, effects, with_network, "residual.npz")


# Models fed forward

ENGINE = "pybullet"
INSIDE_LOOP = tuple(MODELS)[2:]
"""Models that can stand inside the loop."""


def model_cell(robot: str, model: str, seed: int, folder: Path) -> Any:
    """Episodes of one model, and the largest stable bandwidths [Hz] of both laws."""
    arm, effects = ROBOTS[robot](), read_corrected(folder / "truth.yaml")
    tried = read_model(source(model, folder), arm)
    plan = EvaluationPlan(engines=(ENGINE,), seeds=(seed,))
    bench = TrackingBench(arm, effects, plan)
    episodes = bench.episodes(model, tried, ENGINE, seed)
    rows = plain(episodes, null_if_not_finite=True)
    margin = {"feedforward": bench.margin(tried, ENGINE)}
    if model in INSIDE_LOOP:
        inside = TrackingBench(arm, effects, replace(plan, law="computed"))
        margin["computed"] = inside.margin(tried, ENGINE)
    return {"episodes": rows, "margin": margin}


def source(model: str, folder: Path) -> str:
    """A model's name or file."""
    return str(folder / MODELS[model]) if "." in MODELS[model] else MODELS[model]


Cells = dict[tuple[str, str, int], Any]
"""What is known of a robot, a model and a seed; or of a model, an agent and a seed."""


def show_models(cells: Cells) -> None:
    """Print Markdown tables, one per robot."""
    for robot in dict.fromkeys(key[0] for key in cells):
        seeds = sorted({seed for name, _, seed in cells if name == robot})
        print(f"\n{robot}, {len(seeds)} arms\n")
        rows = []
        for model in MODELS:
            keys = [(robot, model, seed) for seed in seeds]
            found = [cells[key] for key in keys if key in cells]
            if found:
                rows.append(model_row(model, found))
        head = ("model", "joints [mrad]", "pushed [mrad]")
        print(markdown((*head, "stable to [Hz], feedforward", "computed"), rows))
        falls = []
        for seed in seeds:
            pair = [cells.get((robot, name, seed)) for name in ("nominal", "corrected")]
            if all(pair):
                nominal, corrected = (
                    float(trim_mean(errors(under([one], "none")), 0.25)) for one in pair
                )
                falls.append(f"{nominal / corrected:.1f}")
        print(f"\njoint error, nominal over corrected, by arm: {', '.join(falls)}")


def under(found: Sequence[Any], disturbance: str) -> list[dict[str, Any]]:
    """The episodes of some cells with a disturbance."""
    every = (e for cell in found for e in cell["episodes"])
    return [e for e in every if e["disturbance"] == disturbance]


def errors(episodes: Sequence[dict[str, Any]]) -> list[float]:
    """Joint errors of episodes [mrad], infinite if the arm was lost."""
    found = (e["joint_error"] for e in episodes)
    return [inf if error is None else 1e3 * error for error in found]


def with_interval(episodes: Sequence[dict[str, Any]]) -> str:
    """Interquartile mean of the joint errors [mrad] with its interval."""
    motions = [e["motion"] for e in episodes]
    mean = mean_of(errors(episodes), motions, np.random.default_rng(0))
    return f"{mean['value']:.3g} ({mean['low']:.3g}–{mean['high']:.3g})"


def model_row(model: str, found: list[Any]) -> list[str]:
    """A row of the table."""
    texts = [model, *(with_interval(under(found, x)) for x in ("none", "push"))]
    for law in ("feedforward", "computed"):
        margins = [cell["margin"][law] for cell in found if law in cell["margin"]]
        texts.append("–")
        if margins:
            low, high = min(margins), max(margins)
            texts[-1] = f"{np.mean(margins):.1f} ({low:.1f}–{high:.1f})"
    return texts


def models() -> None:
    """Work through the cells, then print the tables."""
    arguments = command_line(
        models.__doc__,
        robots="iiwa,panda",
        seeds=3,
        severity=1.5,
        out=Path("out/feedforward"),
        table=False,
    ).parse_args()
    warnings.simplefilter("ignore")
    cells = {}
    for robot, seed in product(arguments.robots.split(","), range(arguments.seeds)):
        folder = arguments.out / robot / str(seed)
        if not arguments.table:
            try:
                prepare(robot, seed, arguments.severity, folder)
            except GapscopeError as error:
                print(f"{robot} {seed}: {error}", flush=True)
                continue
        for model in MODELS:
            file = folder / f"{model.replace(' + ', '_')}_{ENGINE}.json"
            if file.is_file() or not arguments.table:
                cell = kept(file, model_cell, robot, model, seed, folder)
                cells[robot, model, seed] = cell
    show_models(cells)


# Agents on top of models

ROBOT, SEVERITY = "iiwa", 1.5
RANDOMISED = "nominal + randomisation"
TRIED = ("pd", "nominal", RANDOMISED, "identified", "corrected", "corrected + network")
OFF_POLICY = ("pd", "nominal", "corrected")
"""Models on top of which SAC and TD3 are trained; without `pd` there would be nothing to compare them with."""
GAINS = "gains"
"""PPO as `gapscope train` ships it: it changes gains, on arms with effects drawn around the model."""
AS_THEN = {"randomise": (), "count": (1, 3), "severity": (0.5, 1.5)}
"""Of the table's agents nothing was drawn around the model unless said."""
LIMIT = 1e6
"""Longest processor time of an agent [s]."""
UNSEEN = 1000
"""Seed of the first motion on which the agents are told of."""


def agent_cell(
    model: str, agent: str, seed: int, steps: int | None, arms: Path, out: Path
) -> dict[str, Any]:
    """Train and try one agent; its cell."""
    warnings.simplefilter("ignore")
    file = agent_file(model, agent, seed, out)
    folder, base = arms / ROBOT / str(seed), model.split(" + rand")[0]
    settings = read_settings("ppo")
    if agent != GAINS:
        settings = read_settings(RESIDUAL if agent == "ppo" else agent, **AS_THEN)
    settings = replace(settings, steps=steps or settings.steps, seed=seed)
    settings = settings.randomised() if model == RANDOMISED else settings
    truth = read_corrected(folder / "truth.yaml")
    task = Task.of(source(base, folder), ROBOTS[ROBOT](), truth)
    trained = Training(task, settings, file.with_suffix("")).run()
    write_agent(task, trained, file.with_suffix(""))
    return {
        "model": model,
        "agent": agent,
        "seed": seed,
        "steps": trained.curve[-1]["steps"],
        "kept": trained.curve[trained.best]["steps"],
        "curve": plain(trained.curve, null_if_not_finite=True),
        "untrained": tried(task, settings, None),
        "trained": tried(task, settings, trained.policy),
    }


def tried(
    task: Task, settings: TrainingSettings, policy: Policy | None
) -> list[dict[str, Any]]:
    """Episodes of a policy, or of none, on the hidden arm."""
    count = settings.seeds * len(settings.motions)
    env = task.trials(settings, count, hidden=True, engine=ENGINE)
    motions = held_out(settings, env.setup.space, UNSEEN)
    scores = episodes(env, policy or idle(env), motions)
    env.close()
    names = [name for name, _ in motions]
    found = plain(scores, null_if_not_finite=True)
    return [{"motion": n, **s} for n, s in zip(names, found, strict=True)]


def agent_file(model: str, agent: str, seed: int, out: Path) -> Path:
    """File of a cell; its training lies in the folder of the same name."""
    return out / ROBOT / str(seed) / f"{model.replace(' + ', '_')}_{agent}.json"


def show_agents(cells: Cells) -> None:
    """Print Markdown tables, one per agent."""
    for agent in dict.fromkeys(key[1] for key in cells):
        own = {key: value for key, value in cells.items() if key[1] == agent}
        steps = max(value["steps"] for value in own.values())
        arms = len({seed for _, _, seed in own})
        print(
            f"\n{agent.upper()}, {steps} actions, {arms} arms; joint errors in mrad\n"
        )
        rows = []
        for model in TRIED:
            found = [value for key, value in own.items() if key[0] == model]
            if not found:
                continue
            last = [value["curve"][-1]["hidden"]["joint_error"] for value in found]
            ends = ["lost" if one is None else f"{1e3 * one:.3g}" for one in last]
            texts = [model, *(spread(found, x) for x in ("untrained", "trained"))]
            after = ", ".join(str(value["kept"]) for value in found)
            rows.append([*texts, after, ", ".join(ends)])
        head = ("model", "untrained", "agent kept", "kept after", "last round")
        print(markdown(head, rows))


def spread(found: Sequence[Any], state: str) -> str:
    """Joint error [mrad] with its interval."""
    rows = [episode for value in found for episode in value[state]]
    ended = sum(e["ended"] for e in rows)
    text = with_interval(rows)
    return f"{text}, {ended} ended early" if ended else text


def on_top_of_models() -> None:
    """Work through the cells, then print the tables."""
    parser = command_line(
        on_top_of_models.__doc__,
        seeds=5,
        first=1,
        agents="ppo,sac",
        models=",".join(TRIED),
        jobs=1,
        arms=Path("out/feedforward"),
        out=Path("out/agents"),
        table=False,
        steps=int,
    )
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
    files = {agent_file(*key, arguments.out): key for key in keys}
    if arguments.table:
        files = {file: key for file, key in files.items() if file.is_file()}

    def cell(key: tuple[str, str, int]) -> dict[str, Any]:
        return agent_cell(*key, arguments.steps, arguments.arms, arguments.out)

    found = run_missing(cell, files, arguments.jobs, LIMIT)
    show_agents({(x["model"], x["agent"], x["seed"]): x for x in found})


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
        | plain(arm.measure(fed[i], i, bandwidth)._asdict(), null_if_not_finite=True)
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
        head = ["fed forward", "joint error at 1 Hz [mrad]", "at 2 Hz"]
        head += [f"at {USUAL:g} Hz", "at 8 Hz", "reward at 1 Hz", f"at {USUAL:g} Hz"]
        head += [f"bandwidth for {1e3 * WANTED:g} mrad [Hz]", "stable to [Hz]"]
        rows = []
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
            rows.append([name, *texts])
        print(markdown(head, rows))


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
    arguments = command_line(
        other_simulator.__doc__,
        arms="0,1,2",
        steps=20480,
        out=Path("out/other_simulator"),
        table=False,
        picture=Path,
    ).parse_args()
    warnings.simplefilter("ignore")
    numbers = [int(number) for number in arguments.arms.split(",")]
    arms = {}
    cells = {}
    # models first: training agents takes longest
    for name, number in product(all_fed(), numbers):
        here = arguments.out / str(number)
        file = here / f"{name.replace(' ', '_')}.json"
        if not file.is_file() and not arguments.table:
            if number not in arms:
                here.mkdir(parents=True, exist_ok=True)
                arms[number] = GeneratorArm(number)
                if not (here / "case").is_dir():
                    arms[number].write(here)
                # recorded in its simulator; from the files alone all models follow
                find_models(here)
                arms[number].open(here)
            fed = feeds(name, number, arguments.steps, arms[number], here)
            write_json(bandwidth_cell(fed, arms[number]), file)
            print(f"{ARMS[number][0]}, {name}", flush=True)
        if file.is_file():
            cells[number, name] = read_json(file, "remove it")
    show_bandwidths(cells)
    if arguments.picture is not None and cells:
        draw_bandwidths(cells, arguments.picture)


if __name__ == "__main__":
    run_part(__doc__, models, other_simulator, agents=on_top_of_models)
