"""How rolled out motions and torques depend on the parameters: forward sensitivities of the closed loop.

The step of ``gapscope.arm.dynamics.rollout`` is differentiated: with f = b v + c tanh(v / v0), slope b + s, and the
acceleration a,

    d a = -(M + I + h (b + s))^-1 (d ID/d q' dq' + d ID/d v dv + (f' + s' h a) dv + Y dpi - du),

Y the columns of links, rotors and friction at (q', v, a). The controller's law and filter, linear both, pass dq and dv
on to du. Where ticks are closer than ``gapscope.arm.dynamics.rollout.LONGEST_STEP``, every so many make one step of
that length: a derivative needs no finer one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import (
    LONGEST_STEP,
    Plant,
    RollOut,
    Stepper,
    steps_per_tick,
    taper,
    together,
)
from gapscope.arm.nominal import FRICTION_SMOOTHING
from gapscope.arm.velocity_filter import VelocityFilter


def ticks_per_step(controller: Controller) -> int:
    """Ticks of the controller that one step of the derivative spans."""
    return max(1, int(controller.rate * LONGEST_STEP + 1e-9))


def sensitivity(
    body: RigidBody,
    plant: Plant,
    controller: Controller,
    rolled: Sequence[RollOut],
    directions: np.ndarray,
    limit: np.ndarray | None = None,
    rule: str = "bilinear",
) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Derivatives of position [rad] and torque [N m] of roll-outs along b directions, for each of them.

    The starts do not depend on the parameters. Rows are those ticks of the roll-out that begin a step, K' of them, one
    of ``ticks_per_step``; each derivative has shape (K', n, b).

    Args:
        body: rigid bodies of the nominal arm.
        plant: what moved.
        controller: in the arm's joint order.
        rolled: the roll-outs.
        directions: of the 14 n parameters, in the order of ``Plant.of``, shape (14 n, b).
        limit: of the torque [N m], shape (n,), or ``None``.
        rule: of the velocity filter.
    """
    every, count = ticks_per_step(controller), steps_per_tick(controller)
    rate = controller.rate / every
    step = _TangentStep(body, plant, directions, 1.0 / (rate * count), len(rolled))
    order, places = body.order, body.places
    q, speed, tau = (
        together([getattr(r, name)[::every] for r in rolled])
        for name in ("q", "speed", "tau")
    )
    free = np.ones_like(tau) if limit is None else (np.abs(tau) < limit).astype(float)
    still = np.zeros((*q.shape[1:], directions.shape[1]))
    velocity = VelocityFilter(
        rate,
        controller.velocity_cutoff,
        controller.velocity_damping,
        still,
        still,
        rule,
    )
    kp, kd = controller.kp[:, None], controller.kd[:, None]
    position, torque = (np.empty((*q.shape, directions.shape[1])) for _ in range(2))
    q_along, dq_along = still, still
    for i in range(len(q)):
        now = q_along[:, places]
        u_along = -free[i][..., None] * (kp * now + kd * velocity(now))
        position[i], torque[i] = now, u_along
        at, dq, held = (x[i][:, order] for x in (q, speed, tau))
        along = u_along[:, order]
        for _ in range(count):
            at, dq, q_along, dq_along = step(at, dq, held, q_along, dq_along, along)
    lengths = [len(r.t[::every]) for r in rolled]
    return tuple(
        (position[:length, k], torque[:length, k]) for k, length in enumerate(lengths)
    )


class _TangentStep:
    """One step and its derivative in R states at once, in kinematic order; (R, n) and along directions (R, n, b)."""

    def __init__(
        self,
        body: RigidBody,
        plant: Plant,
        directions: np.ndarray,
        dt: float,
        states: int,
    ) -> None:
        n, b = len(plant.armature), directions.shape[1]
        self._dt = dt
        own = body.inertial_parameters().reshape(-1, 10)
        self._stepper = Stepper(body, plant, dt, states)
        self._model = body.changed(plant.inertial - own).model
        self._data = self._model.createData()
        order = body.order
        self._links = directions[: 10 * n].reshape(n, 10, b)[order].reshape(10 * n, b)
        laws = directions[10 * n :].reshape(4, n, b)[:, order]
        self._armature, self._viscous, self._coulomb, self._offset = laws
        self._coulomb_value, self._viscous_value = (
            plant.coulomb[order],
            plant.viscous[order],
        )
        self._rotors, self._diagonal = plant.armature[order], np.arange(n)
        self._matrices = np.empty((4, states, n, max(n, b)))

    def __call__(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        torque: np.ndarray,
        q_along: np.ndarray,
        dq_along: np.ndarray,
        torque_along: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """States after the step, and their derivatives."""
        h, half = self._dt, 0.5 * self._dt
        middle, middle_along = q + half * dq, q_along + half * dq_along
        a = self._stepper.acceleration(middle, dq, torque)
        after = dq + h * a
        slope, unit, change = self._friction(dq, a)
        in_q, in_dq, mass, links = self._rigid(middle, dq, a)
        mass[:, self._diagonal, self._diagonal] += self._rotors + h * slope
        right = torque_along - in_q @ middle_along - in_dq @ dq_along - links
        right -= change[..., None] * dq_along
        right -= a[..., None] * self._armature + after[..., None] * self._viscous
        right -= unit[..., None] * self._coulomb - self._offset
        after_along = dq_along + h * np.linalg.solve(mass, right)
        return (
            middle + half * after,
            after,
            middle_along + half * after_along,
            after_along,
        )

    def _rigid(
        self, q: np.ndarray, dq: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of ID in q and dq, mass matrix, all of shape (R, n, n), and Y along the links', (R, n, b)."""
        n, b = len(self._diagonal), self._links.shape[1]
        in_q, in_dq, mass = self._matrices[:3, :, :, :n]
        links = self._matrices[3, :, :, :b]
        model, data = self._model, self._data
        for row in range(len(q)):
            pin.computeRNEADerivatives(model, data, q[row], dq[row], a[row])
            in_q[row], in_dq[row], mass[row] = data.dtau_dq, data.dtau_dv, data.M
            links[row] = (
                pin.computeJointTorqueRegressor(model, data, q[row], dq[row], a[row])
                @ self._links
            )
        above = np.triu(mass, 1)
        return in_q, in_dq, np.triu(mass) + above.transpose(0, 2, 1), links

    def _friction(
        self, dq: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slope b + s, friction of c = 1, and the derivative of friction in v, each of shape (R, n)."""
        scale, h = FRICTION_SMOOTHING, self._dt
        x = dq / scale
        bent = np.tanh(x)
        fade, safe = taper(x), np.where(np.abs(x) > 1e-4, x, 1.0)
        curve = ((1 - bent**2) / safe - bent / safe**2) * np.exp(
            -(x**2) / 16
        ) - fade * x / 8
        curve = np.where(np.abs(x) > 1e-4, curve, 0.0)
        change = self._viscous_value + self._coulomb_value / scale * (
            1 - bent**2 + curve * h * a / scale
        )
        return (
            self._viscous_value + self._coulomb_value / scale * fade,
            bent + fade / scale * h * a,
            change,
        )
