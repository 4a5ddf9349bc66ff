"""The Gymnasium environments: simulated arms with effects that follow reference motions, one or many in a process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.motions.trajectory import Limits, ReferenceMotion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Transmission
from gapscope.envs import arguments
from gapscope.envs.actions import control
from gapscope.envs.arguments import check_values, checked_actions
from gapscope.envs.divergence import ending, title
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.episode import (
    LOOK_AHEAD,
    SUB_STEPS,
    TIME_STEP,
    Effects,
    EpisodeOptions,
    FeedforwardModel,
    Layout,
    SampledReference,
    Setup,
    Timing,
    chosen_effects,
)
from gapscope.envs.plant import ControlledArms
from gapscope.envs.randomisation import Randomisation, checked_randomisation
from gapscope.envs.reward import Reward, RewardParts

if TYPE_CHECKING:
    from gapscope.envs.rendering import Screen

REWARDS = tuple(f"reward_{name}" for name in RewardParts._fields)
"""Where ``info`` holds the parts of the reward."""
MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)
"""When an episode that ended is followed by the next one."""
NEAR_STOP = 1e-3
"""A joint within this distance of its stop has come to it [rad]."""


class Episodes(ControlledArms):
    """The running episodes of N environments, each at an action of its own; arguments as of ``ControlledArms``.

    Attributes:
        action: the actions before, shape (N, ...).
    """

    def __init__(self, setup: Setup, count: int = 1, **options: Any) -> None:
        super().__init__(setup, count, **options)
        self.action: np.ndarray = np.zeros((count, setup.control.size))
        self._acted = np.zeros(count, dtype=bool)
        # of the shape of the positions: numpy takes longer for what it must spread
        self._stops = [np.tile(x, (count, 1)) for x in setup.stops]

    def begin(
        self, number: int, options: Mapping[str, Any], rng: np.random.Generator
    ) -> SampledReference:
        """Draw a motion and effects for one environment, numbered from 0, and put its arm at the motion's start.

        Raises:
            InputError: an option that cannot be used.
        """
        seeds = rng.integers(2**63, size=2)
        course, effects = self.setup.draw(options, seeds)
        self.reset(number, effects, course, seeds)
        self.action[number], self._acted[number] = 0.0, False
        return course

    def error(self) -> np.ndarray:
        """The tracking errors [rad], shape (N, n)."""
        return self.courses.position - self.position

    def observations(self, error: np.ndarray) -> np.ndarray:
        """The observations with the tracking errors [rad], shape (N, n)."""
        measured = (self.position, self.velocity, error, self.action)
        return self.setup.layout.assemble(measured, self.courses.planned)

    def play(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, dict[str, Any], dict[int, dict[str, Any]]]:
        """Carry out an action in each environment, shape (N, ...), what exceeds -1 .. 1 clipped in place.

        Returns:
            Tracking errors [rad], shape (N, n); rewards, shape (N,); what ``info`` says of each action, by name, each
            (N,); and why episodes ended early, by number of the environment.
        """
        np.minimum(np.maximum(action, -1.0, action), 1.0, action)
        if np.count_nonzero(self._acted) < len(action):
            self._acted |= action.any(axis=1)
        self.act(action)
        error = self.error()
        parts = self.setup.reward(error, self.load, action - self.action)
        self.action = action
        # an action in which the arm diverges earns nothing for tracking
        for number in self.diverged:
            parts.tracking[number] = 0.0
        values: dict[str, Any] = dict(zip(REWARDS, parts, strict=True))
        squares = np.vecdot(error, error)
        values["tracking_rms"] = np.sqrt(squares / error.shape[1])
        values["torque_rate"] = self.torque_rate
        lowest, highest = self._stops
        stopped = (self.q <= lowest) | (self.q >= highest)
        early = set(self.diverged)
        if np.count_nonzero(stopped):
            early.update(np.flatnonzero(stopped.any(axis=1)).tolist())
        ends = {
            number: self.early_end(number, bool(self._acted[number]))
            for number in sorted(early)
        }
        return error, parts.total, values, ends


class ArmTracking(gymnasium.Env):
    """An arm with effects, n joints, that is to follow a reference motion.

    An action is a vector of numbers in -1 .. 1, n in parts of ``torque_scale`` [N m] or 2 n factors. Observation: see
    ``gapscope.envs.episode.Layout``; reward: see ``gapscope.envs.reward.Reward``. An episode is terminated when
    the arm diverges (``info["divergence"]``) or a joint comes to its stop (``info["limit"]``), and truncated at its
    end.

    Args:
        robot: a name of ``gapscope.arm.robots.KNOWN_ROBOTS``, a path of a URDF, or a nominal arm.
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
        numbers = {
            "time_step": time_step,
            "sub_steps": sub_steps,
            "episode_length": episode_length,
            "look_ahead": look_ahead,
            "action_share": action_share,
            "bandwidth": bandwidth,
            "action_reach": action_reach,
        }
        arguments.check_values(numbers, "environment", "environment")
        timing = Timing(time_step, sub_steps, episode_length, look_ahead)
        about = None if posture is None else arguments.numbers_of("posture", posture)
        allowed = arguments.checked_limits(limits, n)
        self.space = workspace(self.body, allowed, about)
        loop = action_share, bandwidth, action_reach
        own_control = control(self.arm, self.body, self.space, action, *loop)
        base = arguments.chosen_base(simulated, self.arm, effects)
        # an arm instead of the nominal one brings its own effects
        given = base.effects if simulated else chosen_effects(effects, self.arm)
        lower, upper = self.body.position_limits()
        self.layout = Layout(n, timing.look_ahead, own_control.size)
        self.setup = Setup(
            arm=self.arm,
            body=self.body,
            scale=ArmScale.of(self.arm),
            base=base,
            encoder_noise=arguments.noise("encoder_noise", encoder_noise, n),
            space=self.space,
            control=own_control,
            timing=timing,
            feedforward=chosen_model,
            options=EpisodeOptions(chosen_motion, given, chosen_randomisation),
            reward=arguments.record_of(
                *("reward", Reward() if reward is None else reward, Reward),
                "give a gapscope.envs.reward.Reward",
            ),
            layout=self.layout,
            stops=(lower + NEAR_STOP, upper - NEAR_STOP),
            debug=debug,
        )
        self._episodes = Episodes(self.setup, engine=engine)
        self._course: SampledReference | None = None
        self.observation_space = self.layout.space
        self.action_space = Box(-1.0, 1.0, (own_control.size,), dtype=np.float32)
        fps = max(1, round(1 / timing.period))
        self.render_mode = render_mode
        self.metadata = self.metadata | {"render_fps": fps}
        self._screen: Screen | None = None
        if render_mode is not None:
            # pictures alone wait for matplotlib
            from gapscope.envs.rendering import Screen

            self._screen = Screen(self.space.kinematics, render_mode, timing.period)

    @property
    def torque_scale(self) -> np.ndarray:
        """Torque of an action of 1 [N m], shape (n,); 0 with ``scale``."""
        return self.setup.control.scale

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """Effects of this episode, drawn ones included."""
        return self._episodes.effects[0]

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
        episodes = self._episodes
        self._course = course = episodes.begin(0, options or {}, self.np_random)
        if self._screen is not None:
            self._screen.begin(title(self.arm, self.effects), course.q)
        error = episodes.error()
        self._show(error[0], {})
        return episodes.observations(error)[0], episodes.truth(0)

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out an action in -1 .. 1, shape (n,) or (2 n,); what exceeds these bounds is clipped.

        The reward for tracking is 0 in the action in which the arm diverges.

        Raises:
            InputError: an action of another shape, or with what is not a finite number.
            ResetNeeded: the episode has ended, or has not begun.
        """
        if self._course is None:
            raise ResetNeeded("the episode has ended or not begun: call reset() first")
        episodes = self._episodes
        chosen = checked_actions(action, episodes.action.shape[1:])
        errors, rewards, values, early = episodes.play(chosen[None])
        info: dict[str, Any] = {name: float(x[0]) for name, x in values.items()}
        info |= early.get(0, {}) | episodes.truth(0)
        terminated = bool(early)
        truncated = bool(episodes.courses.at[0] >= self.setup.timing.actions)
        self._show(errors[0], info)
        if terminated or truncated:
            self._course = None
        observation = episodes.observations(errors)[0]
        return observation, float(rewards[0]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """The picture of the episode so far, uint8, shape (height, width, 3), with ``rgb_array``; else nothing."""
        return None if self._screen is None else self._screen.picture()

    def close(self) -> None:
        """Free the engine and close the window; a second call does nothing."""
        self._episodes.close()
        if self._screen is not None:
            self._screen.close()

    def _show(self, error: np.ndarray, info: dict[str, Any]) -> None:
        if self._screen is not None:
            episodes, rated = self._episodes, self.setup.control.rated
            share = episodes.torque[0] / rated
            self._screen.add(episodes.q[0], error, share, ending(info))


class VectorArmTracking(VectorEnv):
    """N environments ``ArmTracking``; each does what a single one with its seed does, bit by bit.

    Actions, observations, rewards, endings and ``info`` are those of N single environments in Gymnasium's
    ``SyncVectorEnv``. Controllers and encoders are computed over all arms at once. On MuJoCo the bodies are stepped on
    threads, drives, friction and delays over all arms at once, and no model is compiled at a reset; on PyBullet, and
    with motors of their own, coupled motors or stiff springs, drives and bodies are stepped one arm after the other.

    Args:
        num_envs: N.
        robot: as of ``ArmTracking``.
        autoreset_mode: ``NextStep`` (Gymnasium's default: the step after the end of an episode resets it, whatever the
            action) or ``SameStep`` (the step that ends it resets it; its last observation is
            ``info["final_obs"]``).
        threads: on which bodies are stepped; 0 for one on every processor that this process may use.
        options: the other arguments of ``ArmTracking``; ``engine`` is ``mujoco`` by default, and nothing is drawn.

    Raises:
        InputError: an argument that cannot be used.
    """

    def __init__(
        self,
        num_envs: int = 1,
        robot: str | Path | NominalArm = "kuka_iiwa",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        **options: Any,
    ) -> None:
        check_values({"num_envs": num_envs}, "environment", "environment")
        self.num_envs = num_envs
        engine = options.pop("engine", None) or "mujoco"
        if options.get("render_mode") is not None:
            raise InputError(
                "the vector environment draws nothing",
                "vectorization_mode='sync' does",
                where="render_mode",
            )
        modes = {mode.value: mode for mode in MODES}
        name = getattr(autoreset_mode, "value", autoreset_mode)
        if name not in modes:
            raise InputError(
                f"expected {' or '.join(modes)}, got {autoreset_mode!r}",
                where="autoreset_mode",
            )
        self._mode = modes[name]
        self.metadata = {"autoreset_mode": self._mode, "render_modes": []}
        one = ArmTracking(robot, engine=engine, **options)
        one.close()
        self.arm, self.setup, self.layout = one.arm, one.setup, one.layout
        self.single_observation_space = one.observation_space
        self.single_action_space = one.action_space
        self.observation_space = batch_space(one.observation_space, self.num_envs)
        self.action_space = batch_space(one.action_space, self.num_envs)
        episodes = partial(Episodes, self.setup, self.num_envs, engine=engine)
        drawn = self.setup.options.randomisation
        names: Sequence[str] = () if drawn is None else drawn.names
        # joints may come to have motors of their own, or motors turn several joints
        kinds = [CATALOGUE[name] for name in names]
        motors = any(isinstance(x, Transmission) or x.reach == "motor" for x in kinds)
        together = engine == "mujoco" and not motors
        try:
            self._episodes = episodes(together=together, threads=threads)
        except InputError:
            self._episodes = episodes()
        self._rngs: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds = [-1] * self.num_envs
        self._ended = np.ones(self.num_envs, dtype=bool)
        self._begun = False

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each environment, -1 if it was not given."""
        return tuple(self._seeds)

    @property
    def effects(self) -> tuple[tuple[AppliedEffect, ...], ...]:
        """Effects of the episode of each environment, drawn ones included."""
        return tuple(self._episodes.effects)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every environment.

        Args:
            seed: of the first environment, the others have the next numbers; or one for each.
            options: as of ``ArmTracking.reset``, for all of them; or one such dictionary for each, as the list
                ``options["each"]``.

        Raises:
            InputError: an option that cannot be used, or a list of another length.
        """
        count = self.num_envs
        seeds: Any = [None] * count if seed is None else seed
        if isinstance(seed, int):
            seeds = [seed + number for number in range(count)]
        options = dict(options or {})
        each = options.pop("each", [{}] * count)
        for name, values in (("seed", seeds), ("options['each']", each)):
            if len(values) != count:
                raise InputError(
                    f"expected {count}, one for each environment, got {len(values)}",
                    where=name,
                )
        infos: dict[str, Any] = {}
        for number in range(self.num_envs):
            own = options | dict(each[number])
            info = self._reset_one(number, seeds[number], own)
            infos = self._add_info(infos, info, number)
        self._begun = True
        return self._episodes.observations(self._episodes.error()), infos

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Carry out an action in each environment, shape (N, ...); what exceeds -1 .. 1 is clipped.

        Raises:
            InputError: actions of another shape, or with what is not a finite number.
            ResetNeeded: no episode has begun.
        """
        if not self._begun:
            raise ResetNeeded("no episode has begun: call reset() first")
        episodes, waiting = self._episodes, self._ended.copy()
        chosen = checked_actions(actions, episodes.action.shape)
        error, rewards, values, early = episodes.play(chosen)
        early = {i: why for i, why in early.items() if not waiting[i]}
        terminated = np.zeros(self.num_envs, dtype=bool)
        terminated[list(early)] = True
        truncated = (episodes.courses.at >= self.setup.timing.actions) & ~waiting
        ended = terminated | truncated
        now = ended if self._mode == AutoresetMode.SAME_STEP else waiting
        told = ~now
        infos = self._infos(told, values, early)
        observations = None
        if self._mode == AutoresetMode.SAME_STEP and now.any():
            observations = episodes.observations(error)
            infos |= self._final(now, values, early, observations)
        rewards[waiting] = 0.0
        for number in np.flatnonzero(now).tolist():
            info = self._reset_one(number, None, {})
            infos = self._add_info(infos, info, number)
        if now.any():
            error = episodes.error()
        self._ended = ended if self._mode == AutoresetMode.NEXT_STEP else ended & False
        return episodes.observations(error), rewards, terminated, truncated, infos

    def close_extras(self, **options: Any) -> None:
        """Free the engine."""
        self._episodes.close()

    def _reset_one(
        self, number: int, seed: int | None, options: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Begin an episode of one environment, as ``ArmTracking.reset`` does; its info."""
        rng = self._rngs[number]
        if seed is not None or rng is None:
            rng, self._seeds[number] = seeding.np_random(seed)
            self._rngs[number] = rng
        self._episodes.begin(number, options, rng)
        self._ended[number] = False
        return self._episodes.truth(number)

    def _infos(
        self,
        told: np.ndarray,
        values: Mapping[str, np.ndarray],
        early: Mapping[int, dict[str, Any]],
    ) -> dict[str, Any]:
        """What happened in the environments of a mask, as Gymnasium wants it."""
        infos: dict[str, Any] = {}
        if not told.any():
            return infos
        for name, value in values.items():
            infos[name], infos[f"_{name}"] = np.where(told, value, 0.0), told.copy()
        for number in np.flatnonzero(told).tolist() if self.setup.debug else early:
            if told[number]:
                info = early.get(number, {})
                more = self._episodes.truth(number)
                infos = self._add_info(infos, info | more, number)
        return infos

    def _final(
        self,
        ended: np.ndarray,
        values: Mapping[str, np.ndarray],
        early: Mapping[int, dict[str, Any]],
        observations: np.ndarray,
    ) -> dict[str, Any]:
        """Last observations and infos of the environments of a mask, whose episodes have ended."""
        last = np.full(self.num_envs, None, dtype=object)
        for number in np.flatnonzero(ended).tolist():
            last[number] = observations[number]
        info = self._infos(ended, values, early)
        found = {"final_obs": last, "final_info": info}
        return found | {f"_{name}": ended.copy() for name in found}
