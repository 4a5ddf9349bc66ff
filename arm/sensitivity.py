"""How a rolled out motion and torque depend on the parameters: forward sensitivities of the closed loop.

The step of ``arm.rollout`` is differentiated: with f = b v + c tanh(v / v0), slope b + s, and the acceleration a,

    d a = -(M + I + h (b + s))^-1 (d ID/d q' dq' + d ID/d v dv + (f' + s' h a) dv + Y dpi - du),

Y the columns of links, rotors and friction at (q', v, a). The controller's law and filter, linear both, pass dq and dv
on to du.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from arm.controller import Controller
from arm.dynamics import RigidBody
from arm.nominal import FRICTION_SMOOTHING
from arm.rollout import Plant, RollOut, Stepper, steps_per_tick, taper
from arm.velocity_filter import VelocityFilter


def sensitivity(
    body: RigidBody,
    plant: Plant,
    controller: Controller,
    rolled: RollOut,
    directions: np.ndarray,
    limit: np.ndarray | None = None,
    rule: str = "bilinear",
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of position [rad] and torque [N m] of a roll-out along b directions; each of shape (K, n, b).

    The start does not depend on the parameters.

    Args:
        body: rigid bodies of the nominal arm.
        plant: what moved.
        controller: in the arm's joint order.
        rolled: the roll-out.
        directions: of the 14 n parameters, in the order of ``Plant.of``, shape (14 n, b).
        limit: of the torque [N m], shape (n,), or ``None``.
        rule: of the velocity filter.
    """
    n, b = rolled.q.shape[1], directions.shape[1]
    count = steps_per_tick(controller)
    step = _TangentStep(body, plant, directions, 1.0 / (controller.rate * count))
    order, places = body.order, body.places
    free = np.ones_like(rolled.tau) if limit is None else (np.abs(rolled.tau) < limit).astype(float)
    still = np.zeros((n, b))
    velocity = VelocityFilter(
        controller.rate, controller.velocity_cutoff, controller.velocity_damping, still, still, rule
    )
    position, torque = (np.empty((*rolled.q.shape, b)) for _ in range(2))
    q_along, dq_along = np.zeros((n, b)), np.zeros((n, b))
    for i in range(len(rolled.t)):
        now = q_along[places]
        u_along = -free[i][:, None] * (controller.kp[:, None] * now + controller.kd[:, None] * velocity(now))
        position[i], torque[i] = now, u_along
        q, dq, held = rolled.q[i][order], rolled.speed[i][order], rolled.tau[i][order]
        along = u_along[order]
        for _ in range(count):
            q, dq, q_along, dq_along = step(q, dq, held, q_along, dq_along, along)
    return position, torque


class _TangentStep:
    """One step and its derivative, in kinematic order; directions (n, b) for positions, velocities and torques."""

    def __init__(self, body: RigidBody, plant: Plant, directions: np.ndarray, dt: float) -> None:
        n, b = len(plant.armature), directions.shape[1]
        self._dt, self._plant = dt, plant
        own = body.inertial_parameters().reshape(-1, 10)
        self._stepper = Stepper(body, plant, dt)
        self._model = body.changed(plant.inertial - own).model
        self._data = self._model.createData()
        order = body.order
        self._links = directions[: 10 * n].reshape(n, 10, b)[order].reshape(10 * n, b)
        laws = directions[10 * n :].reshape(4, n, b)[:, order]
        self._armature, self._viscous, self._coulomb, self._offset = laws
        self._coulomb_value, self._viscous_value = plant.coulomb[order], plant.viscous[order]
        self._rotors, self._diagonal = plant.armature[order], np.diag_indices(n)
        self._upper = np.triu_indices(n, 1)
        self._lower = self._upper[::-1]

    def __call__(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        torque: np.ndarray,
        q_along: np.ndarray,
        dq_along: np.ndarray,
        torque_along: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """State after the step, and its derivatives."""
        h, half = self._dt, 0.5 * self._dt
        middle, middle_along = q + half * dq, q_along + half * dq_along
        a = self._stepper.acceleration(middle, dq, torque).copy()
        after = dq + h * a
        slope, unit, change = self._friction(dq, a)
        pin.computeRNEADerivatives(self._model, self._data, middle, dq, a)
        data = self._data
        mass = data.M.copy()
        mass[self._lower] = mass[self._upper]
        mass[self._diagonal] += self._rotors + h * slope
        right = torque_along - data.dtau_dq @ middle_along - data.dtau_dv @ dq_along
        right -= change[:, None] * dq_along
        right -= pin.computeJointTorqueRegressor(self._model, data, middle, dq, a) @ self._links
        right -= a[:, None] * self._armature + after[:, None] * self._viscous
        right -= unit[:, None] * self._coulomb - self._offset
        after_along = dq_along + h * np.linalg.solve(mass, right)
        return middle + half * after, after, middle_along + half * after_along, after_along

    def _friction(self, dq: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slope b + s, friction of c = 1, and the derivative of friction in v, each of shape (n,)."""
        scale, h = FRICTION_SMOOTHING, self._dt
        x = dq / scale
        bent = np.tanh(x)
        fade, safe = taper(x), np.where(np.abs(x) > 1e-4, x, 1.0)
        curve = ((1 - bent**2) / safe - bent / safe**2) * np.exp(-(x**2) / 16) - fade * x / 8
        curve = np.where(np.abs(x) > 1e-4, curve, 0.0)
        change = self._viscous_value + self._coulomb_value / scale * (1 - bent**2 + curve * h * a / scale)
        return self._viscous_value + self._coulomb_value / scale * fade, bent + fade / scale * h * a, change
