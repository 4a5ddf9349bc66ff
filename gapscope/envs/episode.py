"""Episodes of the environment: a motion with its course, and effects, given or drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import Workspace, draw_motion
from gapscope.arm.motions.trajectory import ReferenceMotion
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.actions import Control
from gapscope.envs.arguments import checked_motion
from gapscope.envs.course import Course, FeedforwardModel, Timing
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.given_effects import chosen_effects
from gapscope.envs.observation import Layout
from gapscope.envs.randomisation import (
    Randomisation,
    checked_randomisation,
    draw_effects,
)
from gapscope.envs.reward import Reward


class EpisodeOptions(NamedTuple):
    """What an episode is made from; the options of ``reset`` have these names.

    Attributes:
        motion: a reference motion, or the name of a kind of motion to draw.
        effects: what the simulated arm has beyond the nominal arm.
        randomisation: effects to draw beyond them, or ``None``.
    """

    motion: str | ReferenceMotion
    effects: tuple[AppliedEffect, ...]
    randomisation: Randomisation | EffectRanges | None


class Setup(NamedTuple):
    """What all episodes of an environment share.

    Attributes:
        arm, body: the nominal arm and its rigid bodies.
        base: the arm that is simulated; its effects are not used.
        encoder_noise: standard deviation [rad], shape (n,).
        effects: of episodes for which none are drawn or given.
        control: how actions become torque.
        timing: of an episode.
        source: makes the episodes.
        reward: of an action.
        layout: of the observation.
        stops: lowest and highest positions [rad] short of the joints' stops, each (n,).
        debug: whether the truth is told.
    """

    arm: NominalArm
    body: RigidBody
    base: CorrectedArm
    encoder_noise: np.ndarray
    effects: tuple[AppliedEffect, ...]
    control: Control
    timing: Timing
    source: EpisodeSource
    reward: Reward
    layout: Layout
    stops: tuple[np.ndarray, np.ndarray]
    debug: bool


class EpisodePlan(NamedTuple):
    """One episode.

    Attributes:
        course: reference and feedforward.
        effects: of the simulated arm, drawn ones included.
    """

    course: Course
    effects: tuple[AppliedEffect, ...]


class EpisodeSource:
    """Makes episodes of an environment.

    Args:
        arm, body: the nominal arm and its rigid bodies.
        space: in which motions are drawn.
        timing: of an episode.
        control: how actions become torque.
        feedforward: a kind of feedforward, or a model.
        options: what an episode is made from if ``reset`` says nothing else.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        space: Workspace,
        timing: Timing,
        control: Control,
        feedforward: str | FeedforwardModel,
        options: EpisodeOptions,
    ) -> None:
        self._arm, self._body, self._space = arm, body, space
        self._timing, self._control = timing, control
        self._feedforward, self._options = feedforward, options
        self._scale = ArmScale.of(arm)

    @property
    def randomisation(self) -> Randomisation | EffectRanges | None:
        """What is drawn if ``reset`` says nothing else."""
        return self._options.randomisation

    def draw(self, options: Mapping[str, Any], seeds: np.ndarray) -> EpisodePlan:
        """An episode.

        Args:
            options: instead of the environment's own, by the names of ``EpisodeOptions``.
            seeds: one for the motion, which so does not depend on the effects drawn, and one for these.

        Raises:
            InputError: an option that cannot be used.
        """
        chosen = self._chosen(options)
        effects = chosen.effects
        if chosen.randomisation is not None:
            rng = np.random.default_rng(seeds[1])
            drawn = draw_effects(
                rng, self._arm, chosen.randomisation, self._scale, effects
            )
            effects = (*effects, *drawn)
        motion = chosen.motion
        if isinstance(motion, str):
            rng = np.random.default_rng(seeds[0])
            motion = draw_motion(motion, rng, self._space, self._timing.duration)
        course = Course(
            self._arm,
            self._body,
            self._feedforward,
            motion,
            self._timing,
            self._control,
        )
        return EpisodePlan(course, effects)

    def _chosen(self, options: Mapping[str, Any]) -> EpisodeOptions:
        """The options of one episode, checked."""
        default = self._options
        motion = checked_motion(
            options.get("motion", default.motion), self._arm.n_joints
        )
        effects = default.effects
        if "effects" in options:
            effects = chosen_effects(options["effects"], self._arm)
        randomisation = checked_randomisation(
            options.get("randomisation", default.randomisation)
        )
        for name in options:
            check_known("option", name, EpisodeOptions._fields, where="reset")
        return EpisodeOptions(motion, effects, randomisation)
