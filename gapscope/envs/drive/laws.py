"""Laws that act on joints step by step: values of several arms side by side, friction with sticking, the torque's way.

Coulomb's law is set-valued: f = c sgn v if a joint moves, and any f within +-c if it rests. Injected as a torque
of the present velocity it chatters about v = 0; here the velocity *after* the step is found together with the friction.

Motors that turn several joints have rotor, viscous and dry friction of their own speed w = D_m dq. What a motor takes,
I dw/dt + b w + f with f in c(w) Sgn w, acts on its joints along D_m^T. Explicit rotors would make an algebraic loop, so
w after the step is solved together with the joints' own friction: the motors are joints more, tied to the others by a
damper that is all but rigid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial, reduce
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy import add, multiply
from numpy.lib.mixins import NDArrayOperatorsMixin
from scipy.linalg.lapack import dgesv

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import ForwardDynamics
from gapscope.effects.corrected import CorrectedArm, total
from gapscope.effects.effect import Drift, DryLaw, Effect, Path
from gapscope.effects.signals import Moment

# Values of joints side by side, those of one arm or of several arms one after the other, and laws that act on them.
# What laws that are called in every step do with their arguments is noted once, and then repeated.


R = TypeVar("R", bound="Rows")
"""A class of values of joints."""
K = TypeVar("K", bound=Effect)
"""A kind of effects."""


class Rows:
    """A calculation that is done joint by joint, so that joints of several arms can stand in one array.

    It is made with the arm's joints in the order of the rows, which may go through them once for each of several arms.

    Attributes:
        ROWS: names of the attributes that hold one value per joint, shape (k,), or are such calculations themselves.
    """

    ROWS: ClassVar[tuple[str, ...]] = ()

    def put(self: R, number: int, one: R) -> None:
        """Take over the values of one arm as those of arm ``number``, counted from 0."""
        for name in self.ROWS:
            own, new = getattr(self, name), getattr(one, name)
            if isinstance(own, Rows):
                own.put(number, new)
            else:
                own[number * len(new) : (number + 1) * len(new)] = new
        self.note()

    def note(self) -> None:
        """Note what follows from the values, whenever they have changed."""


class Laws(Rows, Generic[K]):
    """Effects of one kind on joints, each with the values of its parameters, 0 on joints without it.

    An effect is on at a joint if a parameter that goes with its severity is not zero there.

    Args:
        found: effects with their parameters over all joints of an arm, as ``CorrectedArm.of_kind`` gives them.
        order: the arm's joints in the order of the rows.

    Attributes:
        acting: the effects that are on at some joint, with one row of values per parameter, in the order of their
            place and name, so that sums are the same on every arm.
        joints: mask of the joints at which one is on, shape (k,).
    """

    def __init__(
        self, found: Iterable[tuple[K, list[np.ndarray]]], order: np.ndarray
    ) -> None:
        self._known: dict[str, tuple[K, np.ndarray]] = {}
        self.joints: np.ndarray = np.zeros(len(order), dtype=bool)
        for effect, values in found:
            # one effect may be given several times, each on other joints
            rows = np.array(values)[:, order]
            if effect.name in self._known:
                rows += self._known[effect.name][1]
            self._known[effect.name] = effect, rows
        self.note()

    def note(self) -> None:
        """Note which effects are on, and where; those that are on nowhere are forgotten."""
        self.acting = []
        self.joints = np.zeros_like(self.joints)
        for effect, rows in self._known.values():
            # a parameter that says where or how fast, not how much, makes no law act
            telling = [parameter.severity != 0 for parameter in effect.parameters]
            on = rows[telling].any(axis=0)
            if on.any():
                self.acting.append((effect, rows))
                self.joints |= on
        self.acting.sort(key=lambda item: (getattr(item[0], "place", 0), item[0].name))
        self._known = {item[0].name: item for item in self.acting}

    def put(self, number: int, one: Laws[K]) -> None:
        """Take over the effects of one arm as those of arm ``number``; arms may have different ones."""
        part = slice(number * len(one.joints), (number + 1) * len(one.joints))
        # what the arm had before is gone
        for _, rows in self.acting:
            rows[:, part] = 0.0
        for effect, values in one.acting:
            nothing = np.zeros((len(values), len(self.joints)))
            self._known.setdefault(effect.name, (effect, nothing))[1][:, part] = values
        self.note()


def repeated(
    function: Callable[..., np.ndarray], count: int, size: int
) -> Callable[..., np.ndarray]:
    """A function of arrays of one shape as one that does no more than the ufuncs which it applies to them.

    What depends on its constants alone is computed once, and memory is taken once: for the few joints of an arm that is
    half of the time. A function that does anything else with its arguments, as to ask whether one is positive, is given
    back as it is.

    Args:
        function: of ``count`` arrays; what it takes from elsewhere may not change.
        count: number of arguments.
        size: of each array.
    """
    notes = _Notes()
    arguments = [_Noted(notes, np.zeros(size), number) for number in range(count)]
    try:
        # called once with arrays that note what is done; zeros may be divided by
        with np.errstate(all="ignore"):
            result: Any = function(*arguments)
    # it asked for a value, or did what is no ufunc
    except (AttributeError, TypeError, ValueError):
        return function
    if not isinstance(result, _Noted) or not notes.end(result.value):
        return function
    return notes


class _Notes:
    """The operations of a function, in their order, and where its arguments go in."""

    def __init__(self) -> None:
        self._calls: list[tuple[np.ufunc, list[Any]]] = []
        self._given: list[tuple[list[Any], int, int]] = []

    def note(self, operation: np.ufunc, *inputs: Any) -> _Noted:
        """Note an operation, of which at least one input goes back to an argument."""
        # constants are kept as they are, what comes from an argument as its memory
        call = [x.value if isinstance(x, _Noted) else np.asarray(x) for x in inputs]
        for place, x in enumerate(inputs):
            if isinstance(x, _Noted) and x.number is not None:
                self._given.append((call, place, x.number))
        out = operation(*call)
        # where the result goes to comes last
        call.append(out)
        self._calls.append((operation, call))
        return _Noted(self, out)

    def end(self, result: np.ndarray) -> bool:
        """Whether the function ends with the last operation; its result takes memory of its own each time."""
        if not self._calls or self._calls[-1][1][-1] is not result:
            return False
        self._last, self._inputs = self._calls.pop()
        self._inputs.pop()
        return True

    def __call__(self, *arguments: np.ndarray | float) -> np.ndarray:
        """The function's value, an array of its own."""
        for inputs, place, number in self._given:
            inputs[place] = arguments[number]
        for operation, inputs in self._calls:
            operation(*inputs)
        value: np.ndarray = self._last(*self._inputs)
        return value


class _Noted(NDArrayOperatorsMixin):
    """An array that stands for argument ``number``, or comes from one; nobody may ask for its values."""

    # asking for a value calls None: the TypeError gives the function back as it is
    __array__ = __bool__ = None

    def __init__(
        self, notes: _Notes, value: np.ndarray, number: int | None = None
    ) -> None:
        self._notes, self.value, self.number = notes, value, number

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any
    ) -> Any:
        """Have the operation noted, if it is a plain one."""
        if method != "__call__" or kwargs or ufunc.nout != 1:
            return NotImplemented
        return self._notes.note(ufunc, *inputs)


# Friction of all joints at one moment, and dry friction in one time step, with sticking.


TRIALS = 100
"""Changes of the set of sticking joints before the solver gives up."""
BLOCK_TRIALS = 10
"""The first of them change all joints at fault at once, later ones only the first, which cannot cycle."""


class DryFriction:
    r"""Solves W v + p = b with p_i = limit_i sgn v_i if v_i != 0, and \|p_i\| <= limit_i if v_i = 0.

    W [kg m^2] is symmetric positive definite, so that the solution is unique; v [rad/s] is the velocity after the step,
    p [N m s] the friction's impulse. It is found by block principal pivoting on the set of sticking joints,
    starting from the set of the step before.

    Attributes:
        direction: sign of each joint's velocity in the last solution, 0 if it sticks, shape (n,).
    """

    def __init__(self, n_joints: int) -> None:
        self._identity = np.eye(n_joints)
        self.reset()

    def reset(self) -> None:
        """Forget the step before: all joints rest."""
        self.direction: np.ndarray = np.zeros(len(self._identity))

    def solve(
        self, inertia: np.ndarray, momentum: np.ndarray, limit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Velocity v [rad/s] after the step and friction impulse p [N m s], each of shape (n,).

        Args:
            inertia: W [kg m^2], shape (n, n).
            momentum: b [N m s], shape (n,).
            limit: c dt [N m s], shape (n,), not negative; joints with 0 have no friction.

        Raises:
            ArithmeticError: no solution found, which a positive definite W rules out.
        """
        dry = limit > 0
        direction = self.direction
        for trial in range(TRIALS):
            stuck = dry & (direction == 0)
            known = direction * limit
            # unknowns: the velocity of moving joints, the impulse of stuck ones
            x = dgesv(np.where(stuck, self._identity, inertia), momentum - known)[2]
            # one that sticks needs at most its limit, one that slides goes on
            wrong = np.where(stuck, np.abs(x) > limit, dry & (x * direction < 0))
            if not wrong.any():
                self.direction = np.where(dry, direction, np.sign(x))
                return np.where(stuck, 0.0, x), np.where(stuck, x, known)
            # the first alone, by Murty's rule of the least index
            if trial >= BLOCK_TRIALS:
                wrong = wrong & (np.cumsum(wrong) == 1)
            # what sticks goes where it is pushed, what turned back sticks
            direction = np.where(wrong, np.where(stuck, np.sign(x), 0.0), direction)
        raise ArithmeticError(
            f"dry friction of {len(limit)} joints did not settle in {TRIALS} trials"
        )


DRIFT_PERIOD = 0.016
"""Drift, whose time constant is seconds and more, is brought up to date this often [s]."""


class Friction(Rows):
    """Limit of dry friction, and b F, with the nominal values included.

    With A_l(v, applied) the ``amplitude`` of each law l of dry friction and D_m(t) the ``change`` of each drift m, the
    limit is (c + sum_l A_l) F, F = prod_m (1 + D_m). Laws that vary with nothing are summed once, those that vary with
    the load when a torque is taken over.

    Args:
        arm: an arm with effects.
        order: the arm's joints in the order of the result.
        dt: time step [s].

    Attributes:
        viscous: b F [N m s/rad], shape (n,).
        present: whether there is any friction.
        drifting: whether it drifts; it is to be brought up to date every ``every`` steps.
        dry: mask of the joints with dry friction, shape (n,).

    Raises:
        InputError: friction that is negative in total.
    """

    ROWS = (
        *("_constant", "_loaded", "_moving", "dry"),
        *("_base_viscous", "viscous", "_drifts", "_factor"),
    )

    def __init__(self, arm: CorrectedArm, order: np.ndarray, dt: float) -> None:
        # coupled motors have dry friction of their own
        laws = [item for item in arm.of_kind(DryLaw) if item[0].reach != "motor"]
        constant = arm.arm.coulomb
        for law, values in laws:
            # the same at every velocity and load: summed once
            if law.varies_with == "nothing":
                constant = constant + law.amplitude(0.0, 0.0, *values)
        self._constant = total(constant, "nominal.coulomb", "N m")[order]
        self._loaded, self._moving = (
            Laws([item for item in laws if item[0].varies_with == what], order)
            for what in ("load", "velocity")
        )
        self.dry = (self._constant > 0) | self._loaded.joints | self._moving.joints
        viscous = arm.passive("damping", "nominal.viscous")
        self._base_viscous, self.viscous = viscous[order], viscous[order]
        self._drifts = Laws(arm.of_kind(Drift), order)
        self._factor: np.ndarray = np.ones(len(order))
        self.every = max(1, round(DRIFT_PERIOD / dt))
        self.note()

    def note(self) -> None:
        """Note what is absent, so that a step leaves it out; a torque is still to be taken over."""
        self.drifting = bool(self._drifts.acting)
        self.present = bool(self.dry.any() or self._base_viscous.any())
        size = len(self._constant)
        self._at_rest, self._applied = self._constant, np.zeros(size)
        self._under_load = repeated(self._sum_at_rest, 2, size)
        self._in_motion = repeated(self._sum_in_motion, 4, size)
        self._drifted = repeated(self._product, 1, size)

    def drift(self, t: float | np.ndarray, where: np.ndarray | None = None) -> None:
        """Bring the drift up to date at a time t [s], of all joints or of those of a mask, shape (n,)."""
        # the factor is spread anew only where it is due, each arm at its own steps
        now = True if where is None else where
        np.copyto(self._factor, self._drifted(t), where=now)
        self.viscous = self._factor * self._base_viscous

    def _product(self, t: np.ndarray) -> np.ndarray:
        """The drift's factor F [1] at times t [s], if there is any."""
        drifts = self._drifts.acting
        factors = [1.0 + effect.change(t, *values) for effect, values in drifts]
        return reduce(multiply, factors)

    def _sum_at_rest(self, applied: np.ndarray, factor: np.ndarray) -> np.ndarray:
        """Limit without what varies with the velocity [N m]."""
        limit = self._constant
        if self._loaded.acting:
            limit = _sum(self._loaded, 0.0, applied) + limit
        return limit * factor if self.drifting else limit

    def _sum_in_motion(
        self,
        velocity: np.ndarray,
        applied: np.ndarray,
        factor: np.ndarray,
        at_rest: np.ndarray,
    ) -> np.ndarray:
        """Limit with what varies with the velocity [N m]."""
        if not self._moving.acting:
            return at_rest
        more = _sum(self._moving, velocity, applied)
        return (more * factor if self.drifting else more) + at_rest

    def load(self, applied: np.ndarray, where: np.ndarray | None = None) -> None:
        """Take over the applied motor torque [N m], shape (n,), of all joints or of those of a mask."""
        at_rest = self._under_load(applied, self._factor)
        if where is not None:
            at_rest = np.where(where, at_rest, self._at_rest)
            applied = np.where(where, applied, self._applied)
        self._at_rest, self._applied = at_rest, applied

    def limit(self, velocity: np.ndarray) -> np.ndarray:
        """Limit of dry friction [N m] at velocities [rad/s], shape (n,)."""
        return self._in_motion(velocity, self._applied, self._factor, self._at_rest)


def _sum(
    laws: Laws[DryLaw], velocity: np.ndarray | float, applied: np.ndarray
) -> np.ndarray:
    """Sum of the amplitudes of laws [N m], of which there is one."""
    return reduce(
        add, [law.amplitude(velocity, applied, *values) for law, values in laws.acting]
    )


TIE = 1e5
"""Inertia that ties a motor to its joints, over the largest of the mass matrix [1]."""


class CoupledMotors:
    """Torque that an arm's k coupled motors take from its n joints, in kinematic order.

    Args:
        arm: an arm with effects.
        body: its loaded rigid bodies.
        dt: time step [s].

    Attributes:
        present: whether a motor takes any.
    """

    def __init__(self, arm: CorrectedArm, body: RigidBody, dt: float) -> None:
        n, order = arm.arm.n_joints, body.order
        # motor speeds over joint speeds; without coupling each turns its own joint
        drives = np.eye(n) if arm.arm.coupling is None else arm.arm.coupling
        viscous = arm.quantity("motor_damping")
        rotors = arm.quantity("motor_rotor")
        dry = [x for x in arm.of_kind(DryLaw) if x[0].reach == "motor"]
        # only to see which motors take anything: first parameters are amplitudes
        takes = sum((values[0] for _, values in dry), viscous + rotors)
        motors = np.flatnonzero(takes > 0)
        self.present = bool(len(motors))
        self._drives = drives[np.ix_(motors, order)]
        self._dry = [(law, [x[motors] for x in values]) for law, values in dry]
        self._dt = dt
        self._viscous, self._rotors = viscous[motors], rotors[motors]
        # D dq - w, zero if motors turn as their joints do
        self._tied = np.hstack([self._drives, -np.eye(len(motors))])
        if self.present:
            self._forward = ForwardDynamics(body, np.zeros(n))
            self._friction = DryFriction(n + len(motors))

    def reset(self) -> None:
        """Forget the step before: all rests."""
        self._friction.reset()

    def __call__(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        torque: np.ndarray,
        rotors: np.ndarray,
        viscous: np.ndarray,
        limit: np.ndarray,
    ) -> np.ndarray:
        """Torque taken [N m], (n,).

        Args:
            q, dq: positions [rad] and velocities [rad/s] before the step, (n,).
            torque: on the joints but friction and rotors [N m], (n,).
            rotors: the joints' own [kg m^2], (n,).
            viscous: their viscous friction [N m s/rad], (n,).
            limit: of their dry friction [N m], (n,).
        """
        dt, n = self._dt, len(q)
        self._forward.set_rotors(rotors + dt * viscous)
        inertia = self._forward.mass_matrix(q)
        out = torque - viscous * dq - self._forward.bias(q, dq)
        speed = self._drives @ dq
        own = self._rotors + dt * self._viscous
        # one mass matrix of joints and motors, the tie a stiff damper between them
        together = TIE * inertia.max() * (self._tied.T @ self._tied)
        together[:n, :n] += inertia
        together[n:, n:] += np.diag(own)
        # a tie that holds before the step has no momentum
        momentum = np.concatenate([inertia @ dq + dt * out, self._rotors * speed])
        limits = dt * np.concatenate([limit, self._limit(speed)])
        after, impulse = self._friction.solve(together, momentum, limits)
        change = self._rotors * (after[n:] - speed) + impulse[n:]
        # what rotors and friction of the motors took, given on to their joints
        return np.asarray((change / dt + self._viscous * after[n:]) @ self._drives)

    def _limit(self, speed: np.ndarray) -> np.ndarray:
        """Limit of the motors' dry friction [N m], (k,), at their speeds [rad/s]."""
        limit = np.zeros_like(speed)
        for law, values in self._dry:
            limit += law.amplitude(speed, limit, *values)
        return limit


# The way from the commanded torque to the joint: what effects on it do to a torque, step by step.


class TorquePath(Rows):
    """What is applied: the command after the laws before delay and lag, these two, heat, and the laws behind them.

    The commanded torque is held over each step, so that a delayed one changes at most once within a step, after the
    fraction of T / dt. What is applied is the mean over the step of what comes out of delay and lag: the impulse of
    each step is exact for every T, the moment within the step is not. The lag's state is exact as well: it decays
    towards the older torque before the change and towards the newer one after it. Before the first command that command
    counts as having been held. A law between delay and lag acts behind both. Motors are cold at first.

    Args:
        arm: an arm with effects.
        order: the arm's joints in the order of the result.
        dt: time step [s].

    Attributes:
        constant: whether a held command always gives the same torque.
        changing: mask of the joints of arms in which it does not, shape (n,).
    """

    ROWS = (
        *("_before", "_after", "_whole", "_fraction", "_lag", "_lagging"),
        *("changing", "_fresh", "_heat"),
    )

    def __init__(self, arm: CorrectedArm, order: np.ndarray, dt: float) -> None:
        laws = arm.of_kind(Path)
        in_time = [law.place for law, _ in laws if law.varies_with == "time"]
        # laws from the place of the first one in time on act behind delay and lag
        first = min(in_time, default=0)
        now = [item for item in laws if item[0].varies_with != "time"]
        self._before = Laws([item for item in now if item[0].place < first], order)
        self._after = Laws([item for item in now if item[0].place >= first], order)
        delay, lag = (arm.quantity(name)[order] for name in ("delay", "lag"))
        steps = delay / dt
        # a delay of whole steps, but for rounding, has no fraction
        self._whole = np.floor(steps + 1e-9).astype(int)
        self._fraction = np.clip(steps - self._whole, 0.0, 1.0)
        self._lag = _Lag(lag, self._fraction, dt)
        # a lag on one joint of an arm takes all its joints through the same formula
        self._lagging = np.full(len(steps), bool(lag.any()))
        acting = self._before.acting + self._after.acting
        self._heat = _Heat(arm, order, dt)
        changes = lag.any() or delay.any() or self._heat.fading.any()
        changes |= arm.quantity("no_load_speed").any()
        changes |= any(law.varies_with == "position" for law, _ in acting)
        self.changing = np.full(len(steps), bool(changes))
        self._fresh = np.ones(len(steps), dtype=bool)
        # the latest commands, the last one first
        self._held: np.ndarray = np.zeros((2, len(steps)))
        self.note()
        self.reset()

    def note(self) -> None:
        """Note what does nothing and is left out of a step, and hold as many commands as the longest delay needs."""
        size = len(self._whole)
        self._columns = np.arange(size)
        self._first, self._last = (
            repeated(partial(_through, laws), 3, size) if laws.acting else None
            for laws in (self._before, self._after)
        )
        self._lags = bool(self._lagging.any())
        self._heats = bool(self._heat.fading.any())
        self._in_time = bool(self._lags or self._whole.any() or self._fraction.any())
        self.constant = not self.changing.any()
        # up to the two between which the longest delay changes; older ones count as the oldest that is known
        length = int(self._whole.max()) + 2
        self._held = self._held.take(range(length), axis=0, mode="clip")

    def put(self, number: int, one: TorquePath) -> None:
        """Take over the way of one arm as that of arm ``number``, whose commands are forgotten."""
        super().put(number, one)
        size = len(one._whole)
        self.reset(slice(number * size, (number + 1) * size))

    def reset(self, rows: slice = slice(None)) -> None:
        """Forget all commands, of all joints or of some; their motors are cold."""
        self._fresh[rows] = True
        self._heat.state[rows] = 0.0
        self._starts = True

    def __call__(
        self,
        commanded: np.ndarray,
        position: np.ndarray | None = None,
        velocity: np.ndarray | None = None,
    ) -> np.ndarray:
        """Torque [N m] that reaches the joints during this step for the torque commanded at its start, shape (n,).

        It is the commanded torque itself if nothing changes it.

        Args:
            commanded: [N m], shape (n,).
            position, velocity: of the motors [rad], [rad/s], (n,); not needed if the path is ``constant``.
        """
        u = commanded
        if self._first:
            u = self._first(u, position, velocity)
        if self._in_time:
            u = self._through_time(u)
        if self._heats:
            u = self._heat(u)
        if self._last:
            u = self._last(u, position, velocity)
        return u

    def _through_time(self, u: np.ndarray) -> np.ndarray:
        """Delay and lag."""
        if self._starts:
            np.copyto(self._held, u, where=self._fresh)
            self._lag.start(u, self._fresh)
            self._fresh[:] = False
            self._starts = False
        self._held[1:] = self._held[:-1]
        self._held[0] = u
        # each joint has a delay of its own, and so another row
        newer, older = (
            self._held[late, self._columns] for late in (self._whole, self._whole + 1)
        )
        late_only = (1.0 - self._fraction) * newer + self._fraction * older
        if not self._lags:
            return late_only
        return np.where(self._lagging, self._lag(older, newer), late_only)


def _through(
    laws: Laws[Path],
    torque: np.ndarray,
    position: np.ndarray | None,
    velocity: np.ndarray | None,
) -> np.ndarray:
    """Torque [N m] that leaves some laws one after the other."""
    moment = Moment(position, velocity)
    for law, values in laws.acting:
        torque = law.applied(torque, moment, *values)
    return torque


class _Heat(Rows):
    """Heat of motors, the state Q of ``gapscope.effects.actuation.faded``, exact for a torque that is held."""

    ROWS = ("fading", "_rated", "_keep", "state")

    def __init__(self, arm: CorrectedArm, order: np.ndarray, dt: float) -> None:
        names = ("fading", "rated", "warming_time")
        self.fading, rated, time = (arm.quantity(name)[order] for name in names)
        # joints without heat have no rated torque, and nothing fades there
        self._rated = np.where(rated > 0, rated, 1.0)
        # without a warming time the state follows at once, and no division by 0 occurs
        self._keep = np.exp(-dt / np.maximum(time, dt * 1e-9))
        self.state = np.zeros(len(order))

    def __call__(self, torque: np.ndarray) -> np.ndarray:
        """What is left of a torque [N m] during a step; the motors get warmer by it."""
        # by the heat at the start of the step
        left = torque * (1.0 - self.fading * self.state)
        square = (torque / self._rated) ** 2
        self.state = square + (self.state - square) * self._keep
        return np.asarray(left)


class _Lag(Rows):
    """Exact 1 / (1 + T s) of a torque that changes once within each step, after ``fraction`` of it."""

    ROWS = (
        *("_before", "_after", "_span_before", "_span_after", "_fraction", "_state"),
    )

    def __init__(
        self, time_constant: np.ndarray, fraction: np.ndarray, dt: float
    ) -> None:
        # without a lag T is so small that the state follows at once, and no division by 0 occurs
        rate = dt / np.maximum(time_constant, 1e-9 * dt)
        self._before = np.exp(-rate * fraction)
        self._after = np.exp(-rate * (1.0 - fraction))
        self._span_before = (1.0 - self._before) / rate
        self._span_after = (1.0 - self._after) / rate
        self._fraction = fraction
        self._state = np.zeros_like(time_constant)

    def start(self, torque: np.ndarray, fresh: np.ndarray) -> None:
        """The joints of a mask are at rest under a torque [N m]."""
        self._state = np.where(fresh, torque, self._state)

    def __call__(self, older: np.ndarray, newer: np.ndarray) -> np.ndarray:
        """Mean over the step [N m]; the state moves on to its end."""
        start = self._state
        # the state at the change within the step
        middle = older + (start - older) * self._before
        self._state = newer + (middle - newer) * self._after
        # each part of the step: its torque, and the integral of what lags behind
        mean = older * self._fraction + (start - older) * self._span_before
        mean = mean + newer * (1.0 - self._fraction)
        return mean + (middle - newer) * self._span_after
