"""The sensing family: maps between the true and the recorded motion."""

from __future__ import annotations

import numpy as np

from gapscope.effects.effect import Sensing
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import linear_in
from gapscope.effects.signals import Drawn, drawn

EXACT = 2.0**-500
"""Rounding to this power of two [rad] changes nothing: neither dividing nor multiplying by it does."""


def quantize(true: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Recorded q = round(q / step) step [rad]; a step of 0 does not round."""
    unit = np.maximum(step, EXACT)
    return np.rint(true / unit) * unit


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
    true=lambda recorded, offset: recorded - offset,
    recorded=lambda true, offset: true + offset,
    parametrisation=linear_in(OFFSET_ANGLE),
    severity=drawn(offset=Drawn(0.0175, 0.0873, signed=True)),
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
    # the best estimate of what was rounded away
    true=lambda recorded, step: recorded,
    recorded=quantize,
    # 10 to 20 bits per revolution
    severity=lambda rng, scale, j: {
        "step": 2 * np.pi / 2.0 ** rng.integers(10, 20, len(j), endpoint=True)
    },
    side="both",
    reach="joint",
    quantities={"step": "resolution"},
    without="round what is read to it",
)
