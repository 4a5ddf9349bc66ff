"""Realistic severities: every effect drawn at random, in proportion to the arm that it is put on.

What depends on the size of an arm is drawn relative to its torque, inertia and speed; what does not (times, angles,
shares) comes from the ranges met on real arms. Both are those of the catalogue's ``typical`` for arms of 5 to 30 kg.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.catalogue import effect as by_name

POSTURES = 50
"""Postures over which the scale of an arm is taken."""

Values = Mapping[str, np.ndarray | float]


class ArmScale(NamedTuple):
    """What is large on an arm with n joints.

    Attributes:
        torque: RMS of gravity plus dry friction, at least 5 % of the largest joint's [N m], shape (n,).
        inertia: mean of the bodies' inertia about each joint [kg m^2], (n,).
        rotor: nominal armature, a third of ``inertia`` where there is none [kg m^2], (n,).
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
        low, high = (np.clip(limit, -np.pi, np.pi) for limit in body.position_limits())
        q = low + np.random.default_rng(0).uniform(size=(POSTURES, arm.n_joints)) * (
            high - low
        )
        still = np.zeros_like(q)
        gravity = (
            np.sqrt(np.mean(body.inverse_dynamics(q, still, still) ** 2, axis=0))
            + arm.coulomb
        )
        inertia = np.mean([np.diag(body.mass_matrix(posture)) for posture in q], axis=0)
        torque = np.maximum(gravity, 0.05 * gravity.max())
        torque = np.maximum(torque, inertia)  # without gravity: 1 rad/s^2
        rotor = np.where(arm.armature > 0, arm.armature, inertia / 3)
        speed = body.velocity_limits()
        mass = body.inertial_parameters().reshape(-1, 10)[:, 0]
        return cls(
            torque,
            inertia,
            rotor,
            np.clip(np.where(speed > 0, speed, 1.0), 0.1, 2.0),
            mass,
            0.3 * mass.sum(),
        )


def possible(arm: NominalArm) -> tuple[str, ...]:
    """Effects that an arm can be given as it is: a motor of its own needs rotor inertia on every joint."""
    two_masses = ("joint_elasticity", "backlash")
    return tuple(
        name for name in CATALOGUE if name not in two_masses or (arm.armature > 0).all()
    )


def draw(
    name: str,
    rng: np.random.Generator,
    scale: ArmScale,
    joints: Sequence[int] | None = None,
) -> AppliedEffect:
    """An effect with values of the size that real arms have.

    Args:
        name: name in the catalogue.
        rng: source of the values.
        scale: of the arm.
        joints: joints from 1 that it acts on; one or two at random where ``None``. Of no meaning for arm and link.

    Raises:
        InputError: unknown effect.
    """
    definition = by_name(name)
    chosen: tuple[int, ...] = ()
    if definition.scope == "joint":
        n = len(scale.torque)
        some = (
            rng.choice(n, size=min(n, int(rng.integers(1, 3))), replace=False) + 1
            if joints is None
            else joints
        )
        chosen = tuple(sorted(int(joint) for joint in some))
    values = _DRAWS[name](rng, scale, np.array(chosen, dtype=int) - 1)
    clipped = {
        p.name: np.clip(values[p.name], *p.bounds) for p in definition.parameters
    }
    return AppliedEffect(name, chosen, clipped)


def _sign(rng: np.random.Generator, size: int | None = None) -> np.ndarray:
    return np.asarray(rng.choice([-1.0, 1.0], size))


def _log(rng: np.random.Generator, low: float, high: float, size: int) -> np.ndarray:
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def _stribeck(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    return {
        "torque": scale.torque[j] * rng.uniform(0.05, 0.2),
        "velocity": _log(rng, 0.02, 2.9, len(j)),
    }


def _drift(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    return {
        "amplitude": rng.uniform(0.2, 1.0, len(j)),
        "time_constant": _log(rng, 5.0, 300.0, len(j)),
    }


def _payload(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    com = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.0, 0.1)])
    return {"mass": scale.lift * rng.uniform(0.1, 0.6), "com": com}


def _link(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    link = int(rng.choice(np.flatnonzero(scale.mass > 0)))
    return {
        "link": np.array(link + 1.0),
        "mass": _sign(rng) * rng.uniform(0.1, 0.4) * scale.mass[link],
        "com": rng.uniform(-0.02, 0.02, 3),
    }


def _tilt(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    size, way = np.deg2rad(rng.uniform(0.5, 5.0)), rng.uniform(-np.pi, np.pi)
    return {"roll": size * np.cos(way), "pitch": size * np.sin(way)}


def _elasticity(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    w = 2 * np.pi * rng.uniform(8.0, 30.0, len(j))
    together = scale.rotor[j] * scale.inertia[j] / (scale.rotor[j] + scale.inertia[j])
    return {
        "stiffness": w**2 * together,
        "damping": 2 * rng.uniform(0.02, 0.1, len(j)) * w * together,
    }


def _ripple(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    return {
        "amplitude": scale.torque[j] * rng.uniform(0.02, 0.1, len(j)),
        "cycles": np.round(_log(rng, 2.0, 100.0, len(j))),
        "phase": rng.uniform(0.0, 2 * np.pi, len(j)),
    }


def _spring(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    return {
        "stiffness": scale.torque[j] * rng.uniform(0.1, 0.5),
        "rest": rng.uniform(-0.5, 0.5, len(j)),
    }


def _force(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    way, start = rng.standard_normal(3), rng.uniform(1.0, 4.0)
    force = 9.81 * scale.lift * rng.uniform(0.2, 0.6) * way / np.linalg.norm(way)
    return {
        "force": force,
        "start": np.array(start),
        "end": np.array(start + rng.uniform(0.5, 3.0)),
    }


_DRAWS: dict[str, Callable[[np.random.Generator, ArmScale, np.ndarray], Values]] = {
    "coulomb_friction": lambda rng, a, j: {
        "torque": a.torque[j] * rng.uniform(0.05, 0.3)
    },
    "viscous_friction": lambda rng, a, j: {
        "coefficient": a.torque[j] / a.speed[j] * rng.uniform(0.05, 0.3)
    },
    "stribeck_friction": _stribeck,
    "load_friction": lambda rng, a, j: {"coefficient": rng.uniform(0.03, 0.31, len(j))},
    "friction_drift": _drift,
    "payload": _payload,
    "link_inertia": _link,
    "armature": lambda rng, a, j: {"inertia": a.rotor[j] * rng.uniform(0.2, 1.0)},
    "base_tilt": _tilt,
    "joint_elasticity": _elasticity,
    "backlash": lambda rng, a, j: {"width": _log(rng, 0.0017, 0.0175, len(j))},
    "torque_ripple": _ripple,
    "parallel_spring": _spring,
    "torque_scale": lambda rng, a, j: {
        "scale": _sign(rng, len(j)) * rng.uniform(0.1, 0.3, len(j))
    },
    "torque_offset": lambda rng, a, j: {
        "torque": _sign(rng) * a.torque[j] * rng.uniform(0.05, 0.3)
    },
    "torque_saturation": lambda rng, a, j: {
        "limit": a.torque[j] * rng.uniform(1.0, 1.6)
    },
    "actuator_lag": lambda rng, a, j: {"time_constant": _log(rng, 0.005, 0.03, len(j))},
    "actuator_delay": lambda rng, a, j: {"delay": _log(rng, 0.002, 0.02, len(j))},
    "encoder_offset": lambda rng, a, j: {
        "offset": _sign(rng, len(j)) * rng.uniform(0.0175, 0.0873, len(j))
    },
    "encoder_quantization": lambda rng, a, j: {
        "step": 2 * np.pi / 2.0 ** rng.integers(10, 20, len(j), endpoint=True)
    },
    "external_force": _force,
}
