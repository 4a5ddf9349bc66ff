"""Episodes of the environment: a motion with its course, and effects, given or drawn; what is observed of them.

The course, reference and feedforward at every step, is computed before an episode starts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box

from gapscope.arm.control import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.named_motions import Workspace, draw_motion
from gapscope.arm.motions.trajectory import ReferenceMotion
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import error_context, read_corrected, read_entry
from gapscope.envs.actions import Control
from gapscope.envs.arguments import READ, FeedforwardModel, checked_motion, record_of
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.randomisation import (
    Randomisation,
    checked_randomisation,
    draw_effects,
)
from gapscope.envs.reward import Reward

FASTEST_OBSERVED = 50.0
"""Bound of observed velocities [rad/s]."""
FURTHEST = 4 * np.pi
"""Bound of observed positions and errors [rad]."""


class Layout:
    """Position of each quantity in the observation, a vector of float32.

    ============== =========== ===== ==================================================================
    name           length      unit  quantity
    ============== =========== ===== ==================================================================
    position       n           rad   encoders, with noise, quantised as the data sheet says
    velocity       n           rad/s estimate from them, see ``gapscope.envs.plant.ControlledArms``
    error          n           rad   reference minus encoders
    action         n or 2 n    1     the action before
    reference      n           rad   position of the reference
    reference_rate n           rad/s its velocity
    look_ahead     n per time  rad   reference at later times minus reference now, first time first
    feedforward    n           1     feedforward torque over the rated torque
    ============== =========== ===== ==================================================================

    What exceeds the bounds of the space is clipped.

    Attributes:
        slices: slice of each quantity, by name.
        measured: slice of the first four, known only once the arm has moved.
        planned: slice of the last four, known from the start.
        space: the observation space.

    Args:
        n_joints: n.
        look_ahead: times at which the reference is observed ahead [s].
        n_actions: numbers in an action; n by default.
    """

    def __init__(
        self, n_joints: int, look_ahead: Sequence[float], n_actions: int | None = None
    ) -> None:
        n = n_joints
        lengths = {
            "position": (n, FURTHEST),
            "velocity": (n, FASTEST_OBSERVED),
            "error": (n, FURTHEST),
            "action": (n if n_actions is None else n_actions, 1.0),
            "reference": (n, FURTHEST),
            "reference_rate": (n, FASTEST_OBSERVED),
            "look_ahead": (n * len(look_ahead), FURTHEST),
            "feedforward": (n, 10.0),
        }
        ends = np.cumsum([length for length, _ in lengths.values()])
        self.slices = {
            name: slice(int(end) - length, int(end))
            for (name, (length, _)), end in zip(lengths.items(), ends, strict=True)
        }
        self.measured, self.planned = (
            slice(0, int(ends[3])),
            slice(int(ends[3]), int(ends[-1])),
        )
        bound = np.repeat(
            [b for _, b in lengths.values()], [length for length, _ in lengths.values()]
        )
        self._high = bound.astype(np.float32)
        self._low = -self._high
        self.space = Box(self._low, self._high, dtype=np.float32)

    @property
    def size(self) -> int:
        """Length of the observation."""
        return self.planned.stop

    def assemble(
        self, measured: tuple[np.ndarray, ...], planned: np.ndarray
    ) -> np.ndarray:
        """The observation from the four measured quantities, and the planned ones in one row; or those of N rows."""
        row = np.concatenate((*measured, planned), axis=-1, dtype=np.float32)
        np.maximum(row, self._low, out=row)
        return np.minimum(row, self._high, out=row)


LOOK_AHEAD = (0.02, 0.1, 0.2)
"""How far ahead the reference is observed, unless said otherwise [s]."""
TIME_STEP, SUB_STEPS = 1e-3, 20
"""Step of the simulation [s] and steps of an action, unless said otherwise."""
EXTENSION = 0.25
"""A model is evaluated this far beyond the end, for delays to look ahead [s]."""


class Timing:
    """Time of an episode.

    Attributes:
        dt: step of the simulation [s].
        sub_steps: steps per action.
        actions: actions per episode.
        look_ahead: times ahead at which the reference is observed [s].
    """

    def __init__(
        self, dt: float, sub_steps: int, duration: float, look_ahead: Sequence[float]
    ) -> None:
        self.dt, self.sub_steps = dt, sub_steps
        self.actions = max(1, int(np.ceil(duration / self.period - 1e-9)))
        self.look_ahead = tuple(look_ahead)

    @property
    def period(self) -> float:
        """Time between actions [s]."""
        return self.dt * self.sub_steps

    @property
    def duration(self) -> float:
        """Duration of an episode, a whole number of periods [s]."""
        return self.period * self.actions


class SampledReference:
    """Reference and feedforward of one episode, K actions of S steps, n joints.

    Attributes:
        q: reference position when an action is chosen, and at the end [rad], shape (K + 1, n).
        dq: its velocity at the start [rad/s], shape (n,).
        planned: the planned part of the observation at these times, shape (K + 1, ...).
        step_q, step_dq: reference at each step, and at the end [rad], [rad/s], shape (K S + 1, n).
        step_torque: feedforward at these times [N m], shape (K S + 1, n).
        motion: the reference at each step, with a model ``EXTENSION`` further.

    Args:
        setup: of the environment.
        reference: the motion.
    """

    def __init__(self, setup: Setup, reference: ReferenceMotion) -> None:
        model, timing = setup.feedforward, setup.timing
        steps = timing.actions * timing.sub_steps + 1
        more = 0 if isinstance(model, str) else round(EXTENSION / timing.dt)
        t = timing.dt * np.arange(steps + more)
        self.motion = motion = Motion(
            t, reference.position(t), reference.velocity(t), reference.acceleration(t)
        )
        chosen = slice(0, steps, timing.sub_steps)
        t, self.q, dq = motion.t[chosen], motion.q[chosen], motion.dq[chosen]
        ahead = [reference.position(t + time) - self.q for time in timing.look_ahead]
        self.dq = dq[0]
        if isinstance(model, str):
            states = motion.q, motion.dq, motion.ddq
            self.step_torque = feedforward(setup.arm, setup.body, model, *states)
        else:
            self.step_torque = np.asarray(model.series(motion))[:steps]
        self.step_q, self.step_dq = motion.q, motion.dq
        torque = self.step_torque[:: timing.sub_steps] / setup.control.rated
        self.planned = np.hstack([self.q, dq, *ahead, torque])


Effects = (
    AppliedEffect
    | Mapping[str, Any]
    | Sequence[AppliedEffect | Mapping[str, Any]]
    | Path
    | str
    | None
)
"""Effects as records, as entries or a file of the form of ``corrected.yaml``, or none."""
GIVE = "give AppliedEffect records or entries as in a corrected.yaml, or the path of such a file"
"""What to do if something is no effect."""


def chosen_effects(effects: Effects, arm: NominalArm) -> tuple[AppliedEffect, ...]:
    """The effects as records.

    Raises:
        InputError: the file is at fault, what was given is no effect, or an effect acts on a joint that the arm lacks.
    """
    file = effects if isinstance(effects, (str, Path)) else None
    if file is None:
        found = _records(effects)
    elif str(file) in CATALOGUE and not Path(file).exists():
        what = f"{str(file)!r} is the name of an effect, without values"
        raise InputError(what, GIVE, where="effects")
    else:
        found = read_corrected(file)
    with error_context(file, found):
        CorrectedArm(arm, found).check()
    return found


def _records(effects: Any) -> tuple[AppliedEffect, ...]:
    """Effects that are records or entries, one or several."""
    if effects is None:
        return ()
    if isinstance(effects, Mapping) and "effects" in effects:
        if effects.get("residual"):
            raise InputError(
                "a residual network is no effect",
                f"give simulated=, and {READ}",
                where="effects",
            )
        return _records(effects["effects"])
    if isinstance(effects, (AppliedEffect, Mapping)):
        effects = (effects,)
    if not isinstance(effects, Iterable):
        raise InputError(f"{effects!r} is no effect with values", GIVE, where="effects")
    return tuple(
        read_entry(item, f"effects[{i}]")
        if isinstance(item, Mapping)
        else record_of(f"effects[{i}]", item, AppliedEffect, GIVE)
        for i, item in enumerate(effects)
    )


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
        scale: what is large on it.
        base: the arm that is simulated; its effects are not used.
        encoder_noise: standard deviation [rad], shape (n,).
        space: in which motions are drawn.
        control: how actions become torque.
        timing: of an episode.
        feedforward: a kind of feedforward, or a model.
        options: what an episode is made from if ``reset`` says nothing else.
        reward: of an action.
        layout: of the observation.
        stops: lowest and highest positions [rad] short of the joints' stops, each (n,).
        debug: whether the truth is told.
    """

    arm: NominalArm
    body: RigidBody
    scale: ArmScale
    base: CorrectedArm
    encoder_noise: np.ndarray
    space: Workspace
    control: Control
    timing: Timing
    feedforward: str | FeedforwardModel
    options: EpisodeOptions
    reward: Reward
    layout: Layout
    stops: tuple[np.ndarray, np.ndarray]
    debug: bool

    def draw(
        self, options: Mapping[str, Any], seeds: np.ndarray
    ) -> tuple[SampledReference, tuple[AppliedEffect, ...]]:
        """Course and effects of an episode, drawn ones included.

        Args:
            options: instead of the environment's own, by the names of ``EpisodeOptions``.
            seeds: one for the motion, which so does not depend on the effects drawn, and one for these.

        Raises:
            InputError: an option that cannot be used.
        """
        for name in options:
            check_known("option", name, EpisodeOptions._fields, where="reset")
        chosen = self.options._replace(**options)
        motion = checked_motion(chosen.motion, self.arm.n_joints)
        effects = chosen.effects
        if "effects" in options:
            effects = chosen_effects(options["effects"], self.arm)
        randomisation = checked_randomisation(chosen.randomisation)
        if randomisation is not None:
            rng = np.random.default_rng(seeds[1])
            drawn = draw_effects(rng, self.arm, randomisation, self.scale, effects)
            effects = (*effects, *drawn)
        if isinstance(motion, str):
            rng = np.random.default_rng(seeds[0])
            motion = draw_motion(motion, rng, self.space, self.timing.duration)
        return SampledReference(self, motion), effects
