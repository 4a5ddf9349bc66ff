"""A hypothesis: the nominal arm with one explanation of the gap, and how its prediction moves with its parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.advice.parameter_vector import (
    bounds,
    free,
    scales,
    vector,
    with_values,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External
from gapscope.model.conditioning import TORQUE_CUTOFF, low_pass

STEP = 1e-3
"""Step of the finite differences, in units of a parameter's scale [1]."""


@dataclass(frozen=True)
class Hypothesis:
    """One explanation.

    Attributes:
        words: what it says.
        arm: the nominal arm.
        effects: with values.
    """

    words: str
    arm: NominalArm
    effects: tuple[AppliedEffect, ...]

    def predict(self, body: RigidBody, motion: Motion) -> np.ndarray:
        """Torque that would be recorded, below the gap's cut-off [N m], (N, n)."""
        torque = CorrectedArm(self.arm, self.effects).unlimited.predict(body, motion)
        return low_pass(torque, motion.rate, TORQUE_CUTOFF)

    def jacobian(self, body: RigidBody, motion: Motion, here: np.ndarray) -> np.ndarray:
        """Derivative of the prediction ``here``, (N, n), by the parameters in units of their scales; (N, n, P)."""
        values, scale = vector(self.effects), scales(self.effects)
        _, highest = bounds(self.effects)
        out = np.zeros((*here.shape, len(values)))
        for k in range(len(values)):
            # a value at its upper bound can only go down
            step = STEP if values[k] + STEP * scale[k] <= highest[k] else -STEP
            changed = values.copy()
            changed[k] += step * scale[k]
            effects = with_values(self.effects, changed)
            moved = Hypothesis(self.words, self.arm, effects)
            out[:, :, k] = (moved.predict(body, motion) - here) / step
        return out

    @property
    def lasting(self) -> np.ndarray:
        """Which of the parameters act on another recording too, bool, (P,)."""
        parts = [np.zeros(0, dtype=bool)]
        for index, _, values in free(self.effects):
            lasts = not isinstance(self.effects[index].effect, External)
            parts.append(np.full(len(values), lasts))
        return np.concatenate(parts)

    def elsewhere(self) -> Hypothesis:
        """The hypothesis on another recording: an external force does not come again."""
        lasting = tuple(e for e in self.effects if not isinstance(e.effect, External))
        return Hypothesis(self.words, self.arm, lasting)
