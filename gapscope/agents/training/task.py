"""What an agent is trained and tried on: the simulator made from a model, what it sees, and held-out motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from gapscope.agents.evaluation import HELD_OUT, held_out_motion
from gapscope.agents.models import ArmModel, Gravity, TorqueModel, read_arm
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import complete_file, read_arrays
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.motions.named_motions import Workspace, check_motion_name
from gapscope.arm.motions.trajectory import ReferenceMotion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.compare_units import read_ranges
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.environment import ArmTracking, VectorArmTracking
from gapscope.envs.mystery_arm import HIDDEN
from gapscope.envs.randomisation import Randomisation

LARGEST = 10.0
"""What an agent sees is clipped here [1]."""
EPISODES = 6
"""Untrained episodes that the figures are taken from."""
CENTRED = ("error", "velocity", "action")
"""Quantities about zero, whose mean is left alone."""
FLOORS = {
    "position": 0.05,
    "velocity": 0.02,
    "reference": 0.05,
    "reference_rate": 0.05,
    "look_ahead": 0.005,
}
"""Least scale, in the quantity's unit; a quantity that hardly changes in training may do so elsewhere."""
OTHER_FLOOR = 0.02
"""Least scale of the other quantities."""


class Normalisation(NamedTuple):
    """z = clip((x - mean) / scale), where in x the velocity is replaced by that of the error, dq_ref - dq.

    Attributes:
        mean, scale: in the observation's units, shape (m,).
        velocity, reference_rate: first and last place of these quantities in the observation.
    """

    mean: np.ndarray
    scale: np.ndarray
    velocity: tuple[int, int]
    reference_rate: tuple[int, int]

    @classmethod
    def measured(
        cls, env: ArmTracking, seed: int, tolerance: float, episodes: int = EPISODES
    ) -> Normalisation:
        """Figures of episodes in which the agent does nothing.

        Args:
            env: the simulator.
            seed: of the episodes.
            tolerance: of the reward [rad]; errors are scaled by twice this at least.
            episodes: how many.
        """
        slices, size = env.layout.slices, env.layout.size
        velocity, rate = slices["velocity"], slices["reference_rate"]
        places = (velocity.start, velocity.stop), (rate.start, rate.stop)
        unscaled = cls(np.zeros(size), np.ones(size), *places)
        rows = []
        idle = np.zeros(env.setup.control.size)
        for number in range(episodes):
            observation, _ = env.reset(seed=seed + number)
            over = False
            while not over:
                rows.append(unscaled._features(observation))
                observation, _, terminated, truncated, _ = env.step(idle)
                over = terminated or truncated
        features = np.array(rows)
        mean = features.mean(axis=0)
        floors = {**FLOORS, "error": 2 * tolerance, "action": 1.0}
        floor = np.empty(size)
        for name, part in slices.items():
            floor[part] = floors.get(name, OTHER_FLOOR)
            if name in CENTRED:
                mean[part] = 0.0
        spread = rms(features - mean)
        return cls(mean, np.maximum(spread, floor), *places)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """What the agent sees of observations, each of shape (..., m), float32."""
        seen = (self._features(observation) - self.mean) / self.scale
        return np.minimum(np.maximum(seen, -LARGEST), LARGEST).astype(np.float32)

    def _features(self, observation: np.ndarray) -> np.ndarray:
        out = observation.astype(float)
        (a, b), (c, d) = self.velocity, self.reference_rate
        out[..., a:b] = out[..., c:d] - out[..., a:b]
        return out

    def write(self, path: Path) -> None:
        """Write as NPZ; ``path`` never holds half of it."""
        places = np.array([self.velocity, self.reference_rate])
        with atomic_write(path) as aside, aside.open("wb") as file:
            np.savez(
                file,
                mean=self.mean,
                scale=self.scale,
                places=places,
            )

    @classmethod
    def read(cls, path: Path) -> Normalisation:
        """Read the NPZ file.

        Raises:
            InputError: it is missing or not such a file.
        """
        remedy = "train the agent again"
        content = read_arrays(path, remedy)
        with complete_file(path, "a normalisation", remedy):
            velocity, rate = (tuple(int(x) for x in row) for row in content["places"])
            return cls(content["mean"], content["scale"], velocity, rate)  # type: ignore[arg-type]


ROUGH = ("pd", "gravity")
"""Models without inverse dynamics."""


class Task(NamedTuple):
    """A model, the simulator made from it, and the arm that it is to be right about.

    Agents are trained and chosen in the simulator alone; the hidden effects act on no arm but ``hidden``'s. What is
    known to be unknown about the model is drawn anew in each of its episodes: where a model is right about its
    simulator there is nothing to learn.

    Attributes:
        arm: the nominal arm; gains and torque scale are computed with it, whatever the model.
        name: of the model: ``pd``, ``gravity``, ``nominal`` or its file.
        believed: the arm with effects that the model takes the arm for; of ``pd`` and ``gravity`` the nominal one.
        hidden: what the arm that is tried has beyond the nominal arm, or ``None`` if there is no such arm.
        ranges: what the diagnosis beside the model's file leaves open of its effects, or ``None`` if there is none.
    """

    arm: NominalArm
    name: str
    believed: CorrectedArm
    hidden: tuple[AppliedEffect, ...] | None = None
    ranges: EffectRanges | None = None

    @classmethod
    def of(
        cls,
        source: str,
        arm: NominalArm,
        hidden: tuple[AppliedEffect, ...] | None = None,
    ) -> Task:
        """The task of a model by its name or file; an external force, which belongs to a recording, is left out.

        Raises:
            InputError: no such model, or one of an arm with other joints.
        """
        believed = CorrectedArm(arm) if source in ROUGH else read_arm(source, arm)
        known = believed.lasting
        ranges = None
        # the 95 % intervals of the diagnosis that wrote a corrected.yaml, if it lies beside it unchanged
        if Path(source).suffix in (".yaml", ".yml"):
            with suppress(InputError):
                ranges = read_ranges(Path(source), known, ())
        return cls(arm, source, known, hidden, ranges)

    def settled(self, settings: TrainingSettings) -> TrainingSettings:
        """The settings with what is drawn around the model, if they leave it open: what a diagnosis could find.

        Nothing is drawn so around a model of which a diagnosis says how far it may be wrong, which is drawn instead,
        nor beside PD and gravity, which leave enough to learn.
        """
        if settings.randomise is not None:
            return settings
        known = self.name in ROUGH or self.ranges is not None
        return replace(settings, randomise=() if known else HIDDEN)

    def model(self) -> TorqueModel | None:
        """The feedforward model; ``None`` is PD alone."""
        if self.name == "pd":
            return None
        return Gravity(self.arm) if self.name == "gravity" else ArmModel(self.believed)

    def check(self, settings: TrainingSettings) -> None:
        """Check that the arm can do the motions; raises ``InputError`` otherwise."""
        for name in (settings.motion, *settings.motions):
            check_motion_name(name, self.arm.n_joints)

    def simulator(
        self, settings: TrainingSettings, length: float | None = None
    ) -> ArmTracking:
        """The environment made from the model, with the settings' domain randomisation.

        Args:
            settings: of the training.
            length: of an episode [s]; by default that of training.
        """
        return ArmTracking(**self._arguments(settings, length))

    def simulators(self, settings: TrainingSettings) -> VectorArmTracking:
        """The training environments in one; an episode is followed by the next one at once."""
        arguments = self._arguments(settings, None)
        return VectorArmTracking(
            settings.environments, autoreset_mode="SameStep", **arguments
        )

    def trials(
        self, settings: TrainingSettings, count: int, hidden: bool = False, **more: Any
    ) -> VectorArmTracking:
        """``simulator``, or the arm with hidden effects, many times, with episodes as long as an evaluation.

        Args:
            settings: of the training.
            count: how many.
            hidden: whether it is the arm with hidden effects.
            more: arguments of the environment in place of the settings'.
        """
        arguments = self._arguments(settings, settings.duration, hidden)
        return VectorArmTracking(count, **arguments | more)

    def _arguments(
        self, settings: TrainingSettings, length: float | None, hidden: bool = False
    ) -> dict[str, Any]:
        """Arguments of the environment made from the model, or of the arm with hidden effects."""
        model, simulated = self.model(), self.believed
        arm: dict[str, Any] = {"effects": self.hidden or ()}
        if not hidden:
            drawn: Randomisation | EffectRanges | None = settings.randomisation
            if drawn is None and self.ranges is not None:
                drawn, names = self.ranges, self.ranges.names
                fixed = tuple(e for e in simulated.effects if e.name not in names)
                simulated = replace(simulated, effects=fixed)
            arm = {"simulated": simulated, "randomisation": drawn}
        return {
            "robot": self.arm,
            "feedforward": "none" if model is None else model,
            "action": settings.action,
            "action_reach": settings.reach,
            "bandwidth": settings.bandwidth,
            "motion": settings.motion,
            "episode_length": length or settings.episode_length,
            "reward": settings.reward,
            "engine": settings.engine,
            **arm,
        }


Policy = Callable[[np.ndarray], np.ndarray]
"""Action of an observation as the environment gives it."""


Score = dict[str, Any]
"""How an agent does on some motions, means over them.

- ``reward``: per action; actions missing because an episode ended early count as 0 [1];
- ``joint_error``: RMS over actions and joints of reference minus encoders [rad]; infinite if an episode ended early;
- ``torque_rate``: RMS over steps and joints of the change of the torque commanded [N m/s]; likewise;
- ``ended``: episodes that ended early: the arm diverged, or came to its stop; ``episodes``: how many.
"""


def held_out(
    settings: TrainingSettings, space: Workspace, first: int = 0
) -> list[tuple[str, ReferenceMotion]]:
    """Names and motions of an evaluation: those of ``gapscope evaluate``, from seeds that no training draws.

    Args:
        settings: kinds of motions, how many of each, and how long.
        space: of the arm that does them.
        first: seed of the first; motions from other seeds have chosen no agent.
    """
    return [
        (name, held_out_motion(name, seed, space, settings.duration))
        for seed in range(first, first + settings.seeds)
        for name in settings.motions
    ]


def idle(env: ArmTracking | VectorArmTracking) -> Policy:
    """The policy that does nothing."""
    size = env.setup.control.size
    return lambda observation: np.zeros((*np.shape(observation)[:-1], size))


def episodes(
    env: VectorArmTracking,
    policy: Policy,
    motions: Sequence[tuple[str, ReferenceMotion]],
) -> list[Score]:
    """A score for each motion; effects that the environment draws are the same at each call.

    Args:
        env: an environment for each motion.
        policy: gives the actions of observations in rows.
        motions: names and motions.
    """
    seeds = [HELD_OUT + number for number in range(len(motions))]
    each = [{"motion": motion} for _, motion in motions]
    observations, _ = env.reset(seed=seeds, options={"each": each})
    count = env.setup.actions
    # an action in which all episodes begin anew has no figures
    none = np.zeros(len(motions))
    rows, fallen, over = [], [], []
    for _ in range(count):
        found = env.step(policy(observations))
        observations, reward, terminated, truncated, info = found
        measures = (info.get(name, none) for name in ("tracking_rms", "torque_rate"))
        rows.append((reward, *measures))
        fallen.append(terminated)
        over.append(terminated | truncated)
    series, lengths = np.array(rows), np.argmax(over, axis=0) + 1
    scores = []
    for number, length in enumerate(lengths.tolist()):
        rewards, errors, rates = series[:length, :, number].T
        early = bool(fallen[length - 1][number])
        size = [inf, inf] if early else rms(np.array([errors, rates]), 1).tolist()
        score = {"reward": float(sum(rewards)) / count}
        score |= {"joint_error": size[0], "torque_rate": size[1]}
        scores.append(score | {"ended": int(early), "episodes": 1})
    return scores


def judge(
    env: VectorArmTracking,
    policy: Policy,
    motions: Sequence[tuple[str, ReferenceMotion]],
) -> Score:
    """The mean score over motions."""
    scores = pd.DataFrame(episodes(env, policy, motions))
    counts = scores[["ended", "episodes"]].sum()
    return {**scores.mean().to_dict(), **counts.to_dict()}
