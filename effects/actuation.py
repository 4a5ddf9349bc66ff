"""The actuation family: what stands between the recorded torque and the joint.

Convention: applied = (1 + s) recorded(t - T) + offset, and applied is what the rigid body with its friction needs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from effects.effect import Parameter, Path

Shift = Callable[[np.ndarray, np.ndarray], np.ndarray]


def scale_inverse(needed: np.ndarray, scale: np.ndarray, shift: Shift) -> np.ndarray:
    """Recorded = needed / (1 + s) [N m]; s > -1, dimensionless."""
    return needed / (1.0 + scale)


def offset_inverse(needed: np.ndarray, torque: np.ndarray, shift: Shift) -> np.ndarray:
    """Recorded = needed - offset [N m]."""
    return needed - torque


def delay_inverse(needed: np.ndarray, delay: np.ndarray, shift: Shift) -> np.ndarray:
    """recorded(t) = needed(t + T) [N m]; T in s."""
    return shift(needed, delay)


OFFSET = Path(
    name="torque_offset",
    family="actuation",
    scope="joint",
    equation="applied = recorded + offset",
    parameters=(Parameter("torque", "o", "N m", (-200.0, 200.0), (0.1, 3.5)),),
    looks_like="a constant torque",
    reference="gautier1992",
    confused_with=(
        ("encoder_offset", "static poses over the whole range of the joint"),
        ("coulomb_friction", "slow motion in both directions"),
    ),
    inverse=offset_inverse,
)

SCALE = Path(
    name="torque_scale",
    family="actuation",
    scope="joint",
    equation="applied = (1 + s) recorded",
    parameters=(Parameter("scale", "s", "1", (-0.6, 1.5), (0.1, 0.3)),),
    looks_like="a gap proportional to the whole torque of the joint",
    reference="gautier2014",
    confused_with=(
        ("payload", "the same motion with a known payload"),
        ("load_friction", "slow motion in both directions under load"),
    ),
    inverse=scale_inverse,
)

DELAY = Path(
    name="actuator_delay",
    family="actuation",
    scope="joint",
    equation="applied(t) = recorded(t - T)",
    parameters=(Parameter("delay", "T", "s", (0.0, 0.2), (0.002, 0.02)),),
    looks_like="a phase lag of the torque that grows linearly with frequency",
    reference="hwangbo2019",
    confused_with=(
        ("armature", "a chirp above 10 Hz"),
        ("viscous_friction", "a chirp above 10 Hz"),
    ),
    inverse=delay_inverse,
)
