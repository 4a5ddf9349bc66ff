"""The feedforward torque that a controller adds to its PD law."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm, smooth_sign

KINDS = ("none", "gravity", "nominal")
"""What ``Controller.feedforward`` may be."""


def feedforward(
    arm: NominalArm,
    body: RigidBody,
    kind: str,
    q: np.ndarray,
    dq: np.ndarray,
    ddq: np.ndarray,
) -> np.ndarray:
    """Feedforward torque of a reference motion [N m], shape (N, n).

    ``none``: 0. ``gravity``: g(q). ``nominal``: M(q) ddq + C(q, dq) dq + g(q) + I ddq + c tanh(dq / v0) + b dq, the
    nominal arm's inverse dynamics with the data sheet's armature I, Coulomb c and viscous b friction; v0 is
    ``gapscope.arm.nominal.FRICTION_SMOOTHING``.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        kind: one of ``KINDS``.
        q, dq, ddq: reference position [rad], velocity [rad/s], acceleration [rad/s^2], each (N, n).

    Raises:
        InputError: unknown kind.
    """
    if kind == "none":
        return np.zeros_like(q)
    if kind == "gravity":
        return body.inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q))
    if kind == "nominal":
        friction = arm.coulomb * smooth_sign(dq / arm.per_radian) + arm.viscous * dq
        return body.inverse_dynamics(q, dq, ddq) + arm.armature * ddq + friction
    raise InputError(
        f"unknown feedforward {kind!r}",
        f"use one of {', '.join(KINDS)}",
        where="controller.feedforward",
    )
