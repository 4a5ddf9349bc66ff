"""The Gymnasium environments: simulated arms with effects that follow reference motions, one or many in a process."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy import add, maximum, minimum, multiply, subtract

from gapscope.arm.control import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import common_unit, joint_unit
from gapscope.arm.motions.named_motions import Workspace, draw_motion, workspace
from gapscope.arm.motions.trajectory import Limits, ReferenceMotion, motion_of
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.velocity_filter import VelocityFilter, filter_gains
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import (
    described,
    error_context,
    read_corrected,
    read_entry,
)
from gapscope.effects.effect import Transmission
from gapscope.envs import arguments
from gapscope.envs.actions import Control, Gains, control, scaled
from gapscope.envs.arguments import (
    READ,
    FeedforwardModel,
    check_values,
    checked_actions,
    checked_motion,
    record_of,
)
from gapscope.envs.drive.arm_drive import nominal_body
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.position_controller import (
    SAFE,
    VELOCITY_DAMPING,
    cutoff,
    largest_stable,
    pd_loop,
)
from gapscope.envs.randomisation import (
    Randomisation,
    checked_randomisation,
    draw_effects,
)
from gapscope.envs.reward import Reward, RewardParts
from gapscope.envs.simulated_arm import (
    FASTEST_OBSERVED,
    NetworkTorque,
    SimulatedArm,
    fastest,
)

if TYPE_CHECKING:
    from gapscope.envs.rendering import Screen


# An episode: a motion with its course, reference and feedforward at every step, and effects, given or drawn; what is
# observed of it.


FURTHEST = 4 * np.pi
"""Bound of observed positions and errors [rad]."""


class Layout:
    """Position of each quantity in the observation, a vector of float32.

    ============== =========== ===== ==================================================================
    name           length      unit  quantity
    ============== =========== ===== ==================================================================
    position       n           rad   encoders, with noise, quantised as the data sheet says
    velocity       n           rad/s estimate from them, see ``gapscope.envs.environment.ControlledArms``
    error          n           rad   reference minus encoders
    action         n, 2 n or 1 1     the action before
    reference      n           rad   position of the reference
    reference_rate n           rad/s its velocity
    look_ahead     n per time  rad   reference at later times minus reference now, first time first
    feedforward    n           1     feedforward torque over the rated torque
    ============== =========== ===== ==================================================================

    What exceeds the bounds of the space is clipped.

    Attributes:
        slices: slice of each quantity, by name.
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
        # in the order of the observation: four are measured, four planned
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
        self.planned = slice(int(ends[3]), int(ends[-1]))
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
        # in place: one is made at every action, of all arms at once
        np.maximum(row, self._low, out=row)
        return np.minimum(row, self._high, out=row)


LOOK_AHEAD = (0.02, 0.1, 0.2)
"""How far ahead the reference is observed, unless said otherwise [s]."""
TIME_STEP, SUB_STEPS = 1e-3, 20
"""Step of the simulation [s] and steps of an action, unless said otherwise."""
EXTENSION = 0.25
"""A model is evaluated this far beyond the end, for delays to look ahead [s]."""


class SampledReference:
    """Reference and feedforward of one episode, K actions of S steps, n joints.

    Attributes:
        q: reference position when an action is chosen, and at the end [rad], shape (K + 1, n).
        dq: its velocity at the start [rad/s], shape (n,).
        planned: the planned part of the observation at these times, and once more at the end, shape (K + 2, ...): an
            episode that is over stands still for the action in which it waits for the next one.
        steps: reference [rad] and feedforward [N m] at each step, likewise, shape (2, (K + 1) S + 1, n).
        motion: the reference at each step, with a model ``EXTENSION`` further.

    Args:
        setup: of the environment.
        reference: the motion.
    """

    def __init__(self, setup: Setup, reference: ReferenceMotion) -> None:
        model = setup.feedforward
        steps = setup.actions * setup.sub_steps + 1
        # feedforward by name looks at one state, and at nothing beyond the end
        more = 0 if isinstance(model, str) else round(EXTENSION / setup.dt)
        t = setup.dt * np.arange(steps + more)
        self.motion = motion = motion_of(reference, t)
        chosen = slice(0, steps, setup.sub_steps)
        t, self.q, dq = motion.t[chosen], motion.q[chosen], motion.dq[chosen]
        # relative to the reference now, as the error is relative to it
        ahead = [reference.position(t + time) - self.q for time in setup.look_ahead]
        self.dq = dq[0]
        if isinstance(model, str):
            states = motion.q, motion.dq, motion.ddq
            torque = feedforward(setup.arm, setup.body, model, *states)
        else:
            # a model may look ahead, so that it is given more than the episode
            torque = np.asarray(model.series(motion))[:steps]
        row = [self.q, dq, *ahead, torque[chosen] / setup.control.rated]
        self.planned = np.pad(np.hstack(row), ((0, 1), (0, 0)), "edge")
        series = np.stack([motion.q[:steps], torque])
        waiting = ((0, 0), (0, setup.sub_steps), (0, 0))
        self.steps = np.pad(series, waiting, "edge")


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
    # a name without values is the likelier mistake than a file that is missing
    elif str(file) in CATALOGUE and not Path(file).exists():
        what = f"{str(file)!r} is the name of an effect, without values"
        raise InputError(what, GIVE, where="effects")
    else:
        found = read_corrected(file)
    # a joint that the arm lacks is then an error of the file, with its place
    with error_context(file, found):
        CorrectedArm(arm, found).check()
    return found


def _records(effects: Any) -> tuple[AppliedEffect, ...]:
    """Effects that are records or entries, one or several."""
    if effects is None:
        return ()
    # the content of a whole file
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
        dt: step of the simulation [s].
        sub_steps: steps per action.
        actions: actions per episode.
        look_ahead: times ahead at which the reference is observed [s].
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
    dt: float
    sub_steps: int
    actions: int
    look_ahead: tuple[float, ...]
    feedforward: str | FeedforwardModel
    options: EpisodeOptions
    reward: Reward
    layout: Layout
    stops: tuple[np.ndarray, np.ndarray]
    debug: bool

    @property
    def period(self) -> float:
        """Time between actions [s]."""
        return self.dt * self.sub_steps

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
        # those of the constructor have been checked there
        if "effects" in options:
            effects = chosen_effects(options["effects"], self.arm)
        randomisation = checked_randomisation(chosen.randomisation)
        if randomisation is not None:
            rng = np.random.default_rng(seeds[1])
            drawn = draw_effects(rng, self.arm, randomisation, self.scale, effects)
            effects = (*effects, *drawn)
        if isinstance(motion, str):
            rng = np.random.default_rng(seeds[0])
            duration = self.period * self.actions
            motion = draw_motion(motion, rng, self.space, duration)
        return SampledReference(self, motion), effects


# How episodes end before their time, noticed at once and explained.


SMALLER = {
    "residual": "a smaller action_share or action_reach",
    "scale": "smaller actions",
    "gains": "smaller actions",
    "torque": "a smaller action_share",
}
"""What makes an action of 1 less, by kind of action."""


# The plant that agents act on: simulated arms with encoders, velocity estimates and, if wanted, PD loops; one
# environment is one of N.


SENSOR_PERIOD = 10e-3
"""The encoders are read at least this often [s], and at every step if a PD loop runs."""
SLOW = FASTEST_OBSERVED**2
"""Sum of squares of velocities of which none exceeds what is observed [rad^2/s^2]."""


def steps_between_readings(control: Control, dt: float, steps: int) -> int:
    """Steps of ``dt`` [s] between readings of the encoders: as many as fit, and divide the ``steps`` of an action."""
    fits = 1 if control.gains is not None else max(1, int(SENSOR_PERIOD / dt + 1e-9))
    return max(x for x in range(1, fits + 1) if steps % x == 0)


class VelocityFilters:
    """``VelocityFilter`` of N arms, n joints.

    Args:
        rate: sampling rate [Hz].
        shape: (N, n).
    """

    def __init__(self, rate: float, shape: tuple[int, int]) -> None:
        self._how = rate, cutoff(rate), VELOCITY_DAMPING
        self._gains = np.array(filter_gains(*self._how))
        self._past = np.zeros((shape[0], 5, shape[1]))
        self._newest = self._past[:, 0]
        # one arm alone takes a shorter way
        self._alone: VelocityFilter | None = None

    def put(self, number: int, position: np.ndarray, velocity: np.ndarray) -> None:
        """Start an arm at a position [rad], until which it had a velocity [rad/s], each (n,)."""
        one = VelocityFilter(self._how, position, velocity)
        self._past[number] = one.past
        self._alone = one if len(self._past) == 1 else None

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Filtered velocities [rad/s] for the next positions q [rad], (N n,)."""
        if self._alone is not None:
            return self._alone(q)
        past = self._past
        self._newest[...] = q.reshape(self._newest.shape)
        # a product for each arm: a single large one would round differently
        velocity: np.ndarray = np.matmul(self._gains, past)
        past[:, 1:] = past[:, :-1]
        past[:, 3] = velocity
        return velocity.ravel()


class Episodes:
    """The running episodes of N environments: simulated arms with effects under their controllers, n joints.

    If PD loops run, the tracking error is differentiated and not the position: dq = dq_ref - D(q_ref - q), so that the
    differentiator's lag is not treated as an error. Otherwise dq = D(q).

    Args:
        setup: of the environments.
        count: N.
        together: whether the arms are stepped by one simulator; otherwise each has one of its own.
        engine, threads: as of ``gapscope.envs.simulated_arm.SimulatedArm``.

    Attributes:
        position: as the encoders give it, quantised as the data sheet says [rad], shape (N, n).
        velocity: estimate from the encoders [rad/s], shape (N, n).
        torque: commanded in the last step [N m], shape (N, n).
        q, dq, applied: true motion [rad], [rad/s] and torque [N m] after an action, shape (N, n).
        torque_rate: RMS over joints and steps of the last action of the change of the torque commanded [N m/s], (N,).
        load: mean of (commanded / rated torque)^2 over joints and steps of the last action [1], (N,); of an action in
            which an arm diverged, both are over its steps until then.
        at: number of the next action of each, (N,).
        planned: the planned part of the observation then, (N, ...).
        diverged: by number the arms that diverged in the last action: steps of it done until then, and what they had.
        action: the actions before, shape (N, ...).

    Raises:
        InputError: an engine that is not there, or arms that cannot be stepped together.
    """

    def __init__(
        self,
        setup: Setup,
        count: int = 1,
        *,
        engine: str | None = None,
        together: bool = False,
        threads: int = 0,
    ) -> None:
        self.setup, self._control = setup, setup.control
        nominal = nominal_body(setup.base.arm)
        self._each = count if together else 1
        self._simulators = [
            SimulatedArm(
                setup.base.arm,
                setup.options.effects,
                setup.dt,
                self._each,
                engine=engine,
                # encoders are those of the robot, whatever arm is simulated in its place
                encoder_step=setup.arm.encoder_step or 0.0,
                encoder_noise=setup.encoder_noise,
                nominal=nominal,
                threads=threads,
            )
            for _ in range(count // self._each)
        ]
        self._networks: dict[int, NetworkTorque] = {}
        self._chunk = steps_between_readings(setup.control, setup.dt, setup.sub_steps)
        rate = 1.0 / (setup.dt * self._chunk)
        shape = (count, setup.arm.n_joints)
        self._estimate = VelocityFilters(rate, shape)
        self.at: np.ndarray = np.zeros(count, dtype=int)
        self.planned = np.zeros((count, setup.layout.size - setup.layout.planned.start))
        # views, which change with the rows of the planned part
        n = shape[1]
        self._reference, self._rate = self.planned[:, :n], self.planned[:, n : 2 * n]
        self._courses: dict[int, SampledReference] = {}
        self._home = np.zeros(shape)
        self.position, self.velocity, self.torque = np.zeros((3, *shape))
        self.q, self.dq, self.applied = np.zeros((3, *shape))
        self.load, self.torque_rate = np.zeros((2, count))
        self.diverged: dict[int, tuple[int, dict[str, np.ndarray]]] = {}
        # of the joints of all arms: numpy takes longer for what it must spread
        control = setup.control
        self._gains = control.gains and Gains(
            *(np.tile(gain, count) for gain in control.gains)
        )
        self._limit = np.tile(control.limit, count)
        self._scale, self._rated = (
            np.tile(x, (count, 1)) for x in (control.scale, control.rated)
        )
        self._lowest = -self._limit
        self._error, self._work = np.zeros((2, self._limit.size))
        self._series = np.zeros((2, count, setup.sub_steps, shape[1]))
        self.action: np.ndarray = np.zeros((count, setup.control.size))
        self._acted = np.zeros(count, dtype=bool)
        # of the shape of the positions: numpy takes longer for what it must spread
        self._stops = [np.tile(x, (count, 1)) for x in setup.stops]

    @property
    def effects(self) -> list[tuple[AppliedEffect, ...]]:
        """Effects of each arm beyond the base."""
        return [own for simulator in self._simulators for own in simulator.effects]

    def close(self) -> None:
        """Free the engine."""
        for simulator in self._simulators:
            simulator.close()

    def _simulator(self, number: int) -> tuple[SimulatedArm, int]:
        """The simulator of an arm, and the arm's number in it."""
        return self._simulators[number // self._each], number % self._each

    def _joined(self, values: Iterable[np.ndarray]) -> np.ndarray:
        """Values of each simulator as those of all arms, (N n,)."""
        own = list(values)
        return own[0] if len(own) == 1 else np.concatenate(own)

    def _state(self, name: str) -> np.ndarray:
        """An attribute of the simulators, by arms, (N, n)."""
        values = self._joined(getattr(one, name) for one in self._simulators)
        return values.reshape(self.action.shape[0], -1)

    def begin(
        self, number: int, options: Mapping[str, Any], rng: np.random.Generator
    ) -> SampledReference:
        """Draw a motion and effects for one environment, numbered from 0, and put its arm at the motion's start.

        Raises:
            InputError: an option that cannot be used, or an effect that cannot be simulated, or not beside other arms.
        """
        # two numbers whatever is drawn from them: later episodes stay the same
        seed = rng.integers(2**63, size=2)
        course, effects = self.setup.draw(options, seed)
        simulator, place = self._simulator(number)
        simulator.put(effects, place)
        # a stream of its own: noise does not depend on the motion or the effects drawn
        simulator.rngs[place] = np.random.default_rng(seed)
        self._courses[number] = course
        self.at[number], self.planned[number] = 0, course.planned[0]
        start, still = course.q[0], np.zeros(len(course.dq))
        # by the encoders: with a zero that is off the arm itself stands elsewhere
        simulator.start(start, course.dq, number=place)
        self._home[number] = self.q[number] = self._state("q")[number]
        moving = self._control.gains is None
        # a PD loop differentiates the tracking error, which is zero at the start
        first = (start, course.dq) if moving else (still, still)
        self._estimate.put(number, *first)
        self.position[number] = simulator.encoders(place)
        self.velocity[number] = course.dq
        self.torque[number] = course.steps[1, 0]
        self.dq[number], self.applied[number] = course.dq, 0.0
        self.load[number] = self.torque_rate[number] = 0.0
        if self.setup.base.residual is not None:
            # what a network is told of the load depends on the effects of this episode
            having = replace(self.setup.base, effects=effects)
            steps = self.setup.sub_steps
            self._networks[number] = NetworkTorque(having, course.motion, steps)
        self.action[number], self._acted[number] = 0.0, False
        return course

    def truth(self, number: int) -> dict[str, Any]:
        """True motion [rad], [rad/s], torque [N m] and effects of an arm if they are told; hidden from controllers."""
        if not self.setup.debug:
            return {}
        return {
            "q_true": self.q[number].copy(),
            "dq_true": self.dq[number].copy(),
            "torque_commanded": self.torque[number].copy(),
            "torque_applied": self.applied[number].copy(),
            "effects": [described(applied) for applied in self.effects[number]],
        }

    def _early_end(self, number: int, stopped: np.ndarray) -> dict[str, Any]:
        """Why the episode of an arm ends early after the last action; ``stopped``: mask of the joints at their stop.

        Of a divergence the ``message`` tells the causes, the most likely first, each with what to change.
        """
        setup, q, dq = self.setup, self.position[number], self.dq[number]
        arm, control, dt = setup.arm, setup.control, setup.dt
        if number not in self.diverged:
            joint = int(stopped.argmax())
            unit = joint_unit("rad", arm.sliding[joint])
            name, read = arm.joints[joint], f"{q[joint]:.4g} {unit}"
            return {
                "limit": f"joint {joint + 1} ({name}) came to its stop; its encoder reads {read}"
            }
        # the course has gone on already: it was the action before
        before = int(self.at[number] - 1) * setup.sub_steps
        joint, time = fastest(dq), float((before + self.diverged[number][0]) * dt)
        acted = bool(self._acted[number])
        causes: list[str] = []
        gains = control.gains
        if gains is not None:
            # of the nominal arm, for which gains are made: effects are another cause
            mass = setup.body.mass_matrix(q) + np.diag(arm.armature)

            def works(step: float) -> bool:
                return pd_loop(gains, step).stable(mass, arm.viscous)

            if not works(dt):
                longest = largest_stable(works, dt)
                lower = SAFE * pd_loop(gains, dt).stable_share([mass], arm.viscous)
                below = f"bandwidth below {lower:.2g} of what it is"
                # none is stable: then no number is advised
                ways = [f"time_step below {0.5 * longest:.2g} s"] * (longest > 0)
                ways.append(below if lower > 0 else "a lower bandwidth")
                causes.append(
                    f"too large a step or gains: the PD loop is unstable at {dt:.3g} s; {', or '.join(ways)}"
                )
        if not np.isfinite(control.limit[joint]):
            causes.append(
                f"no torque limit: give sheet={{'torque_limit': [...]}} in {common_unit('N m', arm.sliding)}, "
                "one number per joint"
            )
        if arm.viscous[joint] == 0:
            causes.append(
                f"no damping: joint {joint + 1} has no viscous friction; give sheet={{'viscous': [...]}} in "
                f"{common_unit('N m s/rad', arm.sliding)}"
            )
        # actions that were zero drive nothing
        if acted:
            causes.append(f"actions drive it: {SMALLER[control.kind]}")
        if self.effects[number]:
            causes.append("effects drive it: milder effects")
        if control.gains is None and not acted:
            causes.append(
                "nothing holds the arm: the action, zero here, is all its torque"
            )
        if not causes:
            causes.append("feedforward drives it: another model, or feedforward='none'")
        speed = float(abs(dq[joint]))
        fast = (
            f"{speed:.3g} {joint_unit('rad/s', arm.sliding[joint])}"
            if np.isfinite(speed)
            else "a speed that is no number"
        )
        what = f"joint {joint + 1} diverged: {fast} after {time:.4g} s"
        return {
            "divergence": {
                "joint": joint + 1,
                "time": time,
                "speed": speed,
                "message": "\n  ".join([what, *causes]),
            }
        }

    def error(self) -> np.ndarray:
        """The tracking errors [rad], shape (N, n)."""
        return self._reference - self.position

    def observations(self, error: np.ndarray) -> np.ndarray:
        """The observations with the tracking errors [rad], shape (N, n)."""
        measured = (self.position, self.velocity, error, self.action)
        return self.setup.layout.assemble(measured, self.planned)

    def play(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, dict[str, Any], dict[int, dict[str, Any]]]:
        """Carry out an action in each environment, shape (N, ...), what exceeds -1 .. 1 clipped in place.

        Returns:
            Tracking errors [rad], shape (N, n); rewards, shape (N,); what ``info`` says of each action, by name, each
            (N,); and why episodes ended early, by number of the environment.
        """
        np.minimum(np.maximum(action, -1.0, action), 1.0, action)
        # once all arms have acted there is nothing more to note
        if np.count_nonzero(self._acted) < len(action):
            self._acted |= action.any(axis=1)
        self._act(action)
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
        # hardly ever: one question for all arms, and more only then
        if np.count_nonzero(stopped):
            early.update(np.flatnonzero(stopped.any(axis=1)).tolist())
        ends = {x: self._early_end(x, stopped[x]) for x in sorted(early)}
        return error, parts.total, values, ends

    def _act(self, action: np.ndarray) -> None:
        """Carry out the next action of each, shape (N, ...)."""
        self.diverged = {}
        # networks see what the encoders gave before this action
        for number, network in self._networks.items():
            now = self.position[number], self.velocity[number]
            network.see(int(self.at[number]), *now)
        before = self.torque
        act = self._command if self._control.gains is None else self._track
        series = act(action)
        self._note(series, before)
        self.torque = series[-1].copy()
        self.q, self.dq, self.applied = map(self._state, ("q", "dq", "applied"))
        # these arms stand at their start by now; what they had as they diverged is told
        for number, (_, had) in self.diverged.items():
            for name, value in had.items():
                getattr(self, name)[number] = value

    def _go_on(self) -> None:
        """The action is done: the next is to be chosen."""
        self.at += 1
        for number, at in enumerate(self.at.tolist()):
            self.planned[number] = self._courses[number].planned[at]

    def _command(self, action: np.ndarray) -> np.ndarray:
        """Hold the torque of each action; that of each step [N m], (S, N, n)."""
        steps, shape = self.setup.sub_steps, self.position.shape
        torque = self._scale * action
        commanded = torque.ravel()
        maximum(commanded, self._lowest, commanded)
        minimum(commanded, self._limit, commanded)
        # the torque is held throughout, only the encoders are read in between
        for done in range(0, steps, self._chunk):
            velocity = self._estimate(self._hold(commanded, done))
            self.velocity = velocity.reshape(shape)
        self._go_on()
        return np.broadcast_to(torque, (steps, *shape))

    def _track(self, action: np.ndarray) -> np.ndarray:
        """PD with feedforward at every step, with what the action adds or multiplies; the torques [N m], (S, N, n)."""
        control, gains = self._control, self._gains
        assert control.gains is not None and gains is not None
        # of each arm, which is at an action of its own, the steps of this action and the first after it
        steps = self.setup.sub_steps
        both = np.empty((2, steps + 1, *self.position.shape))
        for number, at in enumerate(self.at.tolist()):
            rows = slice(at * steps, at * steps + steps + 1)
            both[:, :, number] = self._courses[number].steps[:, rows]
        reference, wanted = both
        # the reference has one step more, at which the last action ends
        wanted = wanted[:-1]
        if control.multiplies:
            factor, scaled_gains = scaled(control.gains, action)
            wanted *= factor
            gains = Gains(*(gain.ravel() for gain in scaled_gains))
        else:
            wanted += self._scale * action
        kp, kd, lowest, limit = *gains, self._lowest, self._limit
        error, work, estimate = self._error, self._work, self._estimate
        # dq_ref - dq: the derivative of the error, as the last action left it
        rate = (self._rate - self.velocity).ravel()
        subtract(reference[0].ravel(), self.position.ravel(), error)
        # rows, filled in place
        torques, following = (
            series.reshape(len(wanted), -1) for series in (wanted, reference[1:])
        )
        # from here on each row of the feedforward turns into the torque commanded
        for done, (torque, after) in enumerate(zip(torques, following, strict=True)):
            multiply(kp, error, work)
            add(torque, work, torque)
            multiply(kd, rate, work)
            add(torque, work, torque)
            maximum(torque, lowest, torque)
            minimum(torque, limit, torque)
            subtract(after, self._hold(torque, done), error)
            rate = estimate(error)
        self._go_on()
        # from the derivative of the error to a velocity: dq = dq_ref - D(error)
        self.velocity = self._rate - rate.reshape(self.position.shape)
        return wanted

    def _hold(self, torque: np.ndarray, done: int) -> np.ndarray:
        """Hold a torque [N m], (N n,), until the encoders are read again; the readings [rad], (N n,).

        An arm that diverged waits at its start until its next episode.
        """
        simulators, felt, shape = self._simulators, torque, self.position.shape
        if self._networks:
            felt = torque.copy()
            for number, network in self._networks.items():
                step = self.at[number] * self.setup.sub_steps + done
                # felt by the arm: what was commanded is observed and rewarded
                felt.reshape(shape)[number] -= network.torque(step)
        only = simulators[0] if len(simulators) == 1 else None
        # fast: nothing is divided and put together
        if only is not None:
            only.step(felt, self._chunk)
            speed2 = only.speed2
        else:
            rows = felt.reshape(len(simulators), -1)
            for simulator, row in zip(simulators, rows, strict=True):
                simulator.step(row, self._chunk)
            speed2 = sum(simulator.speed2 for simulator in simulators)
        # fast: no joint is faster than all together
        if not speed2 <= SLOW:
            speeds = np.abs(self._state("dq")).max(axis=1)
            for number in np.flatnonzero(~(speeds <= FASTEST_OBSERVED)).tolist():
                self._stop(number, done, torque.reshape(shape)[number])
        if only is not None:
            reading = only.encoders()
        else:
            reading = self._joined(simulator.encoders() for simulator in simulators)
        self.position = reading.reshape(shape)
        return reading

    def _stop(self, number: int, done: int, torque: np.ndarray) -> None:
        """Note what an arm had when it diverged, if this is the first time in the action, and park it."""
        if number not in self.diverged:
            had = {"torque": torque, "position": self.position[number]}
            had["velocity"] = self.velocity[number]
            had |= {x: self._state(x)[number] for x in ("q", "dq", "applied")}
            # copies: all of these go on
            self.diverged[number] = done, {x: own.copy() for x, own in had.items()}
        simulator, place = self._simulator(number)
        # a state that is no number would stay one until the next episode
        simulator.reset(self._home[number], number=place)

    def _note(self, torque: np.ndarray, before: np.ndarray) -> None:
        """Note load and torque rate of an action, from the torque of its steps [N m], (S, N, n), and before, (N, n)."""
        share, jumps = self._series
        series = torque.transpose(1, 0, 2)
        np.divide(series, self._control.rated, share)
        # the first change is that from the action before
        subtract(series[:, 0], before, jumps[:, 0])
        subtract(series[:, 1:], series[:, :-1], jumps[:, 1:])
        flat = self._series.reshape(2, len(share), -1)
        squares, changes = np.vecdot(flat, flat)
        count = np.full(len(share), torque[:, 0].size)
        for number, (done, _) in self.diverged.items():
            # what was commanded after it had diverged does not count
            parts = self._series[:, number, : done + self._chunk].reshape(2, -1)
            count[number] = len(parts[0])
            squares[number], changes[number] = np.vecdot(parts, parts)
        self.load = squares / count
        self.torque_rate = np.sqrt(changes / count) / self.setup.dt


# One environment, and N of them in a process.


REWARDS = tuple(f"reward_{name}" for name in RewardParts._fields)
"""Where ``info`` holds the parts of the reward."""
MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)
"""When an episode that ended is followed by the next one."""
NEAR_STOP = 1e-3
"""A joint within this distance of its stop has come to it [rad]."""


class ArmTracking(gymnasium.Env):
    """An arm with effects, n joints, that is to follow a reference motion.

    An action is a vector of numbers in -1 .. 1, n in parts of ``torque_scale`` [N m], or 2 n or 1 for factors.
    Observation: see ``gapscope.envs.environment.Layout``; reward: see ``gapscope.envs.reward.Reward``. An episode is
    terminated when the arm diverges (``info["divergence"]``) or a joint comes to its stop (``info["limit"]``), and
    truncated at its end.

    Args:
        robot: a name of ``gapscope.arm.robots.KNOWN_ROBOTS``, a path of a URDF, or a nominal arm.
        effects: what the simulated arm has beyond the nominal arm; records, entries as in a ``corrected.yaml``, or the
            path of one.
        engine: name of the engine that steps the simulation.
        sheet: data sheet of the nominal arm, as ``nominal:`` in a case; not with a nominal arm as ``robot``.
        action: ``residual`` (torque added to a low-gain PD with feedforward, at every step of the simulation),
            ``scale`` or ``gains`` (2 n factors of that, or one of its gains, see ``gapscope.envs.actions.scaled``), or
            ``torque`` (commanded).
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
        period = time_step * sub_steps
        # a duration of whole periods, but for rounding, gets no further action
        actions = max(1, int(np.ceil(episode_length / period - 1e-9)))
        about = None if posture is None else arguments.numbers_of("posture", posture)
        allowed = arguments.checked_limits(limits, n)
        self.space = workspace(self.body, allowed, about)
        loop = action_share, bandwidth, action_reach
        own_control = control(self.arm, self.body, self.space, action, *loop)
        base = arguments.chosen_base(simulated, self.arm, effects)
        # an arm instead of the nominal one brings its own effects
        given = base.effects if simulated else chosen_effects(effects, self.arm)
        lower, upper = self.body.position_limits()
        self.layout = Layout(n, look_ahead, own_control.size)
        self.setup = Setup(
            arm=self.arm,
            body=self.body,
            scale=ArmScale.of(self.arm),
            base=base,
            encoder_noise=arguments.noise("encoder_noise", encoder_noise, n),
            space=self.space,
            control=own_control,
            dt=time_step,
            sub_steps=sub_steps,
            actions=actions,
            look_ahead=tuple(look_ahead),
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
        # none until a reset, without which a step is refused
        self._course: SampledReference | None = None
        self.observation_space = self.layout.space
        self.action_space = Box(-1.0, 1.0, (own_control.size,), dtype=np.float32)
        fps = max(1, round(1 / period))
        self.render_mode = render_mode
        self.metadata = self.metadata | {"render_fps": fps}
        self._screen: Screen | None = None
        if render_mode is not None:
            # pictures alone wait for matplotlib
            from gapscope.envs.rendering import Screen

            self._screen = Screen(self.space.kinematics, render_mode, period)

    @property
    def torque_scale(self) -> np.ndarray:
        """Torque of an action of 1 [N m], shape (n,); 0 with ``scale`` and ``gains``."""
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
            names = ", ".join(x.name.replace("_", " ") for x in self.effects)
            title = f"{self.arm.name}: {names or 'no effects'}"
            self._screen.begin(title, course.q)
        error = episodes.error()
        self._show(error[0], {})
        return episodes.observations(error)[0], episodes.truth(0)

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out an action in -1 .. 1, shape (n,), (2 n,) or (1,); what exceeds these bounds is clipped.

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
        truncated = bool(episodes.at[0] >= self.setup.actions)
        self._show(errors[0], info)
        # Gymnasium asks for a reset before the next step
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
            # the first line of why the episode ends early
            why: str = info.get("divergence", {}).get("message", "")
            ending = info.get("limit") or why.split("\n")[0]
            self._screen.add(episodes.q[0], error, share, ending)


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
        given = {"num_envs": num_envs, "threads": threads}
        check_values(given, "environment", "environment")
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
        # checks all arguments, and makes what the environments share
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
        # effects with motors or stiff springs need a simulator for each arm
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
        if isinstance(seed, (int, np.integer)):
            seeds = [int(seed) + number for number in range(count)]
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
        # an arm that waits for its reset does nothing that counts
        early = {i: why for i, why in early.items() if not waiting[i]}
        terminated = np.zeros(self.num_envs, dtype=bool)
        terminated[list(early)] = True
        truncated = (episodes.at >= self.setup.actions) & ~waiting
        ended = terminated | truncated
        # those that are reset in this step; their info is that of the new episode
        now = ended if self._mode == AutoresetMode.SAME_STEP else waiting
        told = ~now
        infos = self._infos(told, values, early)
        observations = None
        # before the reset, which overwrites what was observed last
        if self._mode == AutoresetMode.SAME_STEP and now.any():
            observations = episodes.observations(error)
            infos |= self._final(now, values, early, observations)
        rewards[waiting] = 0.0
        for number in np.flatnonzero(now).tolist():
            info = self._reset_one(number, None, {})
            infos = self._add_info(infos, info, number)
        # the reset has moved these arms, and given them another reference
        if now.any():
            error = episodes.error()
        # after a reset in the same step nobody waits
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
        # without a seed the stream goes on, as in a single environment
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
