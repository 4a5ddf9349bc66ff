"""The command ``gapscope train``: an agent on top of a model's feedforward."""

from __future__ import annotations

from typing import Annotated, Any

from typer import Option

from gapscope.commands.options import File, NotNegative, Results, RobotOption
from gapscope.terminal import Progress, say, wrote


def train(
    model: str,
    *,
    out: Results,
    robot: RobotOption = "kuka_iiwa",
    effects: File | None = None,
    agent: Annotated[str | None, Option(metavar="NAME|FILE")] = None,
    steps: int | None = None,
    seed: NotNegative | None = None,
    engine: str | None = None,
    parallel: bool = False,
    randomise: bool = False,
    tune: Annotated[int, Option(metavar="TRIALS", min=0)] = 0,
    again: bool = False,
) -> None:
    """Train an agent on top of a model's feedforward.

    It learns in the simulator made from that model, and is tried on an arm with hidden effects.

    Args:
        model: pd, gravity, nominal, a corrected.yaml, or an identification.json
        effects: hidden effects of the arm that the agent is tried on, as corrected.yaml; training never sees them
        agent: ppo, ppo_residual, sac, td3, or a YAML file with settings; default: ppo, on pd and gravity ppo_residual
        steps: actions to train for; default: the settings'
        seed: of weights, motions and exploration
        engine: mujoco (default: all environments together) or pybullet
        parallel: step each environment in a process of its own
        randomise: draw any effects around the model in every episode, not only what its diagnosis leaves open
        tune: search hyperparameters in so many short trainings instead
        again: replace what the folder holds of an earlier training
    """
    from gapscope.agents.training.learner import check_installed
    from gapscope.agents.training.task import ROUGH, Task
    from gapscope.agents.training.training_settings import RESIDUAL, read_settings
    from gapscope.agents.training.tuning import tune as search
    from gapscope.arm.io.locked_section import locked
    from gapscope.commands.inputs import read_arm
    from gapscope.commands.training_files import claim, trained_in
    from gapscope.effects.corrected_file import error_context, read_corrected

    agent = agent or (RESIDUAL if model in ROUGH else "ppo")
    settings = read_settings(
        agent, steps=steps, seed=seed, engine=engine, parallel=parallel or None
    )
    if randomise:
        settings = settings.randomised()
    check_installed()
    content: dict[str, Any] = {}
    with Progress(model) as progress:
        hidden = None if effects is None else read_corrected(effects)
        task = Task.of(model, read_arm(robot), hidden)
        settings = task.settled(settings)
        task.check(settings)
        with error_context(effects, hidden or ()):
            task.trials(settings, 1, hidden=True).close()
        with locked(out):
            claim(out, task, settings, tune, again=again)
            if tune:
                paths = [search(task, settings, tune, out, progress)]
            else:
                content, paths = trained_in(out, task, settings, progress)
    if content:
        # which agent is kept and why, and the joint errors before and after, in the simulator and on the hidden
        # arm
        places = {
            "simulator": "in the simulator made from the model",
            "hidden": "on the hidden arm",
        }
        lines = [content["reason"], "the agent after the last round is in last/"]
        for key, place in places.items():
            states = {
                name: content[name][key] for name in ("untrained", "kept", "last")
            }
            if all(states.values()):
                texts = [
                    f"{_joint_error(score)} {name}" for name, score in states.items()
                ]
                lines.append(f"joint error {place}: {', '.join(texts)}")
        say(*lines)
    wrote(*paths)


def _joint_error(score: dict[str, Any]) -> str:
    error = score["joint_error"]
    return "not tracked to the end" if error is None else f"{1e3 * error:.3g} mrad"
