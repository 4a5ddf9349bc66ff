"""Disturbances under which tracking is evaluated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.effects.applied import AppliedEffect, push
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.effect import External

NAMES = ("none", "push", "noise")
"""``push``: a force on the tool; ``noise``: white noise on the encoders."""
FORCE = 0.3
"""Force of a push, as a share of the weight that the arm may carry [1]."""
START, LENGTH = 0.4, 0.2
"""A push begins at this share of a motion [1], and lasts so long [s]."""
NOISE = 1e-4
"""Standard deviation of the encoders' noise [rad]."""


class Disturbance(NamedTuple):
    """A disturbance: effects beside those of the arm, and the encoders' noise [rad]."""

    effects: tuple[AppliedEffect, ...] = ()
    noise: float = 0.0


def check_disturbance(name: str, effects: tuple[AppliedEffect, ...]) -> None:
    """Check that there is such a disturbance, and that it can be put on an arm with these effects.

    Raises:
        InputError: it is unknown, or a push on an arm that has an external force already.
    """
    check_known("disturbance", name, NAMES, where="disturbances")
    if name == "push" and any(isinstance(e.effect, External) for e in effects):
        raise InputError(
            "the arm has an external force already",
            "leave out push",
            where="disturbances",
        )


def disturbance(
    name: str, rng: np.random.Generator, scale: ArmScale, duration: float
) -> Disturbance:
    """A disturbance of a motion of ``duration`` [s]; a push comes from a direction drawn at random."""
    if name == "noise":
        return Disturbance(noise=NOISE)
    if name == "none":
        return Disturbance()
    direction = rng.standard_normal(3)
    start = START * duration
    force = FORCE * 9.81 * scale.lift * direction / np.linalg.norm(direction)
    return Disturbance((push(force, start, start + LENGTH),))
