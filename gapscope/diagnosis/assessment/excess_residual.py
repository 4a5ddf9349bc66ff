"""What exceeds the noise floor once the effects found are added."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from gapscope.diagnosis.thresholds import (
    ABOVE_FLOOR_NRMSE,
    ABOVE_FLOOR_RATIO,
    EXPLAINED_RESIDUAL,
    EXPLAINED_RESIDUAL_COMPLIANT,
    FALSE_ALARM_RATE,
    LOUDEST_FLOOR,
    RESIDUAL_ABOVE_FLOOR_RATIO,
    WIDE_RESIDUAL_NRMSE,
    WIDE_RESIDUAL_SHARE,
)


@dataclass(frozen=True)
class ExcessResidual:
    """What is above the floor per joint, n joints.

    Attributes:
        before: torque NRMSE of the nominal arm above the floor, in squares: sqrt(gap^2 - floor^2) / scale, (n,).
        after: the same with the effects found, (n,).
        ratio: RMS with the effects found over the floor's, (n,).
        by_chance: ratio that chance exceeds on any joint at the false-alarm rate, (n,).
        compliant: whether a compliant joint is among the effects found.
    """

    before: np.ndarray
    after: np.ndarray
    ratio: np.ndarray
    by_chance: np.ndarray
    compliant: bool

    @property
    def above(self) -> np.ndarray:
        """Joints above the floor, (n,)."""
        improved = self.before > self.after + 1e-9
        least = np.where(improved, RESIDUAL_ABOVE_FLOOR_RATIO, ABOVE_FLOOR_RATIO)
        least = np.maximum(least, self.by_chance)
        return (self.ratio > least) & (self.after > ABOVE_FLOOR_NRMSE)

    @property
    def open(self) -> bool:
        """Whether the effects found leave too much of the gap."""
        return self.exceeds_explained_share_of(self.before)

    def exceeds_explained_share_of(self, before: np.ndarray) -> bool:
        """Whether the residual exceeds what effects may leave of a torque NRMSE above the floor, (n,)."""
        residual = (self.after[self.above] ** 2).sum()
        share = EXPLAINED_RESIDUAL_COMPLIANT if self.compliant else EXPLAINED_RESIDUAL
        too_much = residual > share * (before**2).sum()

        # One joint that keeps most of its gap is unexplained, even if it is a small part of the whole.
        least_wide = np.maximum(WIDE_RESIDUAL_NRMSE, WIDE_RESIDUAL_SHARE * before)
        wide = self.above & (self.after > least_wide)
        return bool(too_much or wide.any())


def excess_residual(
    before: np.ndarray,
    after: np.ndarray,
    floor: np.ndarray,
    scale: np.ndarray,
    samples: np.ndarray,
    *,
    compliant: bool,
) -> ExcessResidual:
    """What is above the floor before and after the effects found.

    Args:
        before: RMS of the gap of the nominal arm [N m], (n,).
        after: the same with the effects found and likely errors of the bodies taken out [N m], (n,).
        floor: RMS that a healthy arm leaves [N m], (n,).
        scale: normalisation of the torque gap [N m], (n,).
        samples: independent samples, (n,).
        compliant: whether a compliant joint is among the effects found.
    """
    # If even the quietest joint is above its floor, the floors are too low rather than all joints wrong.
    loudness = np.clip((after / floor).min(), 1.0, LOUDEST_FLOOR)
    floor = floor * loudness
    # RMS over floor of independent samples with the floor's variance, at the false-alarm rate [bendat2010]
    level = FALSE_ALARM_RATE / len(floor)
    by_chance = np.sqrt(chi2.isf(level, samples) / samples)

    def above(gap: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(np.clip(gap**2 - floor**2, 0.0, None)) / scale)

    return ExcessResidual(
        above(before), above(after), after / floor, by_chance, compliant
    )
