"""What is left once the effects found are in, above what a healthy arm leaves: does anything remain unexplained?

Judged on unseen data where dry friction is not in doubt, with the errors of the nominal inertials taken out: rows on
which a joint may stick count by how well they are known, so that an arm that stands still for long hides nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.gap.torque_gap import TorqueGap, torque_scale
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import (
    ABOVE_FLOOR_NRMSE,
    ABOVE_FLOOR_RATIO,
    EXPLAINED_RESIDUAL,
    EXPLAINED_RESIDUAL_COMPLIANT,
    LOUDEST_FLOOR,
    RESIDUAL_ABOVE_FLOOR_RATIO,
    WIDE_RESIDUAL_NRMSE,
    WIDE_RESIDUAL_SHARE,
)


@dataclass(frozen=True)
class ExcessResidual:
    """What is above the floor per joint, n joints.

    Attributes:
        before: torque NRMSE of the nominal arm above the floor, in squares, (n,).
        after: the same with the effects found, (n,).
        ratio: RMS with the effects found over the floor's, (n,).
        rings: whether an effect that makes a joint ring is among those found.
    """

    before: np.ndarray
    after: np.ndarray
    ratio: np.ndarray
    rings: bool

    @property
    def above(self) -> np.ndarray:
        """Joints above the floor, (n,)."""
        least = np.where(
            self.before > self.after + 1e-9,
            RESIDUAL_ABOVE_FLOOR_RATIO,
            ABOVE_FLOOR_RATIO,
        )
        return (self.ratio > least) & (self.after > ABOVE_FLOOR_NRMSE)

    @property
    def open(self) -> bool:
        """Whether the effects found leave too much of the gap."""
        return self.more_than(self.before)

    def more_than(self, before: np.ndarray) -> bool:
        """Whether more is left than effects may leave of what was above the floor before, as torque NRMSE, (n,)."""
        left = (self.after[self.above] ** 2).sum()
        most = EXPLAINED_RESIDUAL_COMPLIANT if self.rings else EXPLAINED_RESIDUAL
        wide = (
            self.above
            & (self.after > WIDE_RESIDUAL_NRMSE)
            & (self.after > WIDE_RESIDUAL_SHARE * before)
        )
        return bool(left > most * (before**2).sum() or wide.any())


def elementwise_max(one: ExcessResidual, other: ExcessResidual) -> ExcessResidual:
    """Of two the wider on each joint."""
    wider = {
        name: np.maximum(getattr(one, name), getattr(other, name))
        for name in ("before", "after", "ratio")
    }
    return ExcessResidual(**wider, rings=one.rings)


def set_aside(
    selection: Selection, before: TorqueGap, after: TorqueGap, floor: np.ndarray
) -> ExcessResidual:
    """What is above the floor [N m], (n,), on recordings set aside for judging."""
    scale = torque_scale(before.measured)
    first, then = (
        np.sqrt(np.clip(gap.rmse**2 - floor**2, 0.0, None)) / scale
        for gap in (before, after)
    )
    return ExcessResidual(
        first,
        then,
        after.rmse / floor,
        any(not t.definition.locally_linear for t in selection.fit.terms),
    )


def excess_residual(
    selection: Selection, gap: np.ndarray, least: np.ndarray | float = 0.0
) -> ExcessResidual:
    """What is above the floor before and after the effects found.

    Args:
        found: result of the search.
        gap: RMS of the gap with the effects found on all unseen rows [N m], (n,): where it is less than what the
            evidence says, the model around its values is too far from linear to say it.
        least: RMS that is left on this arm in any case [N m], (n,).
    """
    evidence, terms = selection.evidence, selection.fit.terms
    rows = evidence.rows.sum(axis=0)

    def pooled(square: np.ndarray) -> np.ndarray:
        return np.asarray((square * evidence.rows).sum(axis=0) / rows)

    floor2, before2, after2 = (
        pooled(x)
        for x in (evidence.floor2, selection.nominal_mse, evidence.held_out_mse(terms))
    )
    after2 = np.minimum(after2, gap**2)
    floor2 = np.maximum(floor2, np.square(least))
    floor2 = floor2 * np.clip((after2 / floor2).min(), 1.0, LOUDEST_FLOOR**2)
    before, after = (
        np.sqrt(np.clip(x - floor2, 0.0, None)) / selection.scale
        for x in (before2, after2)
    )
    return ExcessResidual(
        before,
        after,
        np.sqrt(after2 / floor2),
        any(not t.definition.locally_linear for t in terms),
    )
