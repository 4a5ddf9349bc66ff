"""Forward dynamics: an arm simulated without an engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from gapscope.arm.control import PD
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import FRICTION_SMOOTHING
from gapscope.arm.velocity_filter import VelocityFilter

# Forward dynamics of one state at a time, for simulators: joints in kinematic order, nothing allocated twice.


class ForwardDynamics:
    """Accelerations of an arm with rotors; all arrays (n,), in kinematic order (``RigidBody.order``).

    Args:
        body: the rigid bodies.
        rotors: inertia added to the diagonal of the mass matrix [kg m^2], shape (n,).

    Attributes:
        acceleration: of (q, dq, torque), (M + I)^-1 (torque - C dq - g) [rad/s^2]; valid until the next call.
    """

    acceleration: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

    def __init__(self, body: RigidBody, rotors: np.ndarray) -> None:
        self._model = body.model.copy()
        self._data = self._model.createData()
        self.acceleration = partial(pin.aba, self._model, self._data)
        self.set_rotors(rotors)

    def set_rotors(self, rotors: np.ndarray) -> None:
        """Change the inertia on the diagonal [kg m^2]."""
        self._model.armature = rotors

    def set_link(self, link: int, parameters: np.ndarray) -> None:
        """Change a link's inertial parameters, shape (10,); ``link`` counts from 0 in kinematic order."""
        # pinocchio counts the universe as link 0
        self._model.inertias[link + 1] = pin.Inertia.FromDynamicParameters(parameters)

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M(q) + I [kg m^2], shape (n, n); valid until the next call."""
        return pin.crba(self._model, self._data, q)

    def bias(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """C(q, dq) dq + g(q) [N m]; valid until the next call."""
        return pin.nonLinearEffects(self._model, self._data, q, dq)


# A PD loop rolled out by pinocchio, without an engine: for output error, filters and hypotheses.
#
# The arm obeys M(q) a + C(q, v) v + g(q) + I a + b v + c tanh(v / v0) = u + o. One step of h drifts by half a step,
# solves for the acceleration there, and drifts on:
#
#     q' = q + h v / 2,   (M(q') + I + h (b + s)) a = u + o - C(q', v) v - g(q') - b v - c tanh(v / v0),
#     v+ = v + h a,   q+ = q' + h v+ / 2,   s = c / v0 tanh(x) / x exp(-(x / 4)^2) with x = v / v0.
#
# Friction is taken at the velocity after the step: c tanh(v / v0) + s h a, whose slope s ends sliding without chatter,
# however long the step, and vanishes if a joint moves.


UNSTABLE_SPEED = 50.0
"""A joint faster than this [rad/s] has lost its controller."""
LONGEST_STEP = 1e-3
"""The time step is the controller's period, divided until it is no longer than this [s]."""

# What is moved is one vector of 14 n numbers: the ten inertial parameters of each link, in the order of
# ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``, then joint by joint the rotors' inertia I [kg m^2], viscous
# friction b [N m s/rad], Coulomb friction c [N m] and the offset o [N m], what reaches the joint beyond the command.


@dataclass(frozen=True)
class Commands:
    """Reference and feedforward at every tick of a controller, K ticks of n joints.

    Attributes:
        t: time [s], shape (K,), uniform.
        q, dq: reference [rad], [rad/s], shape (K, n).
        torque: feedforward [N m], shape (K, n).
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True)
class RollOut:
    """A rolled out motion at every tick, K ticks of n joints.

    Attributes:
        t: time [s], shape (K,).
        q: position [rad], shape (K, n).
        dq: velocity as the controller's filter gives it [rad/s], shape (K, n).
        tau: torque commanded [N m], shape (K, n).
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray


class Stepper:
    """Steps of an arm in R states at once; positions, velocities, torques of shape (R, n) in kinematic order.

    Args:
        body: rigid bodies of the arm; its inertias are replaced.
        parameters: what moves in each state, (R, 14 n).
        dt: time step h [s].

    Attributes:
        order: ``q[order]`` is in kinematic order.
        smoothing: velocity scale of the smoothed sign [rad/s or m/s], shape (n,), in kinematic order.
    """

    def __init__(self, body: RigidBody, parameters: np.ndarray, dt: float) -> None:
        self.order = body.order
        self.smoothing = FRICTION_SMOOTHING * body.per_radian[self.order]
        self.dt = dt
        self._links = body.inertial_parameters().reshape(-1, 10)[self.order]
        # rotors hold the slope of friction, of each state its own: a model for each
        without = np.zeros(body.n_joints)
        self._forward = [ForwardDynamics(body, without) for _ in parameters]
        self.set_parameters(parameters)

    def set_parameters(self, parameters: np.ndarray) -> None:
        """Take other parameters, (R, 14 n)."""
        n = len(self.order)
        links, drives = np.split(parameters, [10 * n], axis=1)
        links = links.reshape(-1, n, 10)[:, self.order]
        # others are left as they are: one of no mass has no centre that its parameters tell
        moved = (links != self._links).any(axis=2)
        for state, place in np.argwhere(moved).tolist():
            self._forward[state].set_link(place, links[state, place])
        self._links = links
        laws = drives.reshape(-1, 4, n)[:, :, self.order]
        self._armature, self._viscous, self._coulomb, self._offset = laws.swapaxes(0, 1)

    def friction(self, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Friction b v + c tanh(v / v0) [N m], and the slope b + s [N m s/rad]; shape (R, n) each."""
        x = dq / self.smoothing
        friction = self._viscous * dq + self._coulomb * np.tanh(x)
        dry_slope = self._coulomb / self.smoothing * taper(x)
        return friction, self._viscous + dry_slope

    def acceleration(
        self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray
    ) -> np.ndarray:
        """Acceleration a of the step [rad/s^2]; q is the position half a step on."""
        friction, slope = self.friction(dq)
        # h (b + s) on the diagonal makes the step implicit in friction
        rotors = self._armature + self.dt * slope
        free = torque + self._offset - friction
        out = np.empty_like(q)
        for row, forward in enumerate(self._forward):
            forward.set_rotors(rotors[row])
            out[row] = forward.acceleration(q[row], dq[row], free[row])
        return out

    def __call__(
        self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity after one step under a torque [N m]."""
        half = 0.5 * self.dt
        # half a step with the velocity before, half with the one after
        middle = q + half * dq
        after = dq + self.dt * self.acceleration(middle, dq, torque)
        return middle + half * after, after


def taper(x: np.ndarray) -> np.ndarray:
    """tanh(x) / x exp(-(x / 4)^2) [1], any shape."""
    size = np.maximum(np.abs(x), np.finfo(float).eps)
    return np.tanh(size) / size * np.exp(-0.0625 * size * size)


def steps_per_tick(controller: Controller) -> int:
    """Steps of the roll-out within one period of the controller."""
    return max(1, int(np.ceil(1.0 / (controller.rate * LONGEST_STEP) - 1e-9)))


def together(series: Sequence[np.ndarray]) -> np.ndarray:
    """R series of shape (K_r, ...) side by side, (K, R, ...); the last row of a shorter one is repeated."""
    longest = max(map(len, series))
    padded = []
    for rows in series:
        held = np.repeat(rows[-1:], longest - len(rows), axis=0)
        padded.append(np.concatenate([rows, held]))
    return np.stack(padded, axis=1)


@dataclass(frozen=True)
class ClosedLoop:
    """An arm under its PD controller, n joints.

    Attributes:
        body: rigid bodies of the nominal arm.
        controller: in the arm's joint order.
        limit: of the torque [N m], shape (n,), or ``None``.
        rule: how the controller discretises its velocity filter, one of ``gapscope.arm.velocity_filter.RULES``.
    """

    body: RigidBody
    controller: PD
    limit: np.ndarray | None = None
    rule: str = "bilinear"

    def roll_outs(
        self,
        parameters: np.ndarray,
        commands: Sequence[Commands],
        starts: Sequence[tuple[np.ndarray, np.ndarray]] | None = None,
    ) -> tuple[RollOut, ...]:
        """Roll the loop out under several series of commands at once; the last command of a shorter one is held.

        At each tick tau = feedforward + kp (q_ref - q) + kd (dq_ref - dq), clipped, and held until the next.

        Args:
            parameters: what moves, (14 n,); or of each series, (R, 14 n).
            commands: at the controller's ticks.
            starts: position [rad] and velocity [rad/s], each of shape (n,); the references' by default.

        Raises:
            GapscopeError: the arm diverged.
        """
        controller, steps = self.controller, steps_per_tick(self.controller)
        dt = 1.0 / (controller.rate * steps)
        moved = np.broadcast_to(parameters, (len(commands), parameters.shape[-1]))
        stepper = Stepper(self.body, moved, dt)
        order, places = self.body.order, self.body.places
        q_ref, dq_ref, feedforward = (
            together([getattr(c, name) for c in commands])
            for name in ("q", "dq", "torque")
        )
        start, start_speed = q_ref[0], dq_ref[0]
        if starts is not None:
            start, start_speed = np.array(starts).swapaxes(0, 1)
        velocity = VelocityFilter(
            controller.estimate,
            start,
            start_speed,
            self.rule,
        )
        bound = np.inf if self.limit is None else self.limit
        q, dq = start[:, order], start_speed[:, order]
        positions, filtered, torques = (np.empty_like(q_ref) for _ in range(3))
        for i in range(len(q_ref)):
            positions[i] = encoder = q[:, places]
            filtered[i] = estimate = velocity(encoder)
            stiff = controller.kp * (q_ref[i] - encoder)
            damping = controller.kd * (dq_ref[i] - estimate)
            torque = feedforward[i] + stiff + damping
            torques[i] = torque = np.minimum(np.maximum(torque, -bound), bound)
            held = torque[:, order]
            # the law acts at ticks, the bodies move in steps within
            for _ in range(steps):
                q, dq = stepper(q, dq, held)
            # written so that a speed that is not a number counts as too fast
            if not np.abs(dq).max() < UNSTABLE_SPEED:
                row, joint = np.argwhere(~(np.abs(dq[:, places]) < UNSTABLE_SPEED))[0]
                t = commands[row].t[0] + i / controller.rate
                raise GapscopeError(
                    f"the rolled out arm diverged at joint {joint + 1}, at t = {t:.3g} s",
                    "check (a) the controller's gains and units, (b) that the parameters make a positive mass matrix, "
                    "(c) that reference and recording belong together",
                )
        found = (positions, filtered, torques)
        return tuple(
            RollOut(c.t, *(series[: len(c.t), k] for series in found))
            for k, c in enumerate(commands)
        )
