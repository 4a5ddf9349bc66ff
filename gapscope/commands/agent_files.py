"""Files of training and evaluation: options of an environment, the folder of a training, and finished cells."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

from gapscope.agents.evaluation import TrackingBench
from gapscope.agents.models import AgentModel, ArmModel, Candidate
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
from gapscope.arm.display import listing
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.atomic_write import write_text
from gapscope.arm.io.case_file import is_case, read_yaml
from gapscope.arm.io.json_file import schema, to_json, write_json
from gapscope.arm.nearest_name import check_keys, check_known
from gapscope.diagnosis.prepare import Progress
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import described
from gapscope.envs.arguments import check_values
from gapscope.envs.registration import NAME
from gapscope.provenance import KEY, PACKAGE, fingerprint, program
from gapscope.reports.training import write_page

# Arguments of the environment from a YAML file or its registered name, for ``gapscope evaluate --env``.


ALIASES = {"motion": "motions", "engines": "engine", "episode_length": "duration"}
"""Names of the environment's arguments, by those of the command."""
UNUSED = (
    "action",
    "action_share",
    "action_reach",
    "encoder_noise",
    "feedforward",
    "look_ahead",
    "sub_steps",
    "time_step",
    "posture",
    "limits",
    "reward",
    "debug",
    "render_mode",
)
"""Arguments of the environment that an evaluation ignores."""
KNOWN = (
    *schema("environment")["properties"]["file"]["properties"],
    *ALIASES,
    *UNUSED,
    "randomisation",
)
"""Keys that a file may have; the last one says what to write in its place."""


def read_environment(source: str) -> dict[str, Any]:
    """What the file of an environment says, by the options of ``gapscope evaluate``; its paths start from its folder.

    The registered name stands for a file that says nothing.

    Raises:
        InputError: no such file or name, an unknown key, or a value that a key cannot have.
    """
    path = Path(source)
    if source == NAME:
        return {}
    # neither a YAML file nor a path that exists: a name that was mistyped
    if path.suffix not in (".yaml", ".yml") and not path.exists():
        check_known("environment", source, (NAME,), where="--env")
    try:
        content = check_keys(read_yaml(path, "check the path") or {}, KNOWN)
        # an alias and the name it stands for are one key
        values = {ALIASES.get(key, key): value for key, value in content.items()}
        if len(values) < len(content):
            (key, *_) = (k for k in ALIASES if {k, ALIASES[k]} <= content.keys())
            remedy = "leave one of them out"
            raise InputError(f"says the same as {ALIASES[key]}", remedy, where=key)
        if "randomisation" in values:
            remedy = "write those to be tried as effects: FILE"
            raise InputError("an evaluation draws no effects", remedy)
        check_values(values, "environment", "file")
        place = path.parent / values.get("case", values.get("robot", ""))
        has_own = "case" in values or ("robot" in values and is_case(place))
        if ("sheet" in values and has_own) or {"case", "robot"} <= values.keys():
            remedy = "leave sheet: out, and robot: beside case:"
            raise InputError("a case has its own robot and data sheet", remedy)
    except InputError as error:
        raise error.at(path) from None
    # lists of names as the options have them, with commas
    for name in ("engine", "motions", "disturbances"):
        if isinstance(values.get(name), list):
            values[name] = ",".join(values[name])
    # what is neither there nor named like a file is a known robot
    if has_own or ("robot" in values and (place.suffix or place.exists())):
        values["robot"] = str(place)
    if "effects" in values:
        values["effects"] = path.parent / values["effects"]
    return values


# An agent trained in the simulator made from a model: its folder, and what is written to it.


COMMAND, CURVE, PAGE = "command.json", "curve.csv", "learning_curve.html"
OURS = (COMMAND, CURVE, PAGE, DOCUMENT, POLICY, NORMALISATION)


def trained_in(
    out: Path,
    task: Task,
    settings: TrainingSettings,
    progress: Progress,
) -> tuple[dict[str, Any], list[Path]]:
    """Train, or go on, unless the folder holds the whole result; the content of ``agent.json``, and the files."""
    paths = [out / name for name in (POLICY, CURVE, PAGE, DOCUMENT)]
    # the document is written last: what was interrupted lacks it
    if all(path.is_file() for path in paths):
        progress("is done already; --again trains anew")
        return json.loads((out / DOCUMENT).read_text(encoding="utf-8")), paths
    trained = Training(task, settings, out, progress).run()
    write_curve(trained.curve, out / CURVE)
    write_page(task, trained, out / PAGE)
    return write_agent(task, trained, out), paths


def _digest(label: object, corrected: CorrectedArm) -> str:
    """Hash of an arm with effects by its content; its name and the place of its files do not matter."""
    return fingerprint([label, replace(corrected, arm=replace(corrected.arm, name=""))])


def claim(
    out: Path, task: Task, settings: TrainingSettings, trials: int, *, again: bool
) -> None:
    """Make the folder this training's: of these settings, this arm and the model's files.

    Args:
        out: the folder.
        task: what is trained and tried on.
        settings: of the training.
        trials: of a search for hyperparameters instead of a training; 0 for none.
        again: forget what the folder holds of an earlier training.

    Raises:
        InputError: it is another's.
        GapscopeError: it cannot be written to.
    """
    hidden = task.hidden
    # these two have no file: their name says all
    plain = task.name in ("pd", "gravity") and task.name
    asked = {
        "model": _digest(plain, task.believed),
        "robot": _digest(None, CorrectedArm(task.arm)),
        "effects": None if hidden is None else [described(one) for one in hidden],
        "settings": settings.same(),
        "tune": bool(trials),
    }
    path = out / COMMAND
    if again:
        # all that a training writes, and nothing else that lies in the folder
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
        # as it was read: tuples are lists in JSON
        asked = json.loads(to_json(asked))
        if earlier == asked:
            return
        other = [name for name in asked if earlier.get(name) != asked[name]]
        raise InputError(
            f"holds another training, which differs in {listing(other)}",
            "choose another --out, or --again to replace it",
            file=out,
            where="--out",
        )
    write_json(asked, path)


# Finished cells of an evaluation, kept beside its results until it is whole.


FOLDER = "unfinished"
"""Folder in that of the results, which is there as long as an evaluation is not whole."""


class Cells:
    """Cells as files, each with the hash of what it was made from: program, arm, hidden effects, plan and model.

    Args:
        out: folder of the results.
        bench: the arm and the plan.
        again: forget what an earlier run has kept.

    Attributes:
        reused: how many cells were taken from an earlier run.

    Raises:
        GapscopeError: a kept cell cannot be removed.
    """

    def __init__(self, out: Path, bench: TrackingBench, again: bool = False) -> None:
        self._folder = out / FOLDER
        self.reused = 0
        # seeds and engines are in the keys: with more of them what is kept still counts
        plan = replace(bench.plan, seeds=(0,), engines=bench.plan.engines[:1])
        self._common = [
            _source(),
            fingerprint(bench.arm),
            fingerprint(bench.effects),
            fingerprint(asdict(plan)),
        ]
        if again:
            self.clear()

    def clear(self) -> None:
        """Remove what is kept, once the results are whole."""
        try:
            for file in self._folder.glob("*.json"):
                file.unlink()
            if self._folder.is_dir():
                self._folder.rmdir()
        except OSError as error:
            raise GapscopeError(
                f"{self._folder}: cannot be removed ({error.strerror})", "remove it"
            ) from None

    def __call__(
        self,
        key: tuple[str, ...],
        model: Candidate,
        compute: Callable[[], Any],
    ) -> Any:
        """What a cell holds. Numbers that are infinite are written as Python reads them."""
        # PD alone and gravity have nothing but their kind
        parts = [*self._common, *key, type(model).__name__]
        if isinstance(model, AgentModel):
            parts.append(model.digest)
            # the file of the model that it acts on may change without it
            model = model.model
            parts.append(type(model).__name__)
        if isinstance(model, ArmModel):
            parts.append(_of(model))
        digest = fingerprint(parts)
        file = self._folder / f"{digest}.json"
        try:
            kept = json.loads(file.read_text(encoding="utf-8"))
            if isinstance(kept, dict) and kept.get(KEY) == digest:
                value = kept["value"]
                self.reused += 1
                return value
        except (OSError, ValueError, KeyError):
            pass  # not kept, or cut short: made again
        value = compute()
        # an arm that diverged has infinite errors, which are kept like others
        text = to_json({KEY: digest, "cell": key, "value": value}, allow_nan=True)
        write_text(file, text)
        return value


@cache
def _of(model: ArmModel) -> str:
    return fingerprint(model.corrected)


@cache
def _source() -> str:
    """The program, its agents included, and the libraries."""
    folder = PACKAGE / "agents"
    # agents lead to no diagnosis, so that the program's hash leaves them out
    own = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*.py"))
    }
    return fingerprint([program(), own])
