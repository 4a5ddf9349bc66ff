"""The actions: a joint torque, or a torque added to a low-gain PD with feedforward."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from arm.dynamics import RigidBody
from arm.motions import Workspace
from arm.nearest import check_known
from arm.nominal import NominalArm

KINDS = ("residual", "torque")
"""``torque``: the action is the commanded torque. ``residual``: it is added to PD and feedforward."""
SHARES = {"residual": 0.2, "torque": 1.0}
"""Torque of an action of 1 over the rated torque, by default."""
DAMPING = 0.7
"""Damping ratio of the PD loop [1]."""


class Gains(NamedTuple):
    """Gains of the PD law, each of shape (n,): N m/rad, N m s/rad."""

    kp: np.ndarray
    kd: np.ndarray


class Control(NamedTuple):
    """How actions become torque.

    Attributes:
        scale: torque of an action of 1 [N m], shape (n,).
        rated: rated torque [N m], shape (n,).
        limit: at which the commanded torque is clipped [N m], shape (n,).
        gains: of the PD loop with feedforward, or ``None`` where the action is the whole torque.
    """

    scale: np.ndarray
    rated: np.ndarray
    limit: np.ndarray
    gains: Gains | None


def torque_limit(arm: NominalArm, body: RigidBody) -> np.ndarray:
    """Torque that the arm is clipped at [N m], shape (n,): data sheet, else URDF, else none (infinite)."""
    if arm.torque_limit is not None:
        return arm.torque_limit
    effort = body.effort_limits()
    return np.where(effort > 0, effort, np.inf)


def rated_torque(limit: np.ndarray, body: RigidBody, posture: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Torque that an action of 1 stands for before its share [N m], shape (n,).

    The limit, and where there is none twice what gravity and inertia need at the posture, at least 1 N m.
    """
    inertia = np.diag(body.mass_matrix(posture))
    needed = 2 * (np.abs(body.bias(posture, np.zeros(len(posture)))) + inertia * acceleration)
    return np.where(np.isfinite(limit), limit, np.maximum(needed, 1.0))


def low_gains(arm: NominalArm, body: RigidBody, posture: np.ndarray, bandwidth: float) -> Gains:
    """Gains of a PD loop of w = 2 pi ``bandwidth`` [Hz]: kp = w^2 M + w b, kd = 2 zeta w M.

    M is the joint's own inertia M_ii + I_i at the posture [kg m^2], b its nominal viscous friction [N m s/rad], which
    already damps the loop.
    """
    inertia = np.diag(body.mass_matrix(posture)) + arm.armature
    w = 2 * np.pi * bandwidth
    return Gains(w**2 * inertia + w * arm.viscous, 2 * DAMPING * w * inertia)


def control(
    arm: NominalArm, body: RigidBody, space: Workspace, kind: str, share: float | None, bandwidth: float
) -> Control:
    """How actions of a kind become torque.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        space: where it moves.
        kind: one of ``KINDS``.
        share: torque of an action of 1 over the rated torque; that of ``SHARES`` where ``None``.
        bandwidth: of the PD loop [Hz].

    Raises:
        InputError: unknown kind.
    """
    check_known("action", kind, KINDS, where="action")
    limit = torque_limit(arm, body)
    rated = rated_torque(limit, body, space.posture, space.limits.acceleration)
    gains = low_gains(arm, body, space.posture, bandwidth) if kind == "residual" else None
    return Control((SHARES[kind] if share is None else share) * rated, rated, limit, gains)
