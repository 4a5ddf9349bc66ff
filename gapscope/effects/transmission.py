"""The transmission family: what lies between motor and joint, and what pulls on it.

A joint with elasticity or backlash has two masses: the motor with its rotor, its friction and usually its encoder, and
the link. Torque passes between them as a function of the twist theta - q and of its rate.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.deflection import Springs, through_play, through_springs
from gapscope.effects.effect import Mechanics, TorqueLaw, Transmission
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import (
    Parametrisation,
    Values,
    linear_in,
    nonzero,
)
from gapscope.effects.signals import Drawn, drawn, slow_with_rates


def over(values: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Values over stiffness; 0 where there is none."""
    present = stiffness > 0
    return np.where(present, values / np.where(present, stiffness, 1.0), 0.0)


def elastic_deflection(
    torque: np.ndarray, stiffness: np.ndarray, damping: np.ndarray
) -> np.ndarray:
    """Theta - q = tau / k [rad]; tau in N m, k in N m/rad. If k is 0 the effect is off."""
    return over(torque, stiffness)


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


def elasticity_starts(inertia: float, torque: np.ndarray) -> Iterator[np.ndarray]:
    """Compliance and d / k^2 of resonances of what the joint moves, with some damping ratios."""
    for resonance in RESONANCES:
        stiffness = inertia * (2 * np.pi * resonance) ** 2
        for ratio in DAMPING_RATIOS:
            damping = 2 * ratio * np.sqrt(stiffness * inertia)
            # the coordinates that a fit has: 1 / k and d / k^2
            yield np.array([1 / stiffness, damping / stiffness**2])


def backlash_starts(inertia: float, torque: np.ndarray) -> Iterator[np.ndarray]:
    """Widths of free play; none if the torque never changes its sign, as the gear then stays on one side."""
    if torque.min() < 0 < torque.max():
        yield from PLAY_WIDTHS[:, None]


def elasticity_columns(
    effect: Transmission, at: Mechanics, x: np.ndarray
) -> np.ndarray:
    """Derivatives by compliance and d / k^2, (N, n, 2, n): where elasticity begins, and around values in use.

    A joint that bends by torque times compliance, less damping times its rate, moves its link as slowly. Around values
    that are not zero the springs are followed.
    """
    twist = at.transmitted
    # deflection = x0 tau - x1 dtau/dt: its derivatives by x0 and x1
    per_coordinate = (twist, -np.gradient(twist, at.motion.t, axis=0))
    out = np.empty((*twist.shape, *x.shape))
    for i, unit in enumerate(per_coordinate):
        deflections = slow_with_rates(unit, at.motion)
        pairs = zip(at.sensitivities, deflections, strict=True)
        # links that lag by y take its derivatives times y from the torque
        out[:, :, i] = -sum(matrix * y[:, None] for matrix, y in pairs)
    used, springs = np.flatnonzero(x[0]), None
    stiffness, damping = (at.value(effect.name, name) for name in effect.names)
    # one behind free play of its own joint is no spring, nor is one that cannot hold its link
    if used.size and not at.value("backlash", "width")[stiffness > 0].any():
        torque = at.rigid_with(effect, np.zeros_like(x))
        springs = Springs(at.sensitivities, at.motion, torque, stiffness, damping)
    largest = np.abs(x[0]).max()
    for i, j in ((i, j) for j in used for i in range(len(x))):
        # a damping of zero has a step too: in proportion to the largest value
        size = max(abs(x[i, j]), 1e-3 * largest)
        moved, step = x.copy(), 1e-4 * size
        if springs is None or not springs.followed:
            moved[i, j] += 1e-3 * size
            out[:, :, i, j] = (at.rigid_with(effect, moved) - at.rigid) / (1e-3 * size)
            continue
        # by stiffness and damping, and of these by the coordinate
        ends = []
        for side in (step, -step):
            moved[i, j] = x[i, j] + side
            ends.append(effect.values_at(moved[:, [j]]))
        # the springs count only joints that have one
        place = int(np.searchsorted(springs.elastic, j))
        out[:, :, i, j] = sum(
            columns[:, :, place] * ((ends[0][name] - ends[1][name]) / (2 * step))
            for columns, name in zip(springs.columns, effect.names, strict=True)
        )
    return out


def backlash_columns(effect: Transmission, at: Mechanics, x: np.ndarray) -> np.ndarray:
    """Derivatives by the width, (N, n, 1, n): where free play begins, and around widths in use.

    Its motion is no smooth function of the width: a link that rebounds once more or less takes another course, so that
    a small step measures single impacts, not the width.
    """
    out = np.array(at.nominal_play(PLAY_START)[:, :, None])
    for j in np.flatnonzero(x[0]):
        step = np.zeros_like(x)
        step[0, j] = PLAY_STEP * abs(x[0, j])
        above, below = (at.rigid_with(effect, x + side) for side in (step, -step))
        out[:, :, 0, j] = (above - below) / (2 * step[0, j])
    return out


def elasticity_values(x: np.ndarray, nonlinear: np.ndarray) -> Values:
    """Deflection = x0 tau - x1 dtau/dt, with x0 = 1 / k and x1 = d / k^2."""
    compliance = np.maximum(x[0], 1e-12)
    return {
        "stiffness": 1.0 / compliance,
        "damping": np.maximum(x[1], 0.0) / compliance**2,
    }


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
    # two masses on a spring swing about each other with their reduced inertia
    reduced = scale.rotor[j] * scale.inertia[j] / (scale.rotor[j] + scale.inertia[j])
    return {
        "stiffness": resonance**2 * reduced,
        "damping": 2 * rng.uniform(0.02, 0.1, len(j)) * resonance * reduced,
    }


PLAY_WIDTH = Parameter("width", "w", "rad", (0.0, 0.5), (0.0017, 0.0175))
REST = Parameter("rest", "q0", "rad", (-7.0, 7.0), (-1.0, 1.0), severity=0)
LONGEST_LAG = 0.05
"""Longest d / k [s] of a gear: 2 z / w, critical damping at 6 Hz; what creeps longer is no spring."""
COMPLIANCE_STEP = 1e-6
"""Step of compliance [rad/(N m)] and of free play [rad] for finite differences; the torque is far from linear."""
RESONANCES = np.geomspace(1.2, 20.0, 12)
"""Resonances with which elasticity is tried [Hz]: those of joints that are not stiff. (physical)"""
DAMPING_RATIOS = (0.02, 0.12)
"""Damping ratios with which they are [1]: of steel, and of rubber. (physical)"""
PLAY_WIDTHS = np.geomspace(4e-4, 6e-2, 11)
"""Widths with which free play is tried [rad]. (physical)"""
PLAY_START = 0.004
"""Free play with which the columns of backlash begin [rad]. (hand)"""
PLAY_STEP = 0.15
"""Step of free play, over its width, for the difference by it [1]. (hand)"""


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
    # with the damper beside it, the spring follows the torque late
    lag=lambda stiffness, damping: over(damping, stiffness),
    behind=through_springs,
    derivatives=elasticity_columns,
    starts=elasticity_starts,
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
    lag=np.zeros_like,
    # the gear is closed by its teeth
    behind=lambda matrices, motion, torque, width: through_play(
        matrices, motion, torque, width, *np.zeros((2, len(width)))
    ),
    derivatives=backlash_columns,
    starts=backlash_starts,
    parametrisation=linear_in(PLAY_WIDTH, step=COMPLIANCE_STEP, lowest=0.0),
    severity=drawn(width=Drawn(0.0017, 0.0175, log=True)),
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
    law=lambda signals, stiffness, rest: stiffness * (signals.position - rest),
    # so wide a step leaves the bound of the rest, at which the law is not linear
    parametrisation=Parametrisation(
        lambda x, _: {"stiffness": x[0], "rest": x[1] / nonzero(x[0])},
        linear=2,
        step=1.0,
        constant=1,
        clip=clip_spring,
    ),
    severity=drawn(
        stiffness=Drawn(0.1, 0.5, of="torque", each=False), rest=Drawn(-0.5, 0.5)
    ),
    side="link",
    inherent=True,
    simplified=True,
    quantities={"stiffness": "stiffness", "rest": "rest"},
)
