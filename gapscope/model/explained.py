"""What terms of a group explain of its gap, on motions that are held out; and what a model as flexible leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.model.difference import Fit
from gapscope.model.terms import Candidate
from gapscope.model.torque_gap import torque_scale


@dataclass(frozen=True)
class Explained:
    """Gap of a group on M rows of n joints that are predicted from all others.

    Attributes:
        rows: which rows of all they are, mask.
        after: gap that is left with the terms [N m], (M, n).
        torque: what each term of the group does [N m], (M, n).
        floor: RMS that noise, form error and what is not known of the shared arm leave [N m], (n,); no more than what
            is left with the terms.
        scale: normalisation of the torque gap [N m], (n,).
    """

    rows: np.ndarray
    after: np.ndarray
    torque: Mapping[Candidate, np.ndarray]
    floor: np.ndarray
    scale: np.ndarray

    @property
    def before(self) -> np.ndarray:
        """Gap without any of the terms [N m], (M, n)."""
        return self.with_only(())

    def with_only(self, terms: Sequence[Candidate]) -> np.ndarray:
        """Gap with some of the terms [N m], (M, n)."""
        others = [x for one, x in self.torque.items() if one not in terms]
        return np.asarray(sum(others, self.after))

    def nrmse(self, gap: np.ndarray) -> np.ndarray:
        """``torque_nrmse`` of a gap [N m], (n,)."""
        return np.asarray(np.sqrt((gap**2).mean(axis=0)) / self.scale)


def explained(fit: Fit, group: int, terms: Sequence[Candidate]) -> Explained:
    """What some candidates of a hypothesis explain of a group: on what is set aside, or on each part in turn.

    A part is a recording, or a motion of the only one; it is predicted with what all others say of the terms and of all
    that is shared.

    Args:
        fit: the hypothesis.
        group: whose terms they are.
        terms: of the hypothesis.
    """
    design, rows = fit.contrast.design, fit.contrast.design.rows
    mine = rows.set_aside if rows.set_aside.any() else rows.of(group)
    after = np.zeros_like(design.gap)
    torque = {one: np.zeros_like(after) for one in terms if not one.everybody}
    sizes = dict(zip(fit.chosen, fit.answer.sizes, strict=True))
    for part in _parts(fit, group):
        own, where = fit.own, mine
        if part:
            own = fit.own.within(fit.contrast.without(group, part))
            where = mine & np.isin(rows.motion, part)
        answer = own.answer(terms, [sizes[one] for one in terms])
        shared, days = own.nuisances(answer.values)
        left = fit.contrast.gap - own.torque(answer.values)
        left -= design.shared_torque(shared + days[group])
        after[where] = left[where]
        each = {one: own.torque({one: answer.values[one]}) for one in torque}
        if each:
            # what columns about own values leave out belongs to the largest term
            largest = max(each, key=lambda one: float((each[one][mine] ** 2).sum()))
            each[largest] = each[largest] + design.gap - fit.contrast.gap
        for one, x in each.items():
            torque[one][where] = x[where]
    # rows count alike, whatever friction hides
    size = (rows.measured / rows.trust * rows.scale)[mine]
    after, scale = after[mine] * size, torque_scale(rows.torque[mine])
    left = np.sqrt((after**2).mean(axis=0))
    floor = np.minimum(_floor(fit, mine) * rows.scale, left)
    torque = {one: x[mine] * size for one, x in torque.items()}
    return Explained(mine, after, torque, floor, scale)


def _parts(fit: Fit, group: int) -> list[list[int]]:
    """Motions of each part that is held out together; one empty part if others are set aside."""
    rows = fit.contrast.design.rows
    if rows.set_aside.any():
        return [[]]
    motions, first = np.unique(rows.motion[rows.of(group)], return_index=True)
    recording = rows.recording[rows.of(group)][first]
    if len(np.unique(recording)) == 1:
        return [[motion] for motion in motions.tolist()]
    return [motions[recording == r].tolist() for r in np.unique(recording)]


def _floor(fit: Fit, mine: np.ndarray) -> np.ndarray:
    """RMS that noise, form error, rest and what is not known of what is shared leave on rows, over the scale, (n,)."""
    contrast, design = fit.contrast, fit.contrast.design
    covariance = contrast.covariance()
    hidden2 = (design.rows.sticking[mine] ** 2).mean(axis=0)
    left2 = contrast.error.white2 + hidden2
    for j, (x, active) in enumerate(zip(design.columns, design.active, strict=True)):
        rows = x[mine]
        known = covariance[np.ix_(active, active)]
        left2[j] += float((rows**2).mean(axis=0) @ contrast.error.own2[j])
        left2[j] += float(((rows @ known) * rows).sum() / len(rows))
    return np.sqrt(left2)
