"""Hyperparameters by Optuna: short trainings, evaluated in the simulator alone."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from gapscope.agents.training.task import Task
from gapscope.agents.training.training_loop import Training
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.diagnosis.prepare import Progress, silent

STUDY = "study.log"
"""Journal of the trials; a search that was interrupted continues from it."""


START = {"learning_rate": 3e-4, "gamma": 0.95, "batch_size": 256}
"""Hyperparameters of the first trial that the settings do not name."""


def check_installed() -> None:
    """Check that Optuna is there; raises ``InputError`` otherwise."""
    try:
        import optuna  # noqa: F401
    except ImportError:
        raise InputError(
            "needs Optuna, which is not installed",
            "pip install 'gapscope[tune]'",
            where="--tune",
        ) from None


def tune(
    task: Task,
    settings: TrainingSettings,
    trials: int,
    folder: Path,
    progress: Progress = silent,
) -> Path:
    """Search learning rate, discount, batch size and exploration; write ``tuned.yaml``.

    A trial is a training of the settings' steps; its value is the reward of its best round in the simulator, always
    with the settings' own reward. The first trial is the settings as they are.

    Args:
        task: what to train and try on; its hidden effects are not used.
        settings: to start from.
        trials: in all, those of an earlier call on the same folder included.
        folder: for the journal and ``tuned.yaml``.
        progress: called with a few words after each trial.

    Raises:
        InputError: Optuna is not installed.
        GapscopeError: the folder cannot be written.
    """
    check_installed()
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        storage = JournalStorage(JournalFileBackend(str(folder / STUDY)))
    except OSError as error:
        raise GapscopeError(
            f"{folder}: cannot be written ({error.strerror})", "choose another place"
        ) from None
    complete = (optuna.trial.TrialState.COMPLETE,)
    study = optuna.create_study(
        study_name="tune", storage=storage, direction="maximize", load_if_exists=True
    )
    if not study.trials:
        given = {**START, **settings.hyperparameters}
        first = {name: given[name] for name in START}
        study.enqueue_trial(first | {"exploration": settings.exploration})
    finished = len(study.get_trials(deepcopy=False, states=complete))
    # a resumed search must not repeat the draws of the trials that are finished
    study.sampler = optuna.samplers.TPESampler(seed=settings.seed + finished)
    without_hidden = replace(task, hidden=None)

    def value(trial: Any) -> float:
        """Reward of the best round of one short training in the simulator; its files are removed."""
        place = folder / f"trial_{trial.number}"
        shutil.rmtree(place, ignore_errors=True)
        suggested = {
            "learning_rate": trial.suggest_float("learning_rate", 1e-4, 5e-3, log=True),
            "gamma": trial.suggest_float("gamma", 0.7, 0.99),
            "batch_size": trial.suggest_categorical("batch_size", [64, 128, 256, 512]),
            "exploration": trial.suggest_float("exploration", 0.02, 0.6, log=True),
        }
        tried = _with(settings, suggested)
        trained = Training(without_hidden, tried, place).run()
        shutil.rmtree(place, ignore_errors=True)
        reward = trained.curve[trained.best].simulator.reward
        progress(f"trial {trial.number + 1}: reward {reward:.3f}")
        return reward

    if finished < trials:
        # a trial of an interrupted search does not count
        enough = optuna.study.MaxTrialsCallback(trials, states=complete)
        study.optimize(value, callbacks=[enough])
    best = _with(settings, study.best_params)
    with atomic_write(folder / "tuned.yaml") as aside:
        aside.write_text(
            yaml.safe_dump(best.plain(), sort_keys=False), encoding="utf-8"
        )
    return folder / "tuned.yaml"


def _with(settings: TrainingSettings, found: dict[str, Any]) -> TrainingSettings:
    others = {name: value for name, value in found.items() if name != "exploration"}
    return replace(
        settings,
        exploration=found["exploration"],
        hyperparameters={**settings.hyperparameters, **others},
    )
