"""What terms of a group explain of its gap, on motions that are held out; and what a model as flexible leaves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gapscope.effects.effect import External, Transmission
from gapscope.model.conditioning import torque_scale
from gapscope.model.contrast import Answer, OwnTerms
from gapscope.model.design import LIKELY
from gapscope.model.difference import Fit
from gapscope.model.terms import Candidate, Term


@dataclass(frozen=True)
class Explained:
    """Gap of a group on M rows of n joints that are predicted from all others.

    Attributes:
        rows: which rows of all they are, mask.
        after: gap that is left with the terms [N m], (M, n).
        torque: what each term of the group does [N m], (M, n).
        errors: what a healthy arm has beside its data sheet [N m], (M, n): a part of ``after``. Of an arm that was
            identified on a reference it is taken out.
        floor: RMS that noise, form error and what is not known of the shared arm leave [N m], (n,); no more than what
            is left with the terms.
        scale: normalisation of the torque gap [N m], (n,).
        trust: how far friction is known on each row [1], (M, n).
        hidden: torque that friction may take where it holds a joint [N m], (M, n).
    """

    rows: np.ndarray
    after: np.ndarray
    torque: Mapping[Candidate, np.ndarray]
    errors: np.ndarray
    floor: np.ndarray
    scale: np.ndarray
    trust: np.ndarray
    hidden: np.ndarray

    @property
    def before(self) -> np.ndarray:
        """Gap without any of the terms [N m], (M, n)."""
        return np.asarray(sum(self.torque.values(), self.after))

    def nrmse(self, gap: np.ndarray) -> np.ndarray:
        """``torque_nrmse`` of a gap [N m], (n,)."""
        return np.asarray(np.sqrt((gap**2).mean(axis=0)) / self.scale)

    def visible(self, gap: np.ndarray) -> np.ndarray:
        """The same by trust, (n,): where a joint may stick, static friction hides what is there."""
        known = beyond(gap, self.hidden) * self.trust
        return self.nrmse(known) / np.sqrt((self.trust**2).mean(axis=0))


class HeldOut(NamedTuple):
    """A motion of a group, and what all others say.

    Attributes:
        rows: the part, mask (M,).
        own: information on the terms, without the part.
        answer: values of the terms, without the part.
    """

    rows: np.ndarray
    own: OwnTerms
    answer: Answer


def held_out(fit: Fit, group: int, terms: Sequence[Candidate]) -> Iterator[HeldOut]:
    """Motions of a group in turn, or what is set aside, with what all others say of some terms of a hypothesis."""
    rows = fit.contrast.design.rows
    mine = rows.set_aside if rows.set_aside.any() else rows.of(group)
    sizes = dict(zip(fit.chosen, fit.answer.sizes, strict=True))
    # what is set aside has taught nothing
    motions = [None] if rows.set_aside.any() else np.unique(rows.motion[mine]).tolist()
    for motion in motions:
        own, where = fit.own, mine
        if motion is not None:
            own = fit.own.within(fit.contrast.without(group, [motion]))
            where = mine & (rows.motion == motion)
        # of the sizes of the whole: a part is not to choose its own
        answer = own.answer(terms, [sizes[one] for one in terms])
        # what no step from all recordings to the others finds is judged as it was fitted
        kept = {
            one: value
            for one, value in fit.answer.values.items()
            if one in answer.values and _is_kept(one.term)
        }
        yield HeldOut(where, own, replace(answer, values={**answer.values, **kept}))


def _is_kept(term: Term) -> bool:
    """Whether values stay when a motion is left out: of a push and a limit, which no other motion tells.

    So do those of what swings or rattles: columns about a width or a stiffness say nothing of one a little farther.
    """
    effect = term.definition
    return isinstance(effect, (External, Transmission)) or effect.limits


def explained(
    fit: Fit, group: int, terms: Sequence[Candidate], by_values: Fit | None = None
) -> Explained:
    """What some candidates of a hypothesis explain of a group, on parts that are held out.

    Args:
        fit: the hypothesis.
        group: whose terms they are.
        terms: of the hypothesis.
        by_values: the hypothesis as its values are fitted beside a data sheet: what is shared is errors then, which an
            arm that is corrected has still.
    """
    design, rows = fit.contrast.design, fit.contrast.design.rows
    mine = rows.set_aside if rows.set_aside.any() else rows.of(group)
    after, errors = np.zeros_like(design.gap), np.zeros_like(design.gap)
    torque = {one: np.zeros_like(after) for one in terms if not one.everybody}
    parts = list(held_out(fit, group, terms))
    valued = parts if by_values is None else held_out(by_values, group, terms)
    for (where, own, _), (_, _, answer) in zip(parts, valued, strict=True):
        left = fit.contrast.gap - own.torque(answer.values)
        if by_values is not None:
            # errors stay a part of the gap: an arm that is corrected has them still
            likely = likely_errors(replace(fit, own=own), answer.values, group)
            errors[where] = design.shared_torque(likely)[where]
        else:
            shared, days = own.nuisances(answer.values)
            left -= design.shared_torque(shared + days[group])
        after[where] = left[where]
        each = {one: own.torque({one: answer.values[one]}) for one in torque}
        if each:
            # what columns about own values leave out belongs to the largest term
            largest = max(each, key=lambda one: float((each[one][mine] ** 2).sum()))
            each[largest] = each[largest] + design.gap - fit.contrast.gap
        for one, x in each.items():
            torque[one][where] = x[where]
    after = rows.in_newton_metres(after)[mine]
    scale = torque_scale(rows.torque[mine])
    left = np.sqrt((after**2).mean(axis=0))
    # what is allowed for may be more than what is there
    floor = np.minimum(_floor(fit, mine) * rows.scale, left)
    torque = {one: rows.in_newton_metres(x)[mine] for one, x in torque.items()}
    errors, trust = rows.in_newton_metres(errors)[mine], rows.trust[mine]
    hidden = rows.hides[mine] * rows.scale
    return Explained(mine, after, torque, errors, floor, scale, trust, hidden)


def beyond(torque: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """What of a torque is more than what friction may hide, of the same shape and unit."""
    return np.asarray(torque - np.clip(torque, -hidden, hidden))


def likely_errors(
    fit: Fit, values: Mapping[Candidate, np.ndarray], group: int
) -> np.ndarray:
    """What a healthy arm has beside its data sheet, in units of the columns, (P,), beside values of candidates.

    What is far beyond what healthy arms have is none of theirs, nor are unknown functions.
    """
    shared, days = fit.own.nuisances(values)
    likely = LIKELY * fit.contrast.design.prior
    for some in fit.contrast.design.waves:
        likely[np.concatenate(some)] = 0.0
    return np.clip(shared, -likely, likely) + days[group]


def _floor(fit: Fit, mine: np.ndarray) -> np.ndarray:
    """RMS that noise, form error, rest and what is not known of what is shared leave on rows, over the scale, (n,)."""
    contrast, design = fit.contrast, fit.contrast.design
    covariance = contrast.covariance()
    hidden2 = (design.rows.sticking[mine] ** 2).mean(axis=0)
    left2 = contrast.error.white2 + hidden2
    for j, (x, active) in enumerate(zip(design.columns, design.active, strict=True)):
        rows = x[mine]
        known = covariance[np.ix_(active, active)]
        # what a motion not seen has of its own, and what is not known of what is shared
        left2[j] += float((rows**2).mean(axis=0) @ contrast.error.own2[j])
        left2[j] += float(((rows @ known) * rows).sum() / len(rows))
    return np.sqrt(left2)
