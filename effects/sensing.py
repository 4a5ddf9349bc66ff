"""The sensing family: maps between the true and the recorded motion."""

from __future__ import annotations

import numpy as np

from effects.effect import Parameter, Sensing


def remove_offset(recorded: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """True q = recorded q - delta [rad]."""
    return recorded - offset


ENCODER_OFFSET = Sensing(
    name="encoder_offset",
    family="sensing",
    scope="joint",
    equation="recorded q = q + delta",
    parameters=(Parameter("offset", "delta", "rad", (-0.8, 0.8), (0.0175, 0.0873)),),
    looks_like="an error periodic with gravity, on this joint and those before it",
    reference="hollerbach2008",
    confused_with=(
        ("torque_offset", "static poses over the whole range of the joint"),
        ("payload", "static poses with and without a known payload"),
    ),
    true=remove_offset,
)
