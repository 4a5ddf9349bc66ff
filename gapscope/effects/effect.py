"""What an effect is: a frozen record, and the ways in which an effect can act.

What all effects of a kind have in common, its class states as default: the side of the gear, the reach.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Literal, NamedTuple, Protocol

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import smooth_sign
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import Parametrisation, Values

Law = Callable[..., np.ndarray]
Side = Literal["actuator", "link", "both"]
Reach = Literal["joint", "motor", "arm"]
PlottedQuantity = Literal[
    "own torque",
    "position",
    "velocity",
    "acceleration",
    "time",
    "recorded torque",
    "directed load",
    "torque rate",
]
Severity = Callable[[np.random.Generator, ArmScale, np.ndarray], Values]

QUANTITIES = {
    "friction": "dry friction that does not depend on the motion [N m]",
    "damping": "viscous friction [N m s/rad]",
    "rotor": "inertia of the rotor, joint side [kg m^2]",
    "breakaway": "what dry friction is higher by at rest [N m]",
    "breakaway_speed": "speed over which it falls [rad/s]",
    "saturating": "what friction grows to in motion [N m]",
    "saturating_speed": "speed over which it grows [rad/s]",
    "load_factor": "dry friction over the torque transmitted [1]",
    "drift": "share by which friction is higher at first [1]",
    "drift_time": "time constant over which it fades [s]",
    "stiffness": "of a spring between links [N m/rad]",
    "rest": "position at which it is slack [rad]",
    "gear_stiffness": "between motor and joint [N m/rad]",
    "gear_damping": "between motor and joint [N m s/rad]",
    "play": "free play between motor and joint, the whole width [rad]",
    "limit": "of the torque that is delivered [N m]",
    "corner_speed": "above which torque along the velocity falls [rad/s]",
    "no_load_speed": "at which none is left [rad/s]",
    "delay": "by which torque arrives late [s]",
    "lag": "time constant behind which it arrives [s]",
    "scale": "share by which more torque arrives than is recorded [1]",
    "fading": "share of it that heat takes at the rated torque in the long run [1]",
    "rated": "torque that is rated so [N m]",
    "warming_time": "time constant over which a motor warms up [s]",
    "offset": "torque that arrives beside it [N m]",
    "ripple": "amplitude of torque that arrives with the position [N m]",
    "ripple_cycles": "its periods per revolution [1]",
    "ripple_phase": "its phase [rad]",
    "zero": "what the encoder reads beyond the true position [rad]",
    "resolution": "of the encoder [rad]",
    "motor_friction": "as friction, of a motor that turns several joints [N m]",
    "motor_damping": "as damping, of such a motor [N m s/rad]",
    "motor_rotor": "as rotor, of such a motor [kg m^2]",
    "motor_breakaway": "as breakaway, of such a motor [N m]",
    "motor_breakaway_speed": "as breakaway_speed, of such a motor [rad/s]",
    "motor_saturating": "as saturating, of such a motor [N m]",
    "motor_saturating_speed": "as saturating_speed, of such a motor [rad/s]",
    "body": "inertia of a link [kg, m]",
    "load": "a body that the last link carries [kg, m]",
    "gravity": "its direction [rad]",
    "contact": "a force from outside and when it acts [N, s]",
}
"""What drives, bodies and encoders of a simulated arm are described by, joint side; a format holds some of them.

Effects say which of these their parameters are (``Effect.quantities``), so that neither simulator nor exports name any.
"""
SHEET = {"rotor": "armature", "friction": "coulomb", "damping": "viscous"}
"""Quantities that the data sheet states, in its order, with their name in ``NominalArm``."""


@dataclass(frozen=True)
class Effect:
    """One named physical cause of a gap, with everything that the simulator, the diagnosis and the report need.

    Attributes:
        name: name in the catalogue.
        family: friction, rigid_body, transmission, actuation, sensing or environment.
        scope: ``joint``, ``link`` or ``arm``.
        equation: how it acts, as text for the report.
        parameters: its parameters.
        looks_like: what gives it away in data.
        reference: source of the form or of the typical values; a key of ``docs/references.md``.
        confused_with: names of effects that look alike, each with the recording that separates the two.
        parametrisation: how a diagnosis fits it; ``None`` if the torque gap does not show it.
        severity: values drawn at random on some joints from 0, of the size met on an arm; ``None`` for values drawn
            evenly from the typical range.
        side: side of a torque sensor behind the gear on which it acts.
        reach: ``joint`` if it changes the torque of its own joint alone, ``motor`` if that of all joints that one motor
            turns, ``arm`` if that of others too.
        inherent: whether a healthy arm may have it beyond bodies, rotors and plain friction.
        simplified: whether the form in nature is more complicated than that of the catalogue.
        locally_linear: whether a linearisation around its values says what the torque would be without it.
        delays: whether it makes the torque late by its first parameter, a time [s].
        limits: whether it cuts the recorded torque off at its first parameter [N m].
        built_in: whether it belongs to how the arm was built, so that it does not change from one day to another.
        near_equivalent: the more common effect that it equals to first order, if any.
        on_joint: of an effect of a motor that turns several joints, the same on a single joint.
        plotted_against: the quantity over which a report draws it.
        quantities: by parameter, what it is of a simulated arm's drives and bodies, a key of ``QUANTITIES``; parameters
            that are none of these act through the law alone.
        without: what to do where a format cannot hold it; empty if there is nothing to say.
    """

    name: str
    family: str
    scope: str
    equation: str
    parameters: tuple[Parameter, ...]
    looks_like: str
    reference: str
    confused_with: tuple[tuple[str, str], ...] = ()
    _: KW_ONLY
    parametrisation: Parametrisation | None = None
    severity: Severity | None = None
    side: Side = "link"
    reach: Reach = "arm"
    inherent: bool = False
    simplified: bool = False
    locally_linear: bool = True
    delays: bool = False
    limits: bool = False
    built_in: bool = False
    near_equivalent: str | None = None
    on_joint: str | None = None
    plotted_against: PlottedQuantity = "own torque"
    quantities: Mapping[str, str] = field(default_factory=dict)
    without: str = ""

    def parameter(self, name: str) -> Parameter:
        """The parameter called ``name``; raises ``KeyError`` if there is none."""
        if name not in self.names:
            raise KeyError(
                f"{self.name} has no parameter {name!r}; it has {', '.join(self.names)}"
            )
        return next(p for p in self.parameters if p.name == name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def needed(self) -> tuple[str, ...]:
        """Names of those that have to be given."""
        return tuple(p.name for p in self.parameters if p.absent is None)

    @property
    def needed_quantities(self) -> set[str]:
        """What these are of a simulated arm, keys of ``QUANTITIES``."""
        return {
            self.quantities[name] for name in self.needed if name in self.quantities
        }

    @property
    def fitted(self) -> Parametrisation:
        """How a diagnosis fits it, of an effect that the torque gap shows."""
        assert self.parametrisation is not None
        return self.parametrisation

    def values_at(self, x: np.ndarray, searched: np.ndarray | None = None) -> Values:
        """Parameters by name at linear coordinates x, (linear, m), and searched ones, (s, m), moved into their bounds.

        A link's number is none of them: it says where.
        """
        # without nonlinear parameters: none of them at each place
        none = np.zeros((0, x.shape[1]))
        values = self.fitted.values(x, none if searched is None else searched)
        return {
            p.name: np.clip(values[p.name], *p.bounds)
            for p in self.parameters
            if p.name in values
        }

    def columns(self, at: Mechanics, x: np.ndarray, searched: np.ndarray) -> np.ndarray:
        """Derivatives of the bodies' torque by its linear coordinates, (N, n, linear, m), where it acts on bodies.

        By central differences; kinds of effects whose law gives them do better.

        Args:
            at: the arm with its effects, on a motion.
            x: linear coordinates around which to differentiate, (linear, m).
            searched: nonlinear parameters, (s, m).
        """
        # about zero a step of its own, about a value one in proportion to it
        begun = self.fitted.step or DIFFERENCE
        steps = np.where(x != 0, RELATIVE_DIFFERENCE * np.abs(x), begun)
        out = np.empty((*at.rigid.shape, *x.shape))
        for i, j in np.ndindex(*x.shape):
            moved = np.zeros_like(x)
            # one coordinate of one place at a time: each moves the torque of all joints
            moved[i, j] = steps[i, j]
            above, below = (at.rigid_with(self, x + side) for side in (moved, -moved))
            out[:, :, i, j] = (above - below) / (2 * steps[i, j])
        return out


DIFFERENCE = 1e-5
"""Step of central differences about no value, in the units of a coordinate."""
RELATIVE_DIFFERENCE = 1e-4
"""Step of central differences about a value, over it [1]."""


def derivative(
    function: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    step: float = DIFFERENCE,
) -> np.ndarray:
    """Derivative of a function by coordinates x, (linear,), by central differences; they come last, (..., linear)."""
    # one coordinate at a time, to both sides: the error is of the second order
    steps = step * np.eye(len(x))
    pairs = [function(x + side) - function(x - side) for side in steps]
    return np.stack(pairs, axis=-1) / (2 * step)


class Mechanics(Protocol):
    """The bodies of an arm with effects on a motion of N samples: what columns of effects on them are made of."""

    @property
    def motion(self) -> Motion:
        """The recorded motion."""

    @property
    def q(self) -> np.ndarray:
        """True positions [rad], (N, n)."""

    @property
    def rigid(self) -> np.ndarray:
        """Torque of the bodies, effects included [N m], (N, n)."""

    def rigid_with(self, effect: Effect, x: np.ndarray) -> np.ndarray:
        """The same with an effect at other linear coordinates, (linear, m)."""

    @property
    def sensitivities(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of that torque by position, velocity and acceleration, (N, n, n) each."""

    @property
    def gravity(self) -> np.ndarray:
        """Nominal gravity [m/s^2], (3,)."""

    @property
    def gravity_regressor(self) -> np.ndarray:
        """G with G g the torque of gravity, (N, n, 3) [kg m]."""

    @property
    def unit_force(self) -> np.ndarray:
        """J^T by a force in the world frame at the last link's centre of mass, (N, n, 3) [m]."""

    @property
    def inertials(self) -> np.ndarray:
        """Ten nominal inertial parameters of each link, (n, 10)."""

    @property
    def last_link(self) -> int:
        """Number of the last link, from 0."""

    def link_regressor(self, link: int) -> np.ndarray:
        """The bodies' torque by the inertial parameters of a link, (N, n, 10)."""

    @property
    def transmitted(self) -> np.ndarray:
        """Torque through the transmissions as recorded [N m], (N, n): what reached the motors less what they need."""

    def value(self, effect: str, parameter: str) -> np.ndarray:
        """Values of an effect's parameter over all joints, (n,)."""

    def nominal_play(self, width: float) -> np.ndarray:
        """Torque per radian from a little free play [rad] on each nominal joint, (N, n, n)."""


class Signals(NamedTuple):
    """Signals that a torque law may depend on; they broadcast: (n,) for one sample, (N, n) for a series.

    Attributes:
        t: time since the start of the recording [s], a number or shape (N, 1).
        position: q [rad].
        velocity: dq [rad/s].
        load: torque through the transmission before load friction [N m].
        bend: how far dry friction has built up [1], between -1 and 1; ``None`` if it follows the velocity at once.
    """

    t: np.ndarray | float
    position: np.ndarray
    velocity: np.ndarray
    load: np.ndarray
    bend: np.ndarray | None = None

    @property
    def direction(self) -> np.ndarray:
        """Direction of dry friction [1]: its bend, or the smoothed sign of the velocity."""
        return smooth_sign(self.velocity) if self.bend is None else self.bend


class Series(Protocol):
    """Series of a motion, as the laws on the way to the joint need them; all arrays have shape (N, n)."""

    position: np.ndarray
    """Joint position [rad]."""
    velocity: np.ndarray
    """Joint velocity [rad/s]."""

    def shifted(self, series: np.ndarray, time: np.ndarray) -> np.ndarray:
        """The series at t + T, T per joint [s], shape (n,); constant beyond the ends."""

    def rate(self, series: np.ndarray) -> np.ndarray:
        """The derivative of a series by time [1/s]."""

    def lagged(self, series: np.ndarray, time_constant: np.ndarray) -> np.ndarray:
        """The series behind 1 / (1 + T s), T per joint [s], shape (n,); at rest before the start."""

    def warmed(self, series: np.ndarray, time_constant: np.ndarray) -> np.ndarray:
        """The same from zero at the start on."""


@dataclass(frozen=True, kw_only=True)
class TorqueLaw(Effect):
    """A torque that opposes the motor: recorded = nominal + law(signals, *values).

    ``law`` is a pure function of ``Signals`` and of the parameters per joint, in their order; it broadcasts and
    returns N m.
    """

    law: Law
    side: Side = "actuator"
    reach: Reach = "joint"


@dataclass(frozen=True, kw_only=True)
class DryLaw(TorqueLaw):
    """A torque law of dry friction: if the joint rests it takes any value within its amplitude.

    ``amplitude(velocity, load, *values)`` is the torque with which it opposes motion [N m]; load is the applied motor
    torque [N m]. If that is known, law = amplitude times smoothed sign.

    Attributes:
        varies_with: on what the amplitude depends besides its values: a simulator takes it anew only when that changes.
    """

    amplitude: Law
    varies_with: Literal["nothing", "velocity", "load"] = "velocity"


@dataclass(frozen=True, kw_only=True)
class Drift(Effect):
    """A slow change of all friction of a joint by a share of it, ``change(t, *values)`` [1]; t from the start [s]."""

    change: Law
    side: Side = "actuator"
    reach: Reach = "joint"


@dataclass(frozen=True, kw_only=True)
class Inertial(Effect):
    """A change of the model: of inertia, of rotors, or of the direction of gravity."""


@dataclass(frozen=True, kw_only=True)
class LinkChange(Inertial):
    """A change of one link's inertia.

    ``change(own, *values)`` gives the ten inertial parameters that are added to a link which has ``own``, shape (10,),
    in the order of ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``. Of scope ``arm`` it is the last link's.

    Attributes:
        tangent_at: derivative of that change by the linear coordinates x, (linear,): ``tangent_at(x)`` of shape
            (10, linear); ``None`` for central differences.
    """

    change: Law
    tangent_at: Callable[[np.ndarray], np.ndarray] | None = None

    def tangent(self, own: np.ndarray, link: int, x: np.ndarray) -> np.ndarray:
        """Derivative of the ten parameters of a link, from 0, that has ``own``, by coordinates x, (10, linear)."""
        if self.tangent_at is not None:
            return self.tangent_at(x)
        # a law of a link begins with the number of the link
        where = (np.array(link + 1.0),) if self.scope == "link" else ()

        def change(x: np.ndarray) -> np.ndarray:
            # one place, of which the axis is dropped
            values = self.fitted.values(x[:, None], np.zeros((0, 1)))
            named = [np.squeeze(values[name], axis=-1) for name in values]
            # in the order of the law: its link, if it has one, then the rest
            return self.change(own, *where, *named)

        return derivative(change, x)

    def columns(self, at: Mechanics, x: np.ndarray, searched: np.ndarray) -> np.ndarray:
        """The inertial regressor of each link times the derivative of its ten parameters."""
        # a load is the last link's, errors may be any link's
        links = [at.last_link] if self.scope == "arm" else range(len(at.inertials))
        columns = [
            at.link_regressor(link) @ self.tangent(at.inertials[link], link, own)
            for link, own in zip(links, x.T, strict=True)
        ]
        # places come last: joints, links or the arm
        return np.stack(columns, axis=3)


@dataclass(frozen=True, kw_only=True)
class Turn(Inertial):
    """A turn of the base: ``rotation(*values)`` is R from the base to the world frame, (3, 3)."""

    rotation: Law

    def columns(self, at: Mechanics, x: np.ndarray, searched: np.ndarray) -> np.ndarray:
        """G times the derivative of gravity in the base frame, R^T g."""

        # gravity as the turned base sees it
        def gravity(x: np.ndarray) -> np.ndarray:
            return self.rotation(*x).T @ at.gravity

        # the arm is its only place
        return (at.gravity_regressor @ derivative(gravity, x[:, 0]))[..., None]


@dataclass(frozen=True, kw_only=True)
class Transmission(Effect):
    """Play or compliance between motor and joint, a two-mass joint in the simulator.

    ``deflection(torque, *values)`` is how far the motor leads the joint, theta - q [rad], when the torque through the
    transmission [N m] changes slowly; it lags behind the torque by the time constant ``lag(*values)`` [s].

    Attributes:
        behind: torque that the bodies need of the motors behind it [N m], (N, n), ``behind(matrices, motion, torque,
            *values)`` with the derivatives of their torque by the links' position, velocity and acceleration, (N, n, n)
            each, the motors' motion and the torque if the joint were rigid [N m], (N, n).
        derivatives: as ``columns``, where it begins and in use; ``None`` for central differences.
        starts: linear coordinates to begin a fit with, (linear,) each: ``starts(inertia, torque)`` of a joint that
            moves an inertia [kg m^2] by a torque [N m], (N,); a linearisation around none of it shows nothing.
    """

    deflection: Law
    lag: Law
    behind: Law
    derivatives: Callable[..., np.ndarray] | None = None
    starts: Callable[[float, np.ndarray], Iterator[np.ndarray]]
    side: Side = "both"
    inherent: bool = True
    simplified: bool = True
    locally_linear: bool = False

    def columns(self, at: Mechanics, x: np.ndarray, searched: np.ndarray) -> np.ndarray:
        """Its own derivatives, or central differences."""
        if self.derivatives is None:
            return super().columns(at, x, searched)
        return self.derivatives(self, at, x)


@dataclass(frozen=True, kw_only=True)
class Path(Effect):
    """Something between the recorded torque and the joint.

    ``inverse(needed, series, *values)`` gives the torque that must be recorded so that ``needed`` [N m] reaches the
    joint, ``applied(recorded, series, *values)`` the torque that reaches it; ``series`` is a ``Series``.

    Attributes:
        place: order from the command to the joint; the lowest acts first on a recorded torque.
        varies_with: on what ``applied`` depends besides the recorded torque of the moment: the position of the moment,
            or other times, through the series' methods. A simulator has a step for a delay and a lag
            (``quantities``), and for all that does not depend on time.
        additive: whether its torque adds to all other, in proportion to its linear coordinates.
    """

    inverse: Law
    applied: Law
    place: int
    additive: bool = False
    varies_with: Literal["nothing", "position", "time"] = "position"
    side: Side = "actuator"
    reach: Reach = "joint"


@dataclass(frozen=True, kw_only=True)
class Sensing(Effect):
    """A map between true and recorded position [rad].

    ``recorded(true, *values)`` gives what the encoder says, ``true(recorded, *values)`` undoes it as far as possible.
    """

    true: Law
    recorded: Law

    def columns(self, at: Mechanics, x: np.ndarray, searched: np.ndarray) -> np.ndarray:
        """What moves the true positions changes the bodies' torque as their position does."""

        def true(moved: np.ndarray) -> np.ndarray:
            # all joints at once, since each reads its own position alone
            values = self.fitted.values(x + moved[:, None], searched)
            return self.true(at.motion.q, *values.values())

        # torque of joint i by the position of joint j, times that by a coordinate
        by_x = np.moveaxis(derivative(true, np.zeros(len(x))), 2, 1)
        return at.sensitivities[0][:, :, None] * by_x[:, None]


@dataclass(frozen=True, kw_only=True)
class External(Effect):
    """An external force: ``active(t, start, end)`` says when it acts [1]; t from the start of the recording [s]."""

    active: Law

    def columns(self, at: Mechanics, x: np.ndarray, searched: np.ndarray) -> np.ndarray:
        """-J^T while it acts."""
        active = self.active(at.motion.t, *searched[:, 0])
        # what the force does the motors need not; the arm is its only place
        return (-active[:, None, None] * at.unit_force)[..., None]
