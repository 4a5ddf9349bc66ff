"""An effect that the catalogue does not have, in one file: friction that grows with the cube of the speed."""

from __future__ import annotations

import numpy as np

from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.effect import Signals, TorqueLaw
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import Values, linear_in


def cubic(signals: Signals, coefficient: np.ndarray) -> np.ndarray:
    """b3 v^3 [N m]; b3 in N m s^3/rad^3, v in rad/s."""
    return coefficient * signals.velocity**3


def draw(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """5 to 30 % of the torque of each joint at its velocity limit."""
    return {
        "coefficient": scale.torque[j] / scale.speed[j] ** 3 * rng.uniform(0.05, 0.3)
    }


COEFFICIENT = Parameter("coefficient", "b3", "N m s^3/rad^3", (0.0, 100.0), (0.1, 10.0))
CUBIC_FRICTION = TorqueLaw(
    name="cubic_friction",
    family="friction",
    scope="joint",
    equation="b3 v^3",
    parameters=(COEFFICIENT,),
    looks_like="a torque odd in velocity that sets in at high speed",
    reference="swevers2007",
    confused_with=(("viscous_friction", "the same path at half the speed"),),
    law=cubic,
    parametrisation=linear_in(COEFFICIENT, lowest=0.0),
    severity=draw,
    simplified=True,
    plotted_against="velocity",
)
