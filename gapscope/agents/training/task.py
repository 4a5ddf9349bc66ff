"""What an agent is trained and tried on: the simulator made from a model, and the arm with hidden effects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from gapscope.agents.model_files import read_arm
from gapscope.agents.torque_model import ArmModel, Gravity, TorqueModel
from gapscope.agents.training.normalisation import Normalisation, Normalised
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import check_motion_name
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.fleet.unit_ranges import read_ranges
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.environment import ArmTracking, VectorArmTracking
from gapscope.envs.mystery_arm import HIDDEN
from gapscope.envs.randomisation import Randomisation

ROUGH = ("pd", "gravity")
"""Models without inverse dynamics."""


@dataclass(frozen=True)
class Task:
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
        lasting = tuple(
            e for e in believed.effects if not isinstance(e.effect, External)
        )
        known = replace(believed, effects=lasting)
        return cls(arm, source, known, hidden, _left_open(source, known))

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
        return ArmTracking(**self._simulator(settings, length))

    def simulators(self, settings: TrainingSettings) -> VectorArmTracking:
        """The training environments, stepped together; an episode is followed by the next one at once.

        Raises:
            InputError: an engine other than MuJoCo, or an arm that cannot be stepped beside others.
        """
        return VectorArmTracking(
            settings.environments,
            autoreset_mode="SameStep",
            **self._simulator(settings, None),
        )

    def trials(self, settings: TrainingSettings, count: int) -> VectorArmTracking:
        """``simulator`` many times, stepped together, with episodes as long as an evaluation; raises likewise."""
        arguments = self._simulator(settings, settings.duration)
        return VectorArmTracking(count, **arguments)

    def hidden_trials(
        self, settings: TrainingSettings, count: int
    ) -> VectorArmTracking:
        """``hidden_arm`` many times, stepped together; raises likewise."""
        return VectorArmTracking(count, **self._hidden(settings, settings.engine))

    def _simulator(
        self, settings: TrainingSettings, length: float | None
    ) -> dict[str, Any]:
        drawn: Randomisation | EffectRanges | None = settings.randomisation
        simulated = self.believed
        if drawn is None and self.ranges is not None:
            drawn = self.ranges
            names = {item.low.name for item in drawn.ranges}
            fixed = tuple(e for e in simulated.effects if e.name not in names)
            simulated = replace(simulated, effects=fixed)
        return self._arguments(
            settings, length, simulated=simulated, randomisation=drawn
        )

    def hidden_arm(
        self, settings: TrainingSettings, engine: str | None = None
    ) -> ArmTracking:
        """The environment with the hidden effects; its episodes are as long as an evaluation."""
        return ArmTracking(**self._hidden(settings, engine or settings.engine))

    def _hidden(self, settings: TrainingSettings, engine: str) -> dict[str, Any]:
        options = {"effects": self.hidden or (), "engine": engine}
        return self._arguments(settings, settings.duration, **options)

    def normalised(
        self, settings: TrainingSettings, normalisation: Normalisation
    ) -> list[Any]:
        """What makes each of the training environments, for a vector environment."""
        return [
            partial(_normalised, self, settings, normalisation)
        ] * settings.environments

    def _arguments(
        self, settings: TrainingSettings, length: float | None, **options: Any
    ) -> dict[str, Any]:
        """Arguments of an environment."""
        model = self.model()
        reach = settings.action_reach if settings.action == "residual" else None
        return {
            "robot": self.arm,
            "feedforward": "none" if model is None else model,
            "action": settings.action,
            "action_reach": reach,
            "bandwidth": settings.bandwidth,
            "motion": settings.motion,
            "episode_length": length or settings.episode_length,
            "reward": settings.reward,
            "engine": settings.engine,
            **options,
        }


def _left_open(source: str, known: CorrectedArm) -> EffectRanges | None:
    """The 95 % intervals of the diagnosis that wrote a ``corrected.yaml``, if it lies beside it unchanged."""
    path = Path(source)
    if path.suffix not in (".yaml", ".yml"):
        return None
    try:
        return read_ranges(path, known, ())
    except InputError:
        return None


def _normalised(
    task: Task, settings: TrainingSettings, normalisation: Normalisation
) -> Normalised:
    return Normalised(task.simulator(settings), normalisation)
