"""Forward dynamics: an arm simulated without an engine, and its sensitivity to parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from gapscope.arm.control import PD
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody, rnea_derivatives
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
        speed: velocity itself [rad/s], shape (K, n).
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    speed: np.ndarray


class Stepper:
    """Steps of an arm in R states at once; positions, velocities, torques of shape (R, n) in kinematic order.

    Args:
        body: rigid bodies of the arm; its inertias are replaced.
        parameters: what moves, (14 n,).
        dt: time step h [s].
        states: R.

    Attributes:
        order: ``q[order]`` is in kinematic order.
        smoothing: velocity scale of the smoothed sign [rad/s or m/s], shape (n,), in kinematic order.
    """

    def __init__(
        self, body: RigidBody, parameters: np.ndarray, dt: float, states: int = 1
    ) -> None:
        self.order = body.order
        self.smoothing = FRICTION_SMOOTHING * body.per_radian[self.order]
        self.dt = dt
        self._links = parameters[: 10 * body.n_joints].reshape(-1, 10).copy()
        nominal = body.inertial_parameters().reshape(-1, 10)
        self._moved = body.changed(self._links - nominal)
        # rotors hold the slope of friction, of each state its own: a model for each
        without = np.zeros(body.n_joints)
        self._forward = [ForwardDynamics(self._moved, without) for _ in range(states)]
        self.set_parameters(parameters)

    def set_parameters(self, parameters: np.ndarray) -> None:
        """Take other parameters, (14 n,)."""
        count = self._links.size
        links, drives = parameters[:count].reshape(-1, 10), parameters[count:]
        for place, link in enumerate(self.order):
            # a Jacobian changes one link at a time: the others are left as they are
            if np.array_equal(links[link], self._links[link]):
                continue
            for forward in self._forward:
                forward.set_link(place, links[link])
            self._links[link] = links[link]
        self._armature, self._viscous, self._coulomb, self._offset = drives.reshape(
            4, -1
        )[:, self.order]

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


def ticks_per_step(controller: PD) -> int:
    """Ticks of the controller that one step of the derivative spans."""
    return max(1, int(controller.rate * LONGEST_STEP + 1e-9))


def together(series: Sequence[np.ndarray]) -> np.ndarray:
    """R series of shape (K_r, ...) side by side, (K, R, ...); the last row of a shorter one is repeated."""
    longest = max(map(len, series))
    padded = []
    for rows in series:
        held = np.repeat(rows[-1:], longest - len(rows), axis=0)
        padded.append(np.concatenate([rows, held]))
    return np.stack(padded, axis=1)


# How rolled out motions and torques depend on the parameters: forward sensitivities of the closed loop.
#
# The step of ``gapscope.arm.dynamics.rollout`` is differentiated: with f = b v + c tanh(v / v0), slope b + s, and the
# acceleration a,
#
#     d a = -(M + I + h (b + s))^-1 (d ID/d q' dq' + d ID/d v dv + (f' + s' h a) dv + Y dpi - du),
#
# Y the columns of links, rotors and friction at (q', v, a). The controller's law and filter, linear both, pass dq and
# dv on to du. If ticks are closer than ``gapscope.arm.dynamics.rollout.LONGEST_STEP``, every so many make one step of
# that length: a derivative needs no finer one.


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
            parameters: what moves, (14 n,).
            commands: at the controller's ticks.
            starts: position [rad] and velocity [rad/s], each of shape (n,); the references' by default.

        Raises:
            GapscopeError: the arm diverged.
        """
        controller, steps = self.controller, steps_per_tick(self.controller)
        dt = 1.0 / (controller.rate * steps)
        stepper = Stepper(self.body, parameters, dt, len(commands))
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
        positions, filtered, torques, speeds = (np.empty_like(q_ref) for _ in range(4))
        for i in range(len(q_ref)):
            positions[i] = encoder = q[:, places]
            speeds[i] = dq[:, places]
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
        found = (positions, filtered, torques, speeds)
        return tuple(
            RollOut(c.t, *(series[: len(c.t), k] for series in found))
            for k, c in enumerate(commands)
        )

    def sensitivities(
        self,
        parameters: np.ndarray,
        rolled: Sequence[RollOut],
        directions: np.ndarray,
    ) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Derivatives of position [rad] and torque [N m] of roll-outs along b directions, for each of them.

        The starts do not depend on the parameters. Rows are those ticks of the roll-out that begin a step, K' of them,
        one of ``ticks_per_step``; each derivative has shape (K', n, b).

        Args:
            parameters: what moved, (14 n,).
            rolled: the roll-outs.
            directions: of the parameters, shape (14 n, b).
        """
        controller = self.controller
        every, steps = ticks_per_step(controller), steps_per_tick(controller)
        rate = controller.rate / every
        dt, states = 1.0 / (rate * steps), len(rolled)
        stepper = _TangentStepper(self.body, parameters, directions, dt, states)
        order, places = self.body.order, self.body.places
        q, speed, tau = (
            together([getattr(r, name)[::every] for r in rolled])
            for name in ("q", "speed", "tau")
        )
        # a torque at its limit depends on nothing
        unlimited = np.ones_like(tau)
        if self.limit is not None:
            unlimited = (np.abs(tau) < self.limit).astype(float)
        # the starts do not depend on the parameters
        at_rest = np.zeros((*q.shape[1:], directions.shape[1]))
        velocity = VelocityFilter(
            (rate, controller.velocity_cutoff, controller.velocity_damping),
            at_rest,
            at_rest,
            self.rule,
        )
        kp, kd = controller.kp[:, None], controller.kd[:, None]
        position_along = np.empty((*q.shape, directions.shape[1]))
        torque_along = np.empty_like(position_along)
        q_along, dq_along = at_rest, at_rest
        for i in range(len(q)):
            encoder_along = q_along[:, places]
            # the commands do not depend on the parameters: feedback alone is left
            feedback = kp * encoder_along + kd * velocity(encoder_along)
            command_along = -unlimited[i][..., None] * feedback
            position_along[i] = encoder_along
            torque_along[i] = command_along
            # linearised about the roll-out's own state, so that errors do not add up
            q_now, dq_now = q[i][:, order], speed[i][:, order]
            held, held_along = tau[i][:, order], command_along[:, order]
            for _ in range(steps):
                q_now, dq_now, q_along, dq_along = stepper.tangent(
                    (q_now, dq_now), held, (q_along, dq_along), held_along
                )
        lengths = [len(r.t[::every]) for r in rolled]
        return tuple(
            (position_along[:length, k], torque_along[:length, k])
            for k, length in enumerate(lengths)
        )


Pair = tuple[np.ndarray, np.ndarray]
"""Position and velocity, or their derivatives."""


class _TangentStepper(Stepper):
    """Steps with their derivatives (R, n, b) along directions of the 14 n parameters, (14 n, b); kinematic order."""

    def __init__(
        self,
        body: RigidBody,
        parameters: np.ndarray,
        directions: np.ndarray,
        dt: float,
        states: int,
    ) -> None:
        super().__init__(body, parameters, dt, states)
        n, b = body.n_joints, directions.shape[1]
        self._model = self._moved.model
        self._data = self._model.createData()
        links = directions[: 10 * n].reshape(n, 10, b)
        drives = directions[10 * n :].reshape(4, n, b)
        self._links_along = links[self.order].reshape(10 * n, b)
        self._drives_along = drives[:, self.order]
        self._diagonal = np.arange(n)
        self._matrices = np.empty((states, n, b))

    def tangent(
        self,
        state: Pair,
        torque: np.ndarray,
        along: Pair,
        torque_along: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """States after the step, and their derivatives, by position and velocity before it."""
        (q, dq), (q_along, dq_along) = state, along
        h, half = self.dt, 0.5 * self.dt
        armature, viscous, coulomb, offset = self._drives_along
        q_middle = q + half * dq
        q_middle_along = q_along + half * dq_along
        ddq = self.acceleration(q_middle, dq, torque)
        dq_after = dq + h * ddq
        slope, unit_friction, friction_by_dq = self._friction_along(dq, ddq)
        by_q, by_dq, mass, links = self._rigid(q_middle, dq, ddq)
        # the same matrix as in the step itself: M + I + h (b + s)
        mass[:, self._diagonal, self._diagonal] += self._armature + h * slope

        # right-hand side of M d(ddq) = d u - ID_q dq - ID_dq d(dq) - f_dq d(dq) - Y d(pi)
        right = torque_along - by_q @ q_middle_along - by_dq @ dq_along - links
        right -= friction_by_dq[..., None] * dq_along
        rotors = ddq[..., None] * armature
        # b acts at the velocity after the step, v + h a
        right -= rotors + dq_after[..., None] * viscous
        right -= unit_friction[..., None] * coulomb - offset

        dq_after_along = dq_along + h * np.linalg.solve(mass, right)
        q_after = q_middle + half * dq_after
        q_after_along = q_middle_along + half * dq_after_along
        return q_after, dq_after, q_after_along, dq_after_along

    def _rigid(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of ID in q and dq, mass matrix, all of shape (R, n, n), and Y along the links', (R, n, b)."""
        links = self._matrices
        model, data = self._model, self._data
        for row, state in enumerate(zip(q, dq, ddq, strict=True)):
            regressor = pin.computeJointTorqueRegressor(model, data, *state)
            links[row] = regressor @ self._links_along
        return *rnea_derivatives(model, data, q, dq, ddq), links

    def _friction_along(
        self, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slope b + s, friction of c = 1, and the derivative of friction in v, each of shape (R, n)."""
        scale, h = self.smoothing, self.dt
        x = dq / scale
        sign = np.tanh(x)
        sign_slope = 1 - sign**2
        fade = taper(x)
        # d(taper) / dx: at x = 0 it vanishes, and its quotient is lost in rounding
        moving = np.abs(x) > np.cbrt(np.finfo(float).eps)
        safe = np.where(moving, x, 1.0)
        quotient = sign_slope / safe - sign / safe**2
        curve = quotient * np.exp(-(x**2) / 16) - fade * x / 8
        curve = np.where(moving, curve, 0.0)
        per_speed = self._coulomb / scale
        slope = self._viscous + per_speed * fade
        unit = sign + fade / scale * h * ddq
        by_dq = self._viscous + per_speed * (sign_slope + curve * h * ddq / scale)
        return slope, unit, by_dq
