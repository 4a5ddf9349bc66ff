"""The sensing family: maps between the true and the recorded motion."""

from __future__ import annotations

import numpy as np

from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.effect import Sensing
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import Values, linear_in
from gapscope.effects.signals import random_sign

EXACT = 2.0**-500
"""Rounding to this power of two [rad] changes nothing: neither dividing nor multiplying by it does."""


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
    unit = np.maximum(step, EXACT)
    return np.rint(true / unit) * unit


def draw_offset(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """1 to 5 degrees."""
    size = len(j)
    return {"offset": random_sign(rng, size) * rng.uniform(0.0175, 0.0873, size)}


def draw_step(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """Encoders of 10 to 20 bits per revolution."""
    bits = rng.integers(10, 20, len(j), endpoint=True)
    return {"step": 2 * np.pi / 2.0**bits}


OFFSET_ANGLE = Parameter("offset", "delta", "rad", (-0.8, 0.8), (0.0175, 0.0873))


ENCODER_OFFSET = Sensing(
    name="encoder_offset",
    family="sensing",
    scope="joint",
    equation="recorded q = q + delta",
    parameters=(OFFSET_ANGLE,),
    looks_like="an error periodic with gravity, on this joint and those before it",
    reference="hollerbach2008",
    confused_with=(
        ("torque_offset", "static poses over the whole range of the joint"),
        ("payload", "static poses with and without a known payload"),
        ("base_tilt", "static poses turned about the first joint"),
    ),
    true=remove_offset,
    recorded=add_offset,
    parametrisation=linear_in(OFFSET_ANGLE),
    severity=draw_offset,
    quantities={"offset": "zero"},
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
    severity=draw_step,
    side="both",
    reach="joint",
    quantities={"step": "resolution"},
    without="round what is read to it",
)
