"""The excess residual: what exceeds the noise floor once the effects found are added.

Measured on held-out data with the errors of the nominal inertials taken out. Rows on which a joint may stick count by
how well dry friction is known there, so that an arm at rest for long does not dilute the residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from gapscope.diagnosis.selection.search import Selection
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
from gapscope.model.torque_gap import TorqueGap, torque_scale


@dataclass(frozen=True)
class ExcessResidual:
    """What is above the floor per joint, n joints.

    Attributes:
        before: torque NRMSE of the nominal arm above the floor, in squares: sqrt(gap^2 - floor^2) / scale, (n,).
        after: the same with the effects found, (n,).
        ratio: RMS with the effects found over the floor's, (n,).
        ratio_expected: RMS with the effects found over what a healthy arm leaves of every model, (n,).
        by_chance: ratio that chance exceeds on any joint at the false-alarm rate, (n,).
        compliant: whether a compliant joint is among the effects found.
    """

    before: np.ndarray
    after: np.ndarray
    ratio: np.ndarray
    ratio_expected: np.ndarray
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


def elementwise_max(one: ExcessResidual, other: ExcessResidual) -> ExcessResidual:
    """The larger of two excess residuals on each joint."""
    return ExcessResidual(
        before=np.maximum(one.before, other.before),
        after=np.maximum(one.after, other.after),
        ratio=np.maximum(one.ratio, other.ratio),
        ratio_expected=np.maximum(one.ratio_expected, other.ratio_expected),
        by_chance=np.maximum(one.by_chance, other.by_chance),
        compliant=one.compliant,
    )


def excess_residual(selection: Selection, gap: np.ndarray) -> ExcessResidual:
    """What is above the floor before and after the effects found, on the folds.

    The gap is measured twice: by the evidence, on the decimated rows of the search with the effects linearised, and
    by ``torque_gap`` at the full rate. The smaller counts, because an effect that is far from linear is predicted
    badly by its linearisation. The other place that reconciles both is the floor in ``study``.

    Args:
        selection: result of the search.
        gap: RMS of the gap with the effects found on all held-out rows, at the full rate [N m], (n,).
    """
    evidence, terms = selection.evidence, selection.fit.terms
    rows = evidence.rows
    count = rows.sum(axis=0)

    def pooled(mean_square: np.ndarray) -> np.ndarray:
        """Mean square over all folds, (n,), of those per fold, (F, n)."""
        return np.asarray((mean_square * rows).sum(axis=0) / count)

    # Mean squares [N^2 m^2], (n,).
    before2 = pooled(selection.nominal_mse)
    after2 = np.minimum(pooled(evidence.likely_mse(terms)), gap**2)
    floor2 = pooled(evidence.floor2)

    expected2 = pooled(evidence.expected2)

    # If even the quietest joint is above its floor, the floors are too low rather than all joints wrong.
    loudness2 = np.clip((after2 / floor2).min(), 1.0, LOUDEST_FLOOR**2)
    floor2 = floor2 * loudness2

    above_before = np.sqrt(np.clip(before2 - floor2, 0.0, None))
    above_after = np.sqrt(np.clip(after2 - floor2, 0.0, None))
    return ExcessResidual(
        before=above_before / selection.scale,
        after=above_after / selection.scale,
        ratio=np.sqrt(after2 / floor2),
        ratio_expected=np.sqrt(after2 / np.maximum(floor2, expected2)),
        by_chance=ratio_by_chance(selection),
        compliant=_has_compliance(selection),
    )


def excess_residual_set_aside(
    selection: Selection, before: TorqueGap, after: TorqueGap, floor: np.ndarray
) -> ExcessResidual:
    """What is above the floor [N m], (n,), on recordings that are never fitted."""
    scale = torque_scale(before.measured)
    healthy = np.sqrt(selection.evidence.expected2.mean(axis=0))

    def above_floor(gap: TorqueGap) -> np.ndarray:
        excess2 = np.clip(gap.rmse**2 - floor**2, 0.0, None)
        return np.asarray(np.sqrt(excess2) / scale)

    return ExcessResidual(
        before=above_floor(before),
        after=above_floor(after),
        ratio=after.rmse / floor,
        ratio_expected=after.rmse / np.maximum(floor, healthy),
        by_chance=ratio_by_chance(selection),
        compliant=_has_compliance(selection),
    )


def ratio_by_chance(selection: Selection) -> np.ndarray:
    """Ratio of RMS to floor that healthy arms exceed on one of n joints in ``FALSE_ALARM_RATE`` of cases, (n,).

    Of independent samples with the floor's variance: the root of a quantile of chi2 over its degrees of freedom.
    Source: bendat2010.
    """
    evidence = selection.evidence
    joints = evidence.linear.arm.n_joints
    samples = evidence.scored.independent.sum(axis=0)[:joints]
    level = FALSE_ALARM_RATE / joints
    return np.asarray(np.sqrt(chi2.isf(level, samples) / samples))


def _has_compliance(selection: Selection) -> bool:
    return any(not term.definition.locally_linear for term in selection.fit.terms)
