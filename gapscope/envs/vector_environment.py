"""The vector environment: many arms that follow reference motions in one process, stepped together on MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import Transmission
from gapscope.envs.arguments import checked_actions, whole
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.environment import REWARDS, ArmTracking
from gapscope.envs.plant import ONE_BY_ONE, ControlledArms
from gapscope.envs.randomisation import Randomisation

MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)
"""When an episode that ended is followed by the next one."""


class VectorArmTracking(VectorEnv):
    """N environments ``ArmTracking`` on MuJoCo; each does what a single one with its seed does, bit by bit.

    Actions, observations, rewards, endings and ``info`` are those of N single environments in Gymnasium's
    ``SyncVectorEnv``. The bodies are stepped on threads; controllers, drives, friction, delays and encoders over all
    arms at once. Drawn effects change fields of a model, and no model is compiled at a reset.

    Args:
        num_envs: N.
        robot: as of ``ArmTracking``.
        autoreset_mode: ``NextStep`` (Gymnasium's default: the step after the end of an episode resets it, whatever the
            action) or ``SameStep`` (the step that ends it resets it; its last observation is
            ``info["final_obs"]``).
        threads: on which bodies are stepped; 0 for one on every processor that this process may use.
        options: the other arguments of ``ArmTracking``; ``engine`` must be ``mujoco``, and nothing is drawn.

    Raises:
        InputError: an argument that cannot be used, or an arm that cannot be stepped beside others: with a residual
            network, an elastic joint or one with play, or a motor that turns several joints.
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
        self.num_envs = whole("num_envs", num_envs)
        engine = options.pop("engine", None) or "mujoco"
        if engine != "mujoco":
            raise InputError(
                f"the vector environment runs on mujoco, not on {engine}",
                ONE_BY_ONE,
                where="engine",
            )
        if options.get("render_mode") is not None:
            raise InputError(
                "the vector environment draws nothing", ONE_BY_ONE, where="render_mode"
            )
        self._mode = _checked_mode(autoreset_mode)
        self.metadata = {"autoreset_mode": self._mode, "render_modes": []}
        one = ArmTracking(robot, engine="mujoco", **options)
        one.close()
        _check_drawn(one.setup.options.randomisation)
        if one.setup.base.residual is not None:
            raise InputError(
                "the vector environment does not step a residual network",
                ONE_BY_ONE,
                where="simulated",
            )
        self.arm, self.setup, self.layout = one.arm, one.setup, one.layout
        self.single_observation_space = one.observation_space
        self.single_action_space = one.action_space
        self.observation_space = batch_space(one.observation_space, self.num_envs)
        self.action_space = batch_space(one.action_space, self.num_envs)
        self._plant = ControlledArms(self.setup, self.num_envs, threads)
        self._rngs: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds = [-1] * self.num_envs
        self._at = np.zeros(self.num_envs, dtype=int)
        self._ended = np.ones(self.num_envs, dtype=bool)
        self._begun = False
        size = self.setup.control.size
        self._action: np.ndarray = np.zeros((self.num_envs, size))

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each environment, -1 if it was not given."""
        return tuple(self._seeds)

    @property
    def effects(self) -> tuple[tuple[AppliedEffect, ...], ...]:
        """Effects of the episode of each environment, drawn ones included."""
        return tuple(self._plant.effects)

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
        seeds = self._listed(seed)
        each = self._each(options or {})
        infos: dict[str, Any] = {}
        for number in range(self.num_envs):
            info = self._reset_one(number, seeds[number], each[number])
            infos = self._add_info(infos, info, number)
        self._begun = True
        return self._observations(self._error()), infos

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
        shape = self._action.shape
        chosen = np.clip(checked_actions(actions, shape), -1.0, 1.0)
        waiting = self._ended.copy()
        done = self._plant.act(self._at, chosen)
        self._at += 1
        error, plant = self._error(), self._plant
        parts = self.setup.reward.of_rows(error, plant.load, chosen - self._action)
        parts[0][done < self.setup.timing.sub_steps] = 0.0
        self._action = chosen
        rewards = np.asarray(parts[0] + parts[1] + parts[2])
        early = self._early_ends(done, ~waiting)
        terminated = np.zeros(self.num_envs, dtype=bool)
        terminated[list(early)] = True
        truncated = (self._at >= self.setup.timing.actions) & ~waiting
        values = dict(zip(REWARDS, parts, strict=True))
        squares = np.vecdot(error, error)
        values["tracking_rms"] = np.sqrt(squares / error.shape[1])
        values["torque_rate"] = plant.torque_rate
        ended = terminated | truncated
        now = ended if self._mode == AutoresetMode.SAME_STEP else waiting
        told = ~now
        infos = self._infos(told, values, early)
        observations = None
        if self._mode == AutoresetMode.SAME_STEP and now.any():
            observations = self._observations(error)
            infos |= self._final(now, values, early, observations)
        rewards[waiting] = 0.0
        for number in np.flatnonzero(now).tolist():
            info = self._reset_one(number, None, {})
            infos = self._add_info(infos, info, number)
        if now.any():
            error = self._error()
        self._ended = ended if self._mode == AutoresetMode.NEXT_STEP else ended & False
        return self._observations(error), rewards, terminated, truncated, infos

    def close_extras(self, **options: Any) -> None:
        """Nothing outlives the object."""

    def _reset_one(
        self, number: int, seed: int | None, options: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Begin an episode of one environment, as ``ArmTracking.reset`` does; its info."""
        rng = self._rngs[number]
        if seed is not None or rng is None:
            rng, self._seeds[number] = seeding.np_random(seed)
            self._rngs[number] = rng
        seeds = rng.integers(2**63, size=2)
        episode = self.setup.draw(options, seeds)
        self._plant.reset(number, episode.effects, episode.course, seeds)
        self._at[number], self._action[number] = 0, 0.0
        self._ended[number] = False
        return self._plant.truth(number) if self.setup.debug else {}

    def _error(self) -> np.ndarray:
        """The tracking errors [rad], shape (N, n)."""
        return self._plant.courses.position(self._at) - self._plant.position

    def _observations(self, error: np.ndarray) -> np.ndarray:
        """The observations with the tracking errors [rad], shape (N, n)."""
        plant = self._plant
        measured = (plant.position, plant.velocity, error, self._action)
        return self.layout.assemble(measured, plant.courses.planned(self._at))

    def _early_ends(
        self, done: np.ndarray, acted: np.ndarray
    ) -> dict[int, dict[str, Any]]:
        """Why episodes ended early, by environment, after the steps of an action that each has done."""
        plant, steps = self._plant, self.setup.timing.sub_steps
        lowest, highest = self.setup.stops
        stopped = ((plant.q <= lowest) | (plant.q >= highest)).any(axis=1)
        early = np.flatnonzero((stopped | (done < steps)) & acted).tolist()
        return {
            i: plant.early_end(i, int(self._at[i]) - 1, int(done[i])) for i in early
        }

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
                more = self._plant.truth(number) if self.setup.debug else {}
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

    def _listed(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        """A seed for each environment."""
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int):
            return [seed + number for number in range(self.num_envs)]
        return self._one_each("seed", seed)

    def _each(self, options: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
        """Options of a reset for each environment."""
        if "each" not in options:
            return [options] * self.num_envs
        common = {name: x for name, x in options.items() if name != "each"}
        each = self._one_each("options['each']", options["each"])
        return [common | dict(own) for own in each]

    def _one_each(self, name: str, values: Sequence[Any]) -> Sequence[Any]:
        """The values, if there is one for each environment; raises ``InputError`` if not."""
        if len(values) != self.num_envs:
            raise InputError(
                f"expected {self.num_envs}, one for each environment, got {len(values)}",
                where=name,
            )
        return values


def _checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """The mode of autoreset; raises ``InputError`` if it is none of ``MODES``."""
    names = {known.value: known for known in MODES}
    found = names.get(mode) if isinstance(mode, str) else mode
    if found not in MODES:
        raise InputError(
            f"expected {' or '.join(names)}, got {mode!r}", where="autoreset_mode"
        )
    return found


def _check_drawn(randomisation: Randomisation | EffectRanges | None) -> None:
    """Check that no effect may be drawn with which an arm cannot be stepped beside others.

    Raises:
        InputError: one may be; names it.
    """
    if randomisation is None:
        return
    ranges = isinstance(randomisation, EffectRanges)
    names = (
        [item.low.name for item in randomisation.ranges]
        if isinstance(randomisation, EffectRanges)
        else list(randomisation.names)
    )
    for name in names:
        effect = CATALOGUE[name]
        if isinstance(effect, Transmission) or effect.reach == "motor":
            raise InputError(
                f"{name} may be drawn, with which arms are not stepped together",
                ONE_BY_ONE,
                where="ranges" if ranges else "randomisation.names",
            )
