"""An agent trained in the simulator made from a model: its folder, and what is written to it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gapscope.agents.training.learner import check_installed
from gapscope.agents.training.policy import DOCUMENT, LAST, POLICY, write_agent
from gapscope.agents.training.task import Task
from gapscope.agents.training.training_loop import (
    CHECKPOINTS,
    EVENTS,
    NORMALISATION,
    Training,
    write_curve,
)
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.agents.training.tuning import tune
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import to_json, write_json
from gapscope.arm.io.locked_section import locked
from gapscope.arm.nominal import SHEET_UNITS
from gapscope.commands.inputs import read_arm
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import error_context, read_corrected
from gapscope.envs.divergence import described
from gapscope.provenance import fingerprint
from gapscope.reports.training import write_page

COMMAND, CURVE, PAGE = "command.json", "curve.csv", "learning_curve.html"
OURS = (COMMAND, CURVE, PAGE, DOCUMENT, POLICY, NORMALISATION)


def train_files(
    model: str,
    robot: str,
    effects: Path | None,
    settings: TrainingSettings,
    out: Path,
    *,
    again: bool = False,
    trials: int = 0,
    progress: Callable[[str], None] = lambda message: None,
) -> tuple[dict[str, Any], list[Path]]:
    """Train an agent on top of a model, or resume a training that was interrupted.

    Args:
        model: ``pd``, ``gravity``, ``nominal``, or the path of a ``corrected.yaml`` or ``identification.json``.
        robot: a name or URDF; or a case, whose nominal arm is taken.
        effects: file of the form of ``corrected.yaml`` with the hidden effects of the arm that the agent is tried on.
        settings: of the training.
        out: folder for the results.
        again: forget what the folder holds of an earlier training.
        trials: of a search for hyperparameters instead of a training; 0 for none.
        progress: called with a few words at each step.

    Returns:
        The content of ``agent.json`` (empty for a search), and the files.

    Raises:
        InputError: an argument or a file is at fault, or the folder is another training's.
        GapscopeError: a file cannot be written.
    """
    check_installed()
    arm = read_arm(robot)
    hidden = None if effects is None else read_corrected(effects)
    task = Task.of(model, arm, hidden)
    settings = task.settled(settings)
    task.check(settings)
    with error_context(effects, hidden or ()):
        task.hidden_arm(settings).close()
    with locked(out):
        _claim(out, _asked(task, settings, trials), again)
        if trials:
            return {}, [tune(task, settings, trials, out, progress)]
        return _train(task, settings, out, progress)


def _train(
    task: Task,
    settings: TrainingSettings,
    out: Path,
    progress: Callable[[str], None],
) -> tuple[dict[str, Any], list[Path]]:
    """Train, unless the folder holds the whole result; the content of ``agent.json``, and the files."""
    paths = [out / name for name in (POLICY, CURVE, PAGE, DOCUMENT)]
    if all(path.is_file() for path in paths):
        progress("is done already; --again trains anew")
        return json.loads((out / DOCUMENT).read_text(encoding="utf-8")), paths
    trained = Training(task, settings, out, progress).run()
    write_curve(trained.curve, out / CURVE)
    write_page(task, trained, out / PAGE)
    return write_agent(task, trained, out), paths


def _asked(task: Task, settings: TrainingSettings, trials: int) -> dict[str, Any]:
    """What a command asks for: settings, and hashes of the arm and of the model's files."""
    return {
        "model": _digest(task.name in ("pd", "gravity") and task.name, task.believed),
        "robot": _digest(None, CorrectedArm(task.arm)),
        "effects": None
        if task.hidden is None
        else [described(applied) for applied in task.hidden],
        "settings": settings.same(),
        "tune": bool(trials),
    }


def _digest(label: object, corrected: CorrectedArm) -> str:
    """Hash of an arm with effects by its content; its name and the place of its files do not matter."""
    arm, residual = corrected.arm, corrected.residual
    networks = () if residual is None else residual.networks
    return fingerprint(
        {
            "label": label,
            "urdf": arm.urdf,
            "joints": arm.joints,
            "encoder": [arm.encoder, arm.encoder_step],
            "sheet": [getattr(arm, name) for name in ("gravity", *SHEET_UNITS)],
            "effects": [described(applied) for applied in corrected.effects],
            "networks": [[x.form, x.weights, x.biases] for x in networks],
            "chosen": None if residual is None else residual.chosen,
            "scale": None if residual is None else residual.scale,
        }
    )


def _claim(out: Path, asked: dict[str, Any], again: bool) -> None:
    """Make the folder this training's.

    Raises:
        InputError: it is another's.
    """
    path = out / COMMAND
    if again:
        for name in OURS:
            (out / name).unlink(missing_ok=True)
        for name in (CHECKPOINTS, EVENTS, LAST):
            shutil.rmtree(out / name, ignore_errors=True)
        for journal in out.glob("study.log*"):
            journal.unlink()
    elif path.is_file():
        try:
            earlier = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            earlier = {}
        asked = json.loads(to_json(asked))
        if earlier == asked:
            return
        other = [name for name in asked if earlier.get(name) != asked[name]]
        raise InputError(
            f"holds a training with another {' and '.join(other)}",
            "choose another --out, or --again to replace it",
            file=out,
            where="--out",
        )
    try:
        write_json(asked, path)
    except OSError as error:
        raise GapscopeError(
            f"{path}: cannot be written ({error.strerror})", "choose another place"
        ) from None
