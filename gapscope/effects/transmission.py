"""The transmission family: what lies between motor and joint, and what pulls on it.

A joint with elasticity or backlash has two masses: the motor with its rotor, its friction and usually its encoder, and
the link. Torque passes between them as a function of the twist theta - q and of its rate.
"""

from __future__ import annotations

import numpy as np

from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.effect import Signals, TorqueLaw, Transmission
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import (
    Parametrisation,
    Values,
    linear_in,
    nonzero,
)
from gapscope.effects.sampling import log_uniform


def elastic_deflection(
    torque: np.ndarray, stiffness: np.ndarray, damping: np.ndarray
) -> np.ndarray:
    """Theta - q = tau / k [rad]; tau in N m, k in N m/rad. If k is 0 the effect is off."""
    return np.where(
        stiffness > 0, torque / np.where(stiffness > 0, stiffness, 1.0), 0.0
    )


def elastic_lag(stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """D / k [s]: with the damper d beside it, the spring follows the torque late."""
    return np.where(
        stiffness > 0, damping / np.where(stiffness > 0, stiffness, 1.0), 0.0
    )


def no_lag(width: np.ndarray) -> np.ndarray:
    """0 s: free play is crossed at once."""
    return np.zeros_like(width)


def elastic_torque(
    twist: np.ndarray, rate: np.ndarray, stiffness: np.ndarray, damping: np.ndarray
) -> np.ndarray:
    """Tau = k (theta - q) + d (dtheta - dq) [N m]; twist in rad, rate in rad/s."""
    return stiffness * twist + damping * rate


def backlash_deflection(torque: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Theta - q = w / 2 sgn tau [rad]: the motor rests on the side that it drives; w is the whole free play."""
    return 0.5 * width * np.sign(torque)


def through_backlash(twist: np.ndarray, width: np.ndarray) -> np.ndarray:
    """The part of a twist [rad] beyond free play of the whole width w [rad]; 0 inside it."""
    return twist - np.minimum(np.maximum(twist, -0.5 * width), 0.5 * width)


def spring(signals: Signals, stiffness: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """K (q - q0) [N m]; k in N m/rad, q and q0 in rad."""
    return stiffness * (signals.position - rest)


def elasticity_values(x: np.ndarray, nonlinear: np.ndarray) -> Values:
    """Deflection = x0 tau - x1 dtau/dt, with x0 = 1 / k and x1 = d / k^2."""
    compliance = np.maximum(x[0], 1e-12)
    return {
        "stiffness": 1.0 / compliance,
        "damping": np.maximum(x[1], 0.0) / compliance**2,
    }


def spring_values(x: np.ndarray, nonlinear: np.ndarray) -> Values:
    """K (q - q0) = x0 q - x1."""
    return {"stiffness": x[0], "rest": x[1] / nonzero(x[0])}


def clip_elasticity(x: np.ndarray) -> np.ndarray:
    """x1 = d / k^2 moved to where the spring follows its torque within ``LONGEST_LAG``."""
    return np.stack([x[0], np.minimum(x[1], LONGEST_LAG * np.maximum(x[0], 0.0))])


def clip_spring(x: np.ndarray) -> np.ndarray:
    """x1 = k q0 moved to where q0 lies within its bounds."""
    farthest = REST.bounds[1] * np.abs(x[0])
    return np.stack([x[0], np.clip(x[1], -farthest, farthest)])


def draw_elasticity(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """A resonance of motor and link at 8 to 30 Hz, damped by 2 to 10 %."""
    resonance = 2 * np.pi * rng.uniform(8.0, 30.0, len(j))
    reduced = scale.rotor[j] * scale.inertia[j] / (scale.rotor[j] + scale.inertia[j])
    return {
        "stiffness": resonance**2 * reduced,
        "damping": 2 * rng.uniform(0.02, 0.1, len(j)) * resonance * reduced,
    }


def draw_backlash(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """0.1 to 1 degree."""
    return {"width": log_uniform(rng, 0.0017, 0.0175, len(j))}


def draw_spring(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """10 to 50 % of the torque of each joint at one radian."""
    return {
        "stiffness": scale.torque[j] * rng.uniform(0.1, 0.5),
        "rest": rng.uniform(-0.5, 0.5, len(j)),
    }


PLAY_WIDTH = Parameter("width", "w", "rad", (0.0, 0.5), (0.0017, 0.0175))
REST = Parameter("rest", "q0", "rad", (-7.0, 7.0), (-1.0, 1.0), severity=0)
LONGEST_LAG = 0.05
"""Longest d / k [s] of a gear: 2 z / w, critical damping at 6 Hz; what creeps longer is no spring."""
COMPLIANCE_STEP = 1e-6
"""Step of compliance [rad/(N m)] and of free play [rad] for finite differences; the torque is far from linear."""


ELASTICITY = Transmission(
    name="joint_elasticity",
    family="transmission",
    scope="joint",
    equation="tau = k (theta - q) + d (dtheta - dq)",
    parameters=(
        Parameter("stiffness", "k", "N m/rad", (1.0, 1e9), (1e3, 5e4), severity=-1),
        Parameter("damping", "d", "N m s/rad", (0.0, 1e6), (1.0, 50.0), severity=-1),
    ),
    looks_like="a resonance, and a deflection that follows the torque",
    reference="deluca2016",
    confused_with=(
        ("armature", "a chirp past the resonance"),
        ("actuator_lag", "a chirp past the resonance, or an encoder on the link"),
    ),
    deflection=elastic_deflection,
    lag=elastic_lag,
    parametrisation=Parametrisation(
        elasticity_values,
        linear=2,
        step=COMPLIANCE_STEP,
        lowest=0.0,
        clip=clip_elasticity,
    ),
    severity=draw_elasticity,
    quantities={"stiffness": "gear_stiffness", "damping": "gear_damping"},
)

BACKLASH = Transmission(
    name="backlash",
    family="transmission",
    scope="joint",
    equation="tau = 0 while |theta - q| < w / 2",
    parameters=(PLAY_WIDTH,),
    looks_like="free play, then an impact, where the torque changes its sign",
    reference="nordin2002",
    confused_with=(
        (
            "coulomb_friction",
            "a motion during which gravity keeps the gear on one side",
        ),
        ("stribeck_friction", "slow ramps in both directions"),
    ),
    deflection=backlash_deflection,
    lag=no_lag,
    parametrisation=linear_in(PLAY_WIDTH, step=COMPLIANCE_STEP, lowest=0.0),
    severity=draw_backlash,
    quantities={"width": "play"},
)

SPRING = TorqueLaw(
    name="parallel_spring",
    family="transmission",
    scope="joint",
    equation="k (q - q0)",
    parameters=(
        Parameter(
            "stiffness", "k", "N m/rad", (-1e6, 1e6), (1.0, 50.0), increment=True
        ),
        REST,
    ),
    looks_like="a torque linear in the joint's position",
    reference="hollerbach2008",
    confused_with=(
        ("payload", "the same path with the other joints in another posture"),
        ("torque_offset", "static poses over the whole range of the joint"),
    ),
    law=spring,
    # so wide a step leaves the bound of the rest, at which the law is not linear
    parametrisation=Parametrisation(
        spring_values, linear=2, step=1.0, clip=clip_spring
    ),
    severity=draw_spring,
    side="link",
    inherent=True,
    simplified=True,
    quantities={"stiffness": "stiffness", "rest": "rest"},
)
