"""How rolled out motions and torques depend on the parameters: forward sensitivities of the closed loop.

The step of ``gapscope.arm.dynamics.rollout`` is differentiated: with f = b v + c tanh(v / v0), slope b + s, and the
acceleration a,

    d a = -(M + I + h (b + s))^-1 (d ID/d q' dq' + d ID/d v dv + (f' + s' h a) dv + Y dpi - du),

Y the columns of links, rotors and friction at (q', v, a). The controller's law and filter, linear both, pass dq and dv
on to du. If ticks are closer than ``gapscope.arm.dynamics.rollout.LONGEST_STEP``, every so many make one step of
that length: a derivative needs no finer one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from gapscope.arm.control.pd import PD
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
from gapscope.arm.velocity_filter import VelocityFilter


def ticks_per_step(controller: PD) -> int:
    """Ticks of the controller that one step of the derivative spans."""
    return max(1, int(controller.rate * LONGEST_STEP + 1e-9))


def sensitivity(
    body: RigidBody,
    plant: Plant,
    controller: PD,
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
    every = ticks_per_step(controller)
    steps = steps_per_tick(controller)
    rate = controller.rate / every
    step = _TangentStep(body, plant, directions, 1.0 / (rate * steps), len(rolled))
    order, places = body.order, body.places
    q = together([r.q[::every] for r in rolled])
    speed = together([r.speed[::every] for r in rolled])
    tau = together([r.tau[::every] for r in rolled])
    # a torque at its limit depends on nothing
    unlimited = np.ones_like(tau)
    if limit is not None:
        unlimited = (np.abs(tau) < limit).astype(float)
    # the starts do not depend on the parameters
    at_rest = np.zeros((*q.shape[1:], directions.shape[1]))
    velocity = VelocityFilter(
        rate,
        controller.velocity_cutoff,
        controller.velocity_damping,
        at_rest,
        at_rest,
        rule,
    )
    kp = controller.kp[:, None]
    kd = controller.kd[:, None]
    position_along = np.empty((*q.shape, directions.shape[1]))
    torque_along = np.empty_like(position_along)
    q_along, dq_along = at_rest, at_rest
    for i in range(len(q)):
        encoder_along = q_along[:, places]
        feedback = kp * encoder_along + kd * velocity(encoder_along)
        command_along = -unlimited[i][..., None] * feedback
        position_along[i] = encoder_along
        torque_along[i] = command_along
        # linearised about the roll-out's own state, so that errors do not add up
        q_now, dq_now = q[i][:, order], speed[i][:, order]
        held, held_along = tau[i][:, order], command_along[:, order]
        for _ in range(steps):
            q_now, dq_now, q_along, dq_along = step(
                q_now, dq_now, held, q_along, dq_along, held_along
            )
    lengths = [len(r.t[::every]) for r in rolled]
    return tuple(
        (position_along[:length, k], torque_along[:length, k])
        for k, length in enumerate(lengths)
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
        order = body.order
        self._dt = dt
        self._stepper = Stepper(body, plant, dt, states)
        nominal = body.inertial_parameters().reshape(-1, 10)
        self._model = body.changed(plant.inertial - nominal).model
        self._data = self._model.createData()
        links = directions[: 10 * n].reshape(n, 10, b)
        drives = directions[10 * n :].reshape(4, n, b)
        self._links_along = links[order].reshape(10 * n, b)
        (
            self._armature_along,
            self._viscous_along,
            self._coulomb_along,
            self._offset_along,
        ) = drives[:, order]
        self._coulomb = plant.coulomb[order]
        self._viscous = plant.viscous[order]
        self._armature = plant.armature[order]
        self._diagonal = np.arange(n)
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
        q_middle = q + half * dq
        q_middle_along = q_along + half * dq_along
        ddq = self._stepper.acceleration(q_middle, dq, torque)
        dq_after = dq + h * ddq
        slope, unit_friction, friction_by_dq = self._friction(dq, ddq)
        by_q, by_dq, mass, links = self._rigid(q_middle, dq, ddq)
        mass[:, self._diagonal, self._diagonal] += self._armature + h * slope

        # right-hand side of M d(ddq) = d u - ID_q dq - ID_dq d(dq) - f_dq d(dq) - Y d(pi)
        right = torque_along - by_q @ q_middle_along - by_dq @ dq_along - links
        right -= friction_by_dq[..., None] * dq_along
        rotors = ddq[..., None] * self._armature_along
        right -= rotors + dq_after[..., None] * self._viscous_along
        right -= unit_friction[..., None] * self._coulomb_along - self._offset_along

        dq_after_along = dq_along + h * np.linalg.solve(mass, right)
        q_after = q_middle + half * dq_after
        q_after_along = q_middle_along + half * dq_after_along
        return q_after, dq_after, q_after_along, dq_after_along

    def _rigid(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of ID in q and dq, mass matrix, all of shape (R, n, n), and Y along the links', (R, n, b)."""
        n, b = len(self._diagonal), self._links_along.shape[1]
        by_q, by_dq, mass = self._matrices[:3, :, :, :n]
        links = self._matrices[3, :, :, :b]
        model, data = self._model, self._data
        for row in range(len(q)):
            state = q[row], dq[row], ddq[row]
            pin.computeRNEADerivatives(model, data, *state)
            by_q[row] = data.dtau_dq
            by_dq[row] = data.dtau_dv
            mass[row] = data.M
            regressor = pin.computeJointTorqueRegressor(model, data, *state)
            links[row] = regressor @ self._links_along
        # pinocchio fills the upper triangle alone
        above = np.triu(mass, 1)
        symmetric = np.triu(mass) + above.transpose(0, 2, 1)
        return by_q, by_dq, symmetric, links

    def _friction(
        self, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slope b + s, friction of c = 1, and the derivative of friction in v, each of shape (R, n)."""
        scale, h = self._stepper.smoothing, self._dt
        x = dq / scale
        sign = np.tanh(x)
        sign_slope = 1 - sign**2
        fade = taper(x)
        # d(taper) / dx, whose quotient has no limit that a computer finds at x = 0
        moving = np.abs(x) > 1e-4
        safe = np.where(moving, x, 1.0)
        quotient = sign_slope / safe - sign / safe**2
        curve = quotient * np.exp(-(x**2) / 16) - fade * x / 8
        curve = np.where(moving, curve, 0.0)
        per_speed = self._coulomb / scale
        slope = self._viscous + per_speed * fade
        unit = sign + fade / scale * h * ddq
        by_dq = self._viscous + per_speed * (sign_slope + curve * h * ddq / scale)
        return slope, unit, by_dq
