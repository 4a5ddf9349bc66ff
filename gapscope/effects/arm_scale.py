"""The size of an arm: what torque, inertia, speed and mass are large on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm

POSTURES = 50
"""Postures over which the scale of an arm is taken."""


def usual_load(arm: NominalArm) -> np.ndarray:
    """RMS of gravity over postures within the limits, plus dry friction [N m], shape (n,)."""
    body = RigidBody(arm)
    # the first is the zero posture
    gravity = body.gravity_torque(body.postures(POSTURES + 1)[1:])
    return np.sqrt(np.mean(gravity**2, axis=0)) + arm.coulomb


class ArmScale(NamedTuple):
    """What is large on an arm with n joints.

    Attributes:
        torque: RMS of gravity plus dry friction, at least 5 % of the largest joint's [N m], shape (n,).
        inertia: mean of the bodies' inertia about each joint [kg m^2], (n,).
        rotor: nominal armature, a third of ``inertia`` if there is none [kg m^2], (n,).
        speed: velocity limit, at most 2 rad/s [rad/s], (n,).
        mass: of the links [kg], (n,).
        lift: mass that the arm may carry [kg].
    """

    torque: np.ndarray
    inertia: np.ndarray
    rotor: np.ndarray
    speed: np.ndarray
    mass: np.ndarray
    lift: float

    @classmethod
    def of(cls, arm: NominalArm) -> ArmScale:
        """The scale of a nominal arm, from postures within its limits."""
        body = RigidBody(arm)
        q = body.postures(POSTURES + 1)[1:]
        gravity = usual_load(arm)
        inertia = np.mean([np.diag(body.mass_matrix(posture)) for posture in q], axis=0)
        # a joint whose axis lies along gravity bears no weight: it needs a size too
        torque = np.maximum(gravity, 0.05 * gravity.max())
        torque = np.maximum(torque, inertia)  # without gravity: 1 rad/s^2
        rotor = np.where(arm.armature > 0, arm.armature, inertia / 3)
        speed = body.velocity_limits()
        mass = body.inertial_parameters().reshape(-1, 10)[:, 0]
        return cls(
            torque,
            inertia,
            rotor,
            # a limit of zero is one that nobody gave
            np.clip(np.where(speed > 0, speed, 1.0), 0.1, 2.0),
            mass,
            0.3 * mass.sum(),
        )
