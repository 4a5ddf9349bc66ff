"""Friction that drifts slowly, which the filter follows: noted at each further step, never an alarm."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gapscope.ident.kalman.online.estimate import ParameterState
from gapscope.watching.alarm import Size
from gapscope.watching.detection.scales import Scales
from gapscope.watching.thresholds import DRIFT_STEP, DRIFT_SURE


class SlowDrift:
    """Friction of each joint at its usual speed beside what it was when it was learnt.

    Args:
        places: of viscous and Coulomb friction of each joint, shape (n, 2).
        reference: their values then, shape (n, 2); a change that was an alarm is added to them.
        noted: steps of ``DRIFT_STEP`` that were noted already, with sign, (n,).
    """

    def __init__(
        self, places: np.ndarray, reference: np.ndarray, noted: np.ndarray
    ) -> None:
        self.places, self.reference, self.noted = places, reference, noted

    def look(
        self, state: ParameterState, scales: Scales
    ) -> Iterator[tuple[int, Size, float]]:
        """Joints from 1 whose friction passed a further step, the torque [N m], and its share of what it was."""
        for joint, (own, reference) in enumerate(
            zip(self.places, self.reference, strict=True)
        ):
            at_speed = np.array([scales.speed[joint], 1.0])
            torque = float(at_speed @ (state.value[own] - reference))
            spread = state.covariance[np.ix_(own, own)]
            error = float(np.sqrt(max(at_speed @ spread @ at_speed, 0.0)))
            level = max(float(scales.friction[joint]), 1e-12)
            steps = int(torque / (DRIFT_STEP * level))
            beyond = (
                abs(steps) > abs(self.noted[joint]) or steps * self.noted[joint] < 0
            )
            if beyond and abs(torque) > DRIFT_SURE * error:
                self.noted[joint] = steps
                yield joint + 1, Size(torque, error, "N m"), torque / level
