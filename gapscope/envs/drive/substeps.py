"""Into how many parts a time step must be divided, so that springs in and beside the joints are followed."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.effects.catalogue import of_quantity
from gapscope.envs.drive.two_mass import MOST_SUBSTEPS, RESOLUTION

POSTURES = 12
"""Postures of the arm at which its inertia is looked at, the straight one among them."""


def mass_matrices(body: RigidBody) -> np.ndarray:
    """Mass matrices over postures within the limits [kg m^2], shape (POSTURES, n, n), joints in kinematic order."""
    low, high = body.position_limits()
    low, high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    share = np.random.default_rng(0).uniform(size=(POSTURES - 1, body.n_joints))
    postures = np.vstack([np.zeros(body.n_joints), low + share * (high - low)])
    return np.array([body.mass_matrix(q)[body.order][:, body.order] for q in postures])


def least_inertia(masses: np.ndarray) -> np.ndarray:
    """Smallest inertia that each joint feels while the others are free, 1 / (M^-1)_jj [kg m^2], shape (n,)."""
    return (1.0 / np.diagonal(np.linalg.inv(masses), axis1=1, axis2=2)).min(axis=0)


def substeps(
    masses: np.ndarray,
    rotors: np.ndarray,
    elastic: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    spring: np.ndarray,
    dt: float,
) -> int:
    """Parts of a step of dt [s] of which the fastest resonance sees w h below ``RESOLUTION``.

    Args:
        masses: mass matrices of the bodies [kg m^2], shape (K, n, n).
        rotors: [kg m^2], shape (n,).
        elastic: mask of the joints with two masses, shape (n,).
        stiffness, damping: of their transmission [N m/rad], [N m s/rad], shape (n,).
        spring: stiffness of parallel springs [N m/rad], shape (n,).
        dt: time step [s].

    Raises:
        InputError: more than ``MOST_SUBSTEPS`` are needed; names the joint and the step that would do.
    """
    n, worst, joint, where = len(rotors), 0.0, 0, ""
    if not (elastic.any() or spring.any()):
        return 1
    motor = np.where(elastic, rotors, 1.0)
    for mass in masses:
        inertia = np.zeros((2 * n, 2 * n))
        inertia[:n, :n] = mass + np.diag(np.where(elastic, 0.0, rotors))
        inertia[n:, n:] = np.diag(motor)
        root = np.linalg.inv(np.linalg.cholesky(inertia))
        for values, power in ((stiffness, 0.5), (damping, 1.0)):
            k, s = (
                np.diag(np.where(elastic, values, 0.0)),
                np.diag(np.abs(spring) if power == 0.5 else 0.0 * spring),
            )
            rates, modes = np.linalg.eigh(
                root @ np.block([[k + s, -k], [-k, k]]) @ root.T
            )
            if rates[-1] ** power > worst:
                worst = float(rates[-1] ** power)
                shape = np.abs(root.T @ modes[:, -1])
                joint = int((shape[:n] + shape[n:] * elastic).argmax())
                inside = "gear_stiffness" if power == 0.5 else "gear_damping"
                effect, name = of_quantity(inside if elastic[joint] else "stiffness")
                where = f"{effect.name}.{name}"
    parts = max(1, int(np.ceil(worst * dt / RESOLUTION - 1e-9)))
    if parts > MOST_SUBSTEPS:
        raise InputError(
            f"the stiffness or damping about joint {joint + 1} moves at {worst:.3g} rad/s, which steps of {dt:.3g} s "
            f"cannot hold, even in {MOST_SUBSTEPS} parts",
            f"use steps of at most {MOST_SUBSTEPS * RESOLUTION / worst:.2g} s, a lower stiffness or damping, or more "
            "rotor inertia",
            where=where,
        )
    return parts
