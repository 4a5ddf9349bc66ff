"""The sensing family: maps between the true and the recorded motion."""

from __future__ import annotations

import numpy as np

from gapscope.effects.effect import Parameter, Sensing


def remove_offset(recorded: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """True q = recorded q - delta [rad]."""
    return recorded - offset


def add_offset(true: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Recorded q = q + delta [rad]."""
    return true + offset


def keep(recorded: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Recorded q [rad], the best estimate of what was rounded away."""
    return recorded


def quantize(true: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Recorded q = round(q / step) step [rad]; a step of 0 does not round."""
    unit = np.where(step > 0, step, 1.0)
    return np.where(step > 0, np.round(true / unit) * unit, true)


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
        ("base_tilt", "static poses turned about the first joint"),
    ),
    true=remove_offset,
    recorded=add_offset,
)

ENCODER_QUANTIZATION = Sensing(
    name="encoder_quantization",
    family="sensing",
    scope="joint",
    equation="recorded q = round(q / step) step",
    parameters=(Parameter("step", "s", "rad", (0.0, 0.5), (6e-6, 6.1e-3)),),
    looks_like="steps in the position, spikes in its second derivative",
    reference="hollerbach2008",
    confused_with=(
        ("backlash", "a slow ramp: equal steps, or one jump at the reversal"),
    ),
    true=keep,
    recorded=quantize,
)
