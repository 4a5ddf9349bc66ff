"""The Gymnasium environment: a simulated arm with effects follows a reference motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.motions.trajectory import Limits, ReferenceMotion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs import arguments
from gapscope.envs.actions import control
from gapscope.envs.divergence import ending, title
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.episode import (
    LOOK_AHEAD,
    SUB_STEPS,
    TIME_STEP,
    Course,
    Effects,
    EpisodeOptions,
    FeedforwardModel,
    Layout,
    Setup,
    Timing,
    chosen_effects,
)
from gapscope.envs.plant import ControlledArms
from gapscope.envs.randomisation import Randomisation, checked_randomisation
from gapscope.envs.rendering import Screen
from gapscope.envs.reward import Reward, RewardParts, chosen_reward

REWARDS = tuple(f"reward_{name}" for name in RewardParts._fields)
"""Where ``info`` holds the parts of the reward."""
NEAR_STOP = 1e-3
"""A joint within this distance of its stop has come to it [rad]."""


class ArmTracking(gymnasium.Env):
    """An arm with effects, n joints, that is to follow a reference motion.

    An action is a vector of numbers in -1 .. 1, n in parts of ``torque_scale`` [N m] or 2 n factors. Observation: see
    ``gapscope.envs.episode.Layout``; reward: see ``gapscope.envs.reward.Reward``. An episode is terminated when
    the arm diverges (``info["divergence"]``) or a joint comes to its stop (``info["limit"]``), and truncated at its
    end.

    Args:
        robot: a name of ``gapscope.arm.known_robots.KNOWN_ROBOTS``, a path of a URDF, or a nominal arm.
        effects: what the simulated arm has beyond the nominal arm; records, entries as in a ``corrected.yaml``, or the
            path of one.
        engine: name of the engine that steps the simulation.
        sheet: data sheet of the nominal arm, as ``nominal:`` in a case; not with a nominal arm as ``robot``.
        action: ``residual`` (torque added to a low-gain PD with feedforward, at every step of the simulation),
            ``scale`` (2 n factors of that, see ``gapscope.envs.actions.scaled``) or ``torque`` (commanded).
        feedforward: ``none``, ``gravity`` or ``nominal``, or a model with ``series(motion)``; with ``torque`` it is
            observed only.
        simulated: the arm that is simulated instead of the nominal arm with ``effects``: identified or corrected, with
            its own inertia [kg m^2], friction [N m] and residual network [N m]. Gains, torque scale and encoders stay
            those of ``robot``.
        encoder_noise: standard deviation of the encoders' white noise before they round [rad], a number or shape (n,);
            it comes from the seed of ``reset``.
        motion: a name of ``gapscope.arm.motions.named_motions.MOTIONS``, ``random``, or a reference motion.
        posture: about which motions are drawn [rad], shape (n,).
        limits: of motions drawn: lower and upper position [rad], velocity [rad/s], acceleration [rad/s^2], each (n,).
        time_step: of the simulation [s]; sub_steps: steps of the simulation per action.
        episode_length: [s], rounded up to whole actions.
        look_ahead: how far ahead the reference is observed [s].
        action_share: torque of an action of 1 over the rated torque [1], see ``gapscope.envs.actions.rated_torque``;
            by default 0.2 for ``residual``, 1 for ``torque``.
        action_reach: instead of the share, with ``residual``: tracking error at which kp alone commands as much as an
            action of 1 [rad].
        bandwidth: of the PD loop [Hz].
        reward: its tolerance and weights.
        randomisation: effects to draw at each reset, beyond ``effects``.
        debug: put the truth, hidden from controllers, into ``info``: true motion, torque, and the effects.
        render_mode: ``rgb_array``, ``human`` or ``None``.

    Raises:
        InputError: an argument that cannot be used; says what to do.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012 (Gymnasium's form)

    def __init__(
        self,
        robot: str | Path | NominalArm = "kuka_iiwa",
        *,
        effects: Effects = None,
        engine: str | None = None,
        sheet: Mapping[str, Any] | None = None,
        action: str = "residual",
        feedforward: str | FeedforwardModel = "nominal",
        simulated: CorrectedArm | None = None,
        encoder_noise: float | Sequence[float] = 0.0,
        motion: str | ReferenceMotion = "random",
        posture: Sequence[float] | None = None,
        limits: Limits | None = None,
        time_step: float = TIME_STEP,
        sub_steps: int = SUB_STEPS,
        episode_length: float = 10.0,
        look_ahead: Sequence[float] = LOOK_AHEAD,
        action_share: float | None = None,
        action_reach: float | None = None,
        bandwidth: float = 2.0,
        reward: Reward | None = None,
        randomisation: Randomisation | EffectRanges | None = None,
        debug: bool = False,
        render_mode: str | None = None,
    ) -> None:
        self.arm = arguments.chosen_robot(robot, sheet)
        # every episode has another motion: kept results would only grow
        self.body = RigidBody(self.arm, most_bytes=0)
        n = self.arm.n_joints
        chosen_model = arguments.chosen_feedforward(feedforward)
        chosen_motion = arguments.checked_motion(motion, n)
        chosen_randomisation = checked_randomisation(randomisation)
        self._timing = timing = Timing(
            arguments.positive("time_step", time_step, "s"),
            arguments.whole("sub_steps", sub_steps),
            arguments.positive("episode_length", episode_length, "s"),
            arguments.times("look_ahead", look_ahead),
        )
        allowed = arguments.checked_limits(limits, n)
        self.space = workspace(self.body, allowed, arguments.checked_posture(posture))
        self._control = control(
            self.arm,
            self.body,
            self.space,
            action,
            arguments.positive_or_none("action_share", action_share, "1"),
            arguments.positive("bandwidth", bandwidth, "Hz"),
            arguments.positive_or_none("action_reach", action_reach, "rad"),
        )
        base = arguments.chosen_base(simulated, self.arm, effects)
        # an arm instead of the nominal one brings its own effects
        own = None if simulated is None else base.effects
        given = chosen_effects(effects, self.arm) if own is None else own
        lower, upper = self.body.position_limits()
        self.layout = Layout(n, timing.look_ahead, self._control.size)
        self.setup = Setup(
            arm=self.arm,
            body=self.body,
            scale=ArmScale.of(self.arm),
            base=base,
            encoder_noise=arguments.noise("encoder_noise", encoder_noise, n),
            space=self.space,
            control=self._control,
            timing=timing,
            feedforward=chosen_model,
            options=EpisodeOptions(chosen_motion, given, chosen_randomisation),
            reward=chosen_reward(reward),
            layout=self.layout,
            stops=(lower + NEAR_STOP, upper - NEAR_STOP),
            debug=debug,
        )
        self._plant = ControlledArms(self.setup, engine=engine)
        self._course: Course | None = None
        size = self._control.size
        self.observation_space = self.layout.space
        self.action_space = Box(-1.0, 1.0, (size,), dtype=np.float32)
        self._lowest, self._highest = -np.ones(size), np.ones(size)
        self._set_rendering(render_mode)

    def _set_rendering(self, render_mode: str | None) -> None:
        """Open a screen if one is wanted."""
        period = self._timing.period
        self.render_mode = render_mode
        self.metadata = self.metadata | {"render_fps": max(1, round(1 / period))}
        self._screen: Screen | None = None
        if render_mode is not None:
            self._screen = Screen(self.space.kinematics, render_mode, period)

    @property
    def torque_scale(self) -> np.ndarray:
        """Torque of an action of 1 [N m], shape (n,); 0 with ``scale``."""
        return self._control.scale

    @property
    def actions(self) -> int:
        """Numbers in an action."""
        return self._control.size

    @property
    def length(self) -> float:
        """Length of an episode [s]."""
        return self._timing.duration

    @property
    def period(self) -> float:
        """Time between actions [s]."""
        return self._timing.period

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """Effects of this episode, drawn ones included."""
        return self._plant.effects[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw a motion and effects, and put the arm at the motion's start.

        ``options`` may hold ``motion``, ``effects`` and ``randomisation`` for this episode, as in the constructor. The
        motion does not depend on whether effects are drawn.

        Raises:
            InputError: an option that cannot be used.
        """
        super().reset(seed=seed)
        seeds = self.np_random.integers(2**63, size=2)
        episode = self.setup.draw(options or {}, seeds)
        self._course = episode.course
        self._plant.reset(0, episode.effects, episode.course, seeds)
        self._count = 0
        self._action: np.ndarray = np.zeros(self._control.size)
        if self._screen is not None:
            self._screen.begin(title(self.arm, episode.effects), episode.course.q)
        self._show({})
        error = episode.course.q[0] - self._plant.position[0]
        return self._observation(error), self._plant.truth(
            0
        ) if self.setup.debug else {}

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out an action in -1 .. 1, shape (n,) or (2 n,); what exceeds these bounds is clipped.

        The reward for tracking is 0 in the action in which the arm diverges.

        Raises:
            InputError: an action of another shape, or with what is not a finite number.
            ResetNeeded: the episode has ended, or has not begun.
        """
        course = self._running
        action = arguments.checked_action(action, self._control.size)
        action = np.minimum(np.maximum(action, self._lowest), self._highest)
        plant = self._plant
        done = int(plant.act(np.array([self._count]), action[None])[0])
        self._count += 1
        error = course.q[self._count] - plant.position[0]
        parts = self.setup.reward(error, float(plant.load[0]), action - self._action)
        if done < self._timing.sub_steps:
            parts = parts._replace(tracking=0.0)
        self._action = action
        info: dict[str, Any] = dict(zip(REWARDS, parts, strict=True))
        info["tracking_rms"] = math.sqrt(error.dot(error) / len(error))
        info["torque_rate"] = float(plant.torque_rate[0])
        info |= plant.early_end(0, self._count - 1, done)
        if self.setup.debug:
            info |= self._plant.truth(0)
        terminated = "divergence" in info or "limit" in info
        truncated = self._count >= self._timing.actions
        observation = self._observation(error)
        self._show(info)
        if terminated or truncated:
            self._course = None
        return observation, parts.total, terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """The picture of the episode so far, uint8, shape (height, width, 3), with ``rgb_array``; else nothing."""
        return None if self._screen is None else self._screen.picture()

    def close(self) -> None:
        """Free the engine and close the window; a second call does nothing."""
        self._plant.close()
        if self._screen is not None:
            self._screen.close()

    def _observation(self, error: np.ndarray) -> np.ndarray:
        """The observation with the tracking error [rad], shape (n,)."""
        plant = self._plant
        measured = (plant.position[0], plant.velocity[0], error, self._action)
        return self.layout.assemble(measured, self._running.planned[self._count])

    def _show(self, info: dict[str, Any]) -> None:
        if self._screen is None:
            return
        plant = self._plant
        error = self._running.q[self._count] - plant.position[0]
        share = plant.torque[0] / self._control.rated
        self._screen.add(plant.q[0], error, share, ending(info))

    @property
    def _running(self) -> Course:
        if self._course is None:
            raise ResetNeeded("the episode has ended or not begun: call reset() first")
        return self._course
