"""Training in rounds, each seeded anew, so that resumed training is bit-identical: checkpoints, curve and events."""

from __future__ import annotations

import math
import random
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pandas as pd
import yaml
from gymnasium.spaces import Box
from gymnasium.wrappers import TransformObservation

from gapscope.agents.training.task import (
    LARGEST,
    Normalisation,
    Policy,
    Task,
    held_out,
    idle,
    judge,
)
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.display import listing
from gapscope.arm.errors import GapscopeError, InputError, extra
from gapscope.arm.input_file import complete_file, read_arrays
from gapscope.arm.io.atomic_write import atomic_write, folder_aside
from gapscope.arm.io.json_file import plain, read_json, to_json
from gapscope.diagnosis.prepare import Progress, silent

# The algorithms of stable-baselines3: made, seeded, and their state as files without pickled code.


ARRAYS = (
    "observations",
    "next_observations",
    "actions",
    "rewards",
    "dones",
    "timeouts",
)
"""Arrays of a replay buffer."""
PPO_EPSILON = 1e-5
"""Epsilon of Adam for PPO, as stable-baselines3 sets it if nothing is said of the optimiser."""


def check_installed() -> None:
    """Check that torch and stable-baselines3 are there.

    Raises:
        InputError: one of them is not.
    """
    with extra("learn", "an agent"):
        import stable_baselines3  # noqa: F401
        import torch  # noqa: F401


def make_learner(
    settings: TrainingSettings, environment: Any, events: Path | None = None
) -> Any:
    """A learner whose untrained agent does nothing: the deterministic action is exactly zero.

    Args:
        settings: of the training.
        environment: a vector environment, or one that has the spaces.
        events: folder of TensorBoard's events, if tensorboard is installed.
    """
    check_installed()
    import stable_baselines3
    import torch
    from stable_baselines3.common.logger import Logger, configure
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

    torch.set_num_threads(1)  # sums of several threads are not the same bit by bit
    seed_all(settings.seed, 0)
    kind = getattr(stable_baselines3, settings.algorithm.upper())
    if issubclass(kind, OffPolicyAlgorithm):
        kind = type(f"Gentle{kind.__name__}", (_Gentle, kind), {})
    critic = "vf" if settings.algorithm == "ppo" else "qf"
    value = settings.network
    if settings.value_network is not None:
        value = settings.value_network
    # networks are small: one call for all weights takes a fraction of the time of one for each
    adam: dict[str, Any] = {"fused": True}
    options: dict[str, Any] = {
        "policy_kwargs": {
            "net_arch": {"pi": list(settings.network), critic: list(value)},
            "optimizer_kwargs": adam,
        },
        **settings.hyperparameters,
    }
    size = environment.action_space.shape[0]
    if settings.algorithm == "ppo":
        adam["eps"] = PPO_EPSILON
        options["policy_kwargs"]["log_std_init"] = math.log(settings.exploration)
    elif settings.algorithm == "td3":
        options["action_noise"] = NormalActionNoise(
            np.zeros(size), settings.exploration * np.ones(size)
        )
    learner = kind("MlpPolicy", environment, device="cpu", **options)
    if events is not None and find_spec("tensorboard") is not None:
        learner.set_logger(configure(str(events), ["tensorboard"]))
    else:
        learner.set_logger(Logger(folder=None, output_formats=[]))
    _hush(learner, settings, torch)
    return learner


class _Gentle:
    """Explores about the policy from the first action on; uniform actions would throw the arm about."""

    def _sample_action(self, learning_starts: int, *more: Any, **options: Any) -> Any:
        return super()._sample_action(0, *more, **options)  # type: ignore[misc]


def _hush(learner: Any, settings: TrainingSettings, torch: Any) -> None:
    """Set the last layer of the policy to zero, the value of PPO to perfect tracking, and the exploration of SAC."""
    policy = learner.policy
    with torch.no_grad():
        if settings.algorithm == "ppo":
            heads = [policy.action_net]
        elif settings.algorithm == "sac":
            heads = [policy.actor.mu, policy.actor.log_std]
        else:
            heads = [policy.actor.mu[-2], policy.actor_target.mu[-2]]
        for head in heads:
            head.weight.zero_()
            head.bias.zero_()
        if settings.algorithm == "ppo":
            # perfect tracking earns 1 an action; from 0 the value's errors would drown what actions do at first
            policy.value_net.weight.zero_()
            policy.value_net.bias.fill_(1 / (1 - learner.gamma))
        if settings.algorithm == "sac":
            policy.actor.log_std.bias.fill_(math.log(settings.exploration))


def seed_all(seed: int, number: int) -> int:
    """Seed Python, numpy and torch from a seed and a round's number; returns a seed for the environments."""
    import torch

    state = np.random.SeedSequence((seed, number)).generate_state(4)
    random.seed(int(state[0]))
    np.random.seed(int(state[1]))  # stable-baselines3 draws from the global states
    torch.manual_seed(int(state[2]))
    return int(state[3] >> 1)


def write_weights(learner: Any, path: Path) -> None:
    """Write networks and optimisers as a zip of stable-baselines3 that holds tensors alone."""
    from stable_baselines3.common.save_util import recursive_getattr, save_to_zip_file

    names = learner._get_torch_save_params()[1]
    variables = {name: recursive_getattr(learner, name) for name in names}
    save_to_zip_file(
        path, params=learner.get_parameters(), pytorch_variables=variables or None
    )


def read_weights(learner: Any, path: Path) -> None:
    """Put the weights of a file into a learner.

    Raises:
        InputError: the file is missing, cut short, no policy, or of other networks.
    """
    from stable_baselines3.common.save_util import load_from_zip_file, recursive_setattr

    remedy = (
        "was it cut short? take the file from another copy, or train the agent again "
        "with --again"
    )
    with complete_file(path, "a policy of these settings", remedy):
        _, parameters, variables = load_from_zip_file(
            path, device="cpu", load_data=False
        )
        if not parameters:
            raise ValueError("it holds no networks")
        learner.set_parameters(parameters, exact_match=True, device="cpu")
    for name, value in (variables or {}).items():
        recursive_setattr(learner, f"{name}.data", value.data)


def write_replay(learner: Any, path: Path) -> None:
    """Write the replay buffer of SAC or TD3 as NPZ."""
    buffer = learner.replay_buffer
    rows = slice(None) if buffer.full else slice(0, buffer.pos)
    arrays = {name: getattr(buffer, name)[rows] for name in ARRAYS}
    np.savez(path, pos=buffer.pos, full=buffer.full, **arrays)


def read_replay(learner: Any, path: Path) -> None:
    """Put a replay buffer back.

    Raises:
        InputError: the file is missing, or no such buffer.
    """
    buffer, remedy = learner.replay_buffer, "train again with --again"
    content = read_arrays(path, remedy)
    with complete_file(path, "a replay buffer", remedy):
        for name in ARRAYS:
            getattr(buffer, name)[: len(content[name])] = content[name]
        buffer.pos, buffer.full = int(content["pos"]), bool(content["full"])


# Training in rounds, each seeded anew, so that resumed training is bit-identical: checkpoints, curve and events.


STATE = "state.json"
_REMEDY = "remove that folder to resume from the round before, if it is there, or train from the start with --again"


@contextmanager
def written_checkpoint(
    folder: Path, number: int, state: dict[str, Any]
) -> Iterator[Path]:
    """A folder to write the files of a round into; it becomes the checkpoint when the block ends without error.

    Args:
        folder: of all checkpoints; only the newest one is kept.
        number: rounds that are done.
        state: plain data, written as ``state.json``.

    Raises:
        GapscopeError: it cannot be written.
    """
    place = folder / f"round_{number:05d}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob(".*"):  # by a process that was killed
            shutil.rmtree(left)
        with folder_aside(place) as aside:
            yield aside
            text = to_json(state, allow_nan=True)
            (aside / STATE).write_text(text, encoding="utf-8")
            aside.replace(place)
        for older in folder.glob("round_*"):
            if older != place:
                shutil.rmtree(older)
    except OSError as error:
        raise GapscopeError(
            f"{place}: cannot be written ({error.strerror})",
            "choose another folder, or check the permissions of this one",
        ) from None


def read_checkpoint(folder: Path) -> tuple[Path, dict[str, Any]] | None:
    """Folder and state of the newest checkpoint, or ``None`` if there is none.

    Raises:
        InputError: its state is missing or was cut short; that of its other files is seen when they are read.
    """
    newest = max(folder.glob("round_*"), default=None)
    return None if newest is None else (newest, read_json(newest / STATE, _REMEDY))


Point = dict[str, Any]
"""Scores after some actions of training: ``steps``, actions of all environments together; the score in the simulator
that the agent is trained in, ``simulator``; and that on the arm with hidden effects, ``hidden``, or ``None``."""


def write_curve(curve: Sequence[Point], path: Path) -> None:
    """Write the curve as CSV; what is not finite is left empty.

    Columns: steps, then with ``simulator_`` and ``hidden_`` reward [1], joint_error [rad], torque_rate [N m/s], ended.
    """
    names = [name for name in curve[0]["simulator"] if name != "episodes"]
    columns = [f"{part}_{name}" for part in ("simulator", "hidden") for name in names]
    rows = pd.json_normalize(plain(curve, null_if_not_finite=True), sep="_")
    with atomic_write(path) as aside:
        rows.reindex(columns=["steps", *columns]).to_csv(aside, index=False)


CHECKPOINTS, EVENTS = "checkpoint", "tensorboard"
WEIGHTS, BEST, REPLAY, NORMALISATION = (
    "weights.zip",
    "best.zip",
    "replay.npz",
    "normalisation.npz",
)


class Trained(NamedTuple):
    """What came out of a training.

    Attributes:
        settings: of the training, none of them left open.
        curve: scores after each round, the untrained agent's first.
        best: place in the curve of the agent that is kept, the best in the simulator; 0 is the untrained one.
        normalisation: what the agent sees.
        weights, last: files with the weights of the agent that is kept, and of the last one, in the last checkpoint.
        policy: of the agent that is kept.
        stopped: whether it ended early, for want of improvement.
    """

    settings: TrainingSettings
    curve: tuple[Point, ...]
    best: int
    normalisation: Normalisation
    weights: Path
    last: Path
    policy: Policy
    stopped: bool

    @property
    def reason(self) -> str:
        """Which agent is kept, and why, in a sentence."""
        steps, total = (self.curve[k]["steps"] for k in (self.best, -1))
        kept, untrained = (self.curve[k]["simulator"] for k in (self.best, 0))
        place = f"{kept['episodes']} held-out motions in the simulator"
        if self.settings.randomise:
            place += ", each with effects drawn around the model"
        if self.best:
            return (
                f"the agent after {steps} of {total} actions is kept: it earned most on {place}, "
                f"{kept['reward']:.3f} an action; untrained {untrained['reward']:.3f}"
            )
        others = (point["simulator"]["reward"] for point in self.curve[1:])
        best = max(others, default=0.0)
        return (
            f"the untrained agent, which is the model alone, is kept: on {place} it earned {kept['reward']:.3f} an "
            f"action, and none of {len(self.curve) - 1} rounds more ({best:.3f})"
        )


def training_environments(
    task: Task, settings: TrainingSettings, normalisation: Normalisation
) -> Any:
    """The training environments for stable-baselines3: in one, or each in a process of its own."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    from gapscope.agents.training.vector_adapter import NormalisedArms

    if not settings.parallel:
        return NormalisedArms(task.simulators(settings), normalisation)

    def make() -> gymnasium.Env:
        one = task.simulator(settings)
        seen = Box(-LARGEST, LARGEST, one.observation_space.shape, np.float32)
        return TransformObservation(one, normalisation.__call__, seen)

    return SubprocVecEnv([make] * settings.environments)


class Training:
    """A training that writes its checkpoints into a folder, and continues from the newest one that is there.

    The agent that is kept is the one that earned most in the simulator made from the model, with what is drawn around
    it; the arm with hidden effects is monitored, and selects nothing.

    Args:
        task: what to train and try on.
        settings: how.
        folder: of checkpoints and TensorBoard events.
        progress: called with a few words after each round.

    Raises:
        InputError: settings that do not fit the arm, an extra that is not installed, or a checkpoint that is not whole.
    """

    def __init__(
        self,
        task: Task,
        settings: TrainingSettings,
        folder: Path,
        progress: Progress = silent,
    ) -> None:
        check_installed()
        task.check(settings)
        self._task, self._settings = task, task.settled(settings)
        self._folder, self._progress = folder, progress
        self._curve: list[Point] = []
        self._best, self._done = 0, 0

    def run(self, rounds: int | None = None) -> Trained:
        """Train to the end, or for so many rounds at most."""
        task, settings = self._task, self._settings
        one = task.simulator(settings, settings.duration)
        self._motions = held_out(settings, one.space)
        count = len(self._motions)
        self._trials = task.trials(settings, count)
        self._hidden = (
            None if task.hidden is None else task.trials(settings, count, hidden=True)
        )
        found = read_checkpoint(self._folder / CHECKPOINTS)
        vector = None
        try:
            if found is None:
                self._normalisation = Normalisation.measured(
                    one, settings.seed, settings.tolerance
                )
            else:
                self._normalisation = Normalisation.read(found[0] / NORMALISATION)
            vector = training_environments(task, settings, self._normalisation)
            self._learner = make_learner(settings, vector, self._folder / EVENTS)
            self._rate = float(self._learner.learning_rate)
            if found is None:
                self._point(idle(one))
                self._write()
            else:
                self._restore(*found)
            left = settings.rounds
            if rounds is not None:
                left = min(left, self._done + rounds)
            while self._done < left and not self._stopped:
                self._round(vector)
            return self._trained()
        finally:
            for env in (one, self._trials, self._hidden, vector):
                if env is not None:
                    env.close()

    def _round(self, vector: Any) -> None:
        settings, learner = self._settings, self._learner
        self._done += 1
        vector.seed(seed_all(settings.seed, self._done))
        learner._last_obs = None  # so that the environments are reset
        share = (self._done - 1) / max(1, settings.rounds - 1)
        rate = self._rate * (1 + (settings.final_rate - 1) * share)
        learner.lr_schedule = lambda _: rate
        left = settings.total - learner.num_timesteps
        length = min(settings.round_length, left)
        learner.learn(length, reset_num_timesteps=False, log_interval=10**9)
        self._point(self._policy)
        self._write()

    def _policy(self, observation: Any) -> Any:
        seen = self._normalisation(observation)
        return self._learner.predict(seen, deterministic=True)[0]

    def _point(self, policy: Policy) -> None:
        """Try the agent, and note whether it is the best so far."""
        simulated = judge(self._trials, policy, self._motions)
        tried = None
        if self._hidden is not None:
            tried = judge(self._hidden, policy, self._motions)
        steps = self._learner.num_timesteps
        self._curve.append({"steps": steps, "simulator": simulated, "hidden": tried})
        reward, best = simulated["reward"], self._curve[self._best]["simulator"]
        if reward > best["reward"] + self._settings.improvement:
            self._best = len(self._curve) - 1
        said = f"{steps} of {self._settings.total} steps: reward {reward:.3f}, "
        said += f"joint error {1e3 * simulated['joint_error']:.3g} mrad"
        if tried is not None:
            said += f"; on the hidden arm {1e3 * tried['joint_error']:.3g}"
        self._progress(said)

    @property
    def _stopped(self) -> bool:
        return len(self._curve) - 1 - self._best >= self._settings.patience

    def _write(self) -> None:
        """Write the checkpoint of the rounds that are done."""
        place, learner = self._folder / CHECKPOINTS, self._learner
        before = read_checkpoint(place)
        state = {
            "rounds": self._done,
            "steps": learner.num_timesteps,
            "updates": learner._n_updates,
            "best": self._best,
            "curve": self._curve,
            "settings": self._settings.same(),
        }
        with written_checkpoint(place, self._done, state) as aside:
            write_weights(learner, aside / WEIGHTS)
            self._normalisation.write(aside / NORMALISATION)
            if self._best == len(self._curve) - 1 or before is None:
                shutil.copyfile(aside / WEIGHTS, aside / BEST)
            else:
                shutil.copyfile(before[0] / BEST, aside / BEST)
            if getattr(learner, "replay_buffer", None) is not None:
                write_replay(learner, aside / REPLAY)
        # the scores beside the learner's own figures
        logger, point = learner.logger, self._curve[-1]
        for part in ("simulator", "hidden"):
            for name, value in (point[part] or {}).items():
                if math.isfinite(value):
                    logger.record(f"{part}/{name}", value)
        logger.dump(point["steps"])

    def _restore(self, place: Path, state: dict[str, Any]) -> None:
        """Go on from a checkpoint.

        Raises:
            InputError: it was made with other settings.
        """
        learner, asked = self._learner, self._settings.same()
        before = state["settings"]
        if other := [name for name in asked if before.get(name) != asked[name]]:
            raise InputError(
                f"was made with other settings: {listing(other)}",
                "choose another folder, or --again",
                file=place,
            )
        read_weights(learner, place / WEIGHTS)
        if getattr(learner, "replay_buffer", None) is not None:
            read_replay(learner, place / REPLAY)
        learner.num_timesteps, learner._n_updates = state["steps"], state["updates"]
        self._done, self._best = state["rounds"], state["best"]
        self._curve = state["curve"]
        self._progress(f"resumes after {state['steps']} steps")

    def _trained(self) -> Trained:
        found = read_checkpoint(self._folder / CHECKPOINTS)
        assert found is not None
        weights = found[0] / BEST
        read_weights(self._learner, weights)
        return Trained(
            self._settings,
            tuple(self._curve),
            self._best,
            self._normalisation,
            weights,
            found[0] / WEIGHTS,
            self._policy,
            self._stopped,
        )


# Hyperparameters by Optuna: short trainings, evaluated in the simulator alone.


STUDY = "study.log"
"""Journal of the trials; a search that was interrupted continues from it."""


START = {"learning_rate": 3e-4, "gamma": 0.95, "batch_size": 256}
"""Hyperparameters of the first trial that the settings do not name."""


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
    with extra("tune", "--tune"):
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
    without_hidden = task._replace(hidden=None)

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
        reward = trained.curve[trained.best]["simulator"]["reward"]
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
