"""The transmission family: what lies between motor and joint, and what pulls on it.

A joint with elasticity or backlash has two masses: the motor with its rotor, its friction and usually its encoder, and
the link. Torque passes between them as a function of the twist theta - q and of its rate.
"""

from __future__ import annotations

import numpy as np

from gapscope.effects.effect import Parameter, Signals, TorqueLaw, Transmission


def elastic_deflection(
    torque: np.ndarray, stiffness: np.ndarray, damping: np.ndarray
) -> np.ndarray:
    """Theta - q = tau / k [rad]; tau in N m, k in N m/rad. Where k is 0 the effect is off."""
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
    """Theta - q = w / 2 sgn tau [rad]: the motor leans on the side that it drives; w is the whole free play."""
    return 0.5 * width * np.sign(torque)


def through_backlash(twist: np.ndarray, width: np.ndarray) -> np.ndarray:
    """What is left of a twist [rad] beyond free play of the whole width w [rad]; 0 inside it."""
    return twist - np.minimum(np.maximum(twist, -0.5 * width), 0.5 * width)


def spring(signals: Signals, stiffness: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """K (q - q0) [N m]; k in N m/rad, q and q0 in rad."""
    return stiffness * (signals.position - rest)


ELASTICITY = Transmission(
    name="joint_elasticity",
    family="transmission",
    scope="joint",
    equation="tau = k (theta - q) + d (dtheta - dq)",
    parameters=(
        Parameter("stiffness", "k", "N m/rad", (1.0, 1e7), (1e3, 5e4)),
        Parameter("damping", "d", "N m s/rad", (0.0, 1e4), (1.0, 50.0)),
    ),
    looks_like="a resonance, and a deflection that follows the torque",
    reference="deluca2016",
    confused_with=(
        ("armature", "a chirp past the resonance"),
        ("actuator_lag", "a chirp past the resonance, or an encoder on the link"),
    ),
    deflection=elastic_deflection,
    lag=elastic_lag,
)

BACKLASH = Transmission(
    name="backlash",
    family="transmission",
    scope="joint",
    equation="tau = 0 while |theta - q| < w / 2",
    parameters=(Parameter("width", "w", "rad", (0.0, 0.5), (0.0017, 0.0175)),),
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
)

SPRING = TorqueLaw(
    name="parallel_spring",
    family="transmission",
    scope="joint",
    equation="k (q - q0)",
    parameters=(
        Parameter(
            "stiffness", "k", "N m/rad", (-1e4, 1e4), (1.0, 50.0), increment=True
        ),
        Parameter("rest", "q0", "rad", (-7.0, 7.0), (-1.0, 1.0)),
    ),
    looks_like="a torque linear in the joint's position",
    reference="hollerbach2008",
    confused_with=(
        ("payload", "the same path with the other joints in another posture"),
        ("torque_offset", "static poses over the whole range of the joint"),
    ),
    law=spring,
)
