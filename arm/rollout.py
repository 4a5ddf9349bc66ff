"""A closed loop rolled out by pinocchio, without an engine: for output error, filters and hypotheses.

The arm obeys M(q) a + C(q, v) v + g(q) + I a + b v + c tanh(v / v0) = u + o. One step of h drifts by half a step,
solves for the acceleration there, and drifts on:

    q' = q + h v / 2,   (M(q') + I + h (b + s)) a = u + o - C(q', v) v - g(q') - b v - c tanh(v / v0),
    v+ = v + h a,   q+ = q' + h v+ / 2,   s = c / v0 tanh(x) / x exp(-(x / 4)^2) with x = v / v0.

Friction is taken at the velocity after the step: c tanh(v / v0) + s h a, whose slope s ends sliding without chatter,
however long the step, and vanishes where a joint moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arm.controller import Controller
from arm.dynamics import RigidBody
from arm.errors import GapscopeError
from arm.forward import ForwardDynamics
from arm.nominal import FRICTION_SMOOTHING
from arm.velocity_filter import VelocityFilter

UNSTABLE_SPEED = 50.0
"""A joint faster than this [rad/s] has lost its controller."""
LONGEST_STEP = 1e-3
"""The time step is the controller's period, divided until it is no longer than this [s]."""


@dataclass(frozen=True)
class Plant:
    """What a roll-out moves, n joints in the arm's order.

    Attributes:
        inertial: parameters of the links, shape (n, 10), in the order of ``arm.dynamics.INERTIAL_PARAMETERS``.
        armature: I [kg m^2], shape (n,).
        viscous: b [N m s/rad], shape (n,).
        coulomb: c [N m], shape (n,).
        offset: o, what reaches the joint beyond the commanded torque [N m], shape (n,).
    """

    inertial: np.ndarray
    armature: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, vector: np.ndarray) -> Plant:
        """From one vector of 14 n numbers: the links', then armature, viscous, coulomb, offset, joint by joint."""
        n = len(vector) // 14
        return cls(vector[: 10 * n].reshape(n, 10), *vector[10 * n :].reshape(4, n))


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
    """Steps of a plant; positions, velocities and torques of shape (n,) in kinematic order.

    Args:
        body: rigid bodies of the arm; its inertias are replaced by the plant's.
        plant: what moves.
        dt: time step h [s].

    Attributes:
        forward: its forward dynamics.
        order: ``q[order]`` is in kinematic order.
    """

    def __init__(self, body: RigidBody, plant: Plant, dt: float) -> None:
        own = body.inertial_parameters().reshape(-1, 10)
        self.order, self.dt, self._links = body.order, dt, plant.inertial.copy()
        self.forward = ForwardDynamics(body.changed(plant.inertial - own), plant.armature[self.order])
        self.set_drives(plant)

    def set_plant(self, plant: Plant) -> None:
        """Take another plant."""
        for place, link in enumerate(self.order):
            if (plant.inertial[link] != self._links[link]).any():
                self.forward.set_link(place, plant.inertial[link])
                self._links[link] = plant.inertial[link]
        self.set_drives(plant)

    def set_drives(self, plant: Plant) -> None:
        """Take rotors, friction and offset of a plant, not its links."""
        law = (plant.armature, plant.viscous, plant.coulomb, plant.offset)
        self._armature, self._viscous, self._coulomb, self._offset = (x[self.order] for x in law)

    def friction(self, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """B v + c tanh(v / v0) [N m], and the slope b + s [N m s/rad]; shape (n,) each."""
        x = dq / FRICTION_SMOOTHING
        bent = np.tanh(x)
        slope = self._coulomb / FRICTION_SMOOTHING * taper(x)
        return self._viscous * dq + self._coulomb * bent, self._viscous + slope

    def acceleration(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """A of the step [rad/s^2]; q is the position half a step on. Valid until the next call."""
        friction, slope = self.friction(dq)
        self.forward.set_rotors(self._armature + self.dt * slope)
        return self.forward.acceleration(q, dq, torque + self._offset - friction)

    def __call__(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity after one step under a torque [N m]."""
        half = 0.5 * self.dt
        middle = q + half * dq
        after = dq + self.dt * self.acceleration(middle, dq, torque)
        return middle + half * after, after


def taper(x: np.ndarray) -> np.ndarray:
    """tanh(x) / x exp(-(x / 4)^2) [1], any shape."""
    size = np.maximum(np.abs(x), 1e-9)
    return np.tanh(size) / size * np.exp(-0.0625 * size * size)


def steps_per_tick(controller: Controller) -> int:
    """Steps of the roll-out within one period of the controller."""
    return max(1, int(np.ceil(1.0 / (controller.rate * LONGEST_STEP) - 1e-9)))


def roll_out(
    body: RigidBody,
    plant: Plant,
    controller: Controller,
    commands: Commands,
    limit: np.ndarray | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    rule: str = "bilinear",
) -> RollOut:
    """Roll the closed loop out.

    At each tick tau = feedforward + kp (q_ref - q) + kd (dq_ref - dq), clipped, and held until the next.

    Args:
        body: rigid bodies of the nominal arm.
        plant: what moves.
        controller: in the arm's joint order.
        commands: at the controller's ticks.
        limit: of the torque [N m], shape (n,), or ``None``.
        start: position [rad] and velocity [rad/s], each of shape (n,); the reference's by default.
        rule: how the controller discretises its velocity filter, one of ``arm.velocity_filter.RULES``.

    Raises:
        GapscopeError: the arm ran away.
    """
    count = steps_per_tick(controller)
    stepper = Stepper(body, plant, 1.0 / (controller.rate * count))
    order, places = body.order, body.places
    kp, kd = controller.kp, controller.kd
    bound = np.full(len(kp), np.inf) if limit is None else limit
    first, speed = start or (commands.q[0], commands.dq[0])
    q, dq = first[order], speed[order]
    velocity = VelocityFilter(
        controller.rate, controller.velocity_cutoff, controller.velocity_damping, first, speed, rule
    )
    out = RollOut(commands.t, *(np.empty_like(commands.q) for _ in range(4)))
    for i in range(len(commands.t)):
        now = q[places]
        seen = velocity(now)
        torque = commands.torque[i] + kp * (commands.q[i] - now) + kd * (commands.dq[i] - seen)
        torque = np.minimum(np.maximum(torque, -bound), bound)
        out.q[i], out.dq[i], out.tau[i], out.speed[i] = now, seen, torque, dq[places]
        held = torque[order]
        for _ in range(count):
            q, dq = stepper(q, dq, held)
        if not np.abs(dq).max() < UNSTABLE_SPEED:
            joint = int(np.argmax(~(np.abs(dq[places]) < UNSTABLE_SPEED))) + 1
            raise GapscopeError(
                f"the rolled out arm ran away at joint {joint}, at t = {commands.t[i]:.3g} s",
                "check (a) the controller's gains and units, (b) that the parameters make a positive mass matrix, "
                "(c) that reference and recording belong together",
            )
    return out
