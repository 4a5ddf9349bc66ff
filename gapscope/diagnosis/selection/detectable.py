"""How large an effect would have to be for recordings to show it: from the equations alone.

Of an effect of size x along its first coordinate, a model without it leaves on fold f and joint j, as far as the model
and the nuisances, fitted to the other folds, do not take it up,

    m_fj + G_fj x^2,    and a model with it    m_fj + tr G_fj S_f,

with m what any model leaves, G of the response of the held-out rows, and S_f the covariance of its coordinates as the
other folds tell them. It is named where the evidence rises by what a move has to raise it, and the gap closes by what
a person can see: the larger of the two sizes. What is estimated scatters about the true size by s = S_11^1/2 of all
folds, so that the size named with probability p lies Phi^-1(p) s above that named with one half.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np
from scipy.stats import norm

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.plausible_data import folds_of
from gapscope.diagnosis.model.normal_equations import MIN_SQUARE, NormalEquations
from gapscope.diagnosis.selection.evidence import Evidence, columns_of, expecting
from gapscope.diagnosis.selection.fitted_model import (
    Selection,
    clashes,
    nominal_model,
)
from gapscope.diagnosis.thresholds import MOVE_GAIN, VISIBLE_EFFECT
from gapscope.model.conditioning import TORQUE_CUTOFF, condition, position_cutoff
from gapscope.model.expected import LARGEST, MOST, Detectable, rising_root
from gapscope.model.terms import Term

UNTOLD = 1e-9
"""Share of a column's largest square over the folds below which a fold tells nothing of it [1]. (numerical)"""


def detectable(
    evidence: Evidence,
    chosen: frozenset[Term],
    scored2: np.ndarray,
    left2: Sequence[np.ndarray],
    deviation: np.ndarray,
) -> Iterator[Detectable]:
    """Sizes of each further term at which it would be named beside some that are there.

    What does not act in proportion to its size, elasticity, backlash and limits, is left out.

    Args:
        evidence: of the recordings.
        chosen: the terms that are there.
        scored2: what is left of the rows that are scored [N^2 m^2], (F, m).
        left2: what is left of the torque, the nuisances in it and taken out [N^2 m^2], (F, n) each.
        deviation: of the torque [N m], (n,).
    """
    for term in evidence.terms.selectable:
        definition = term.definition
        proportional = definition.locally_linear and not definition.limits
        if proportional and not clashes(term, chosen):
            yield _Asked(evidence, chosen, term).sizes(scored2, left2, deviation)


class _Asked:
    """A term beside others: what rows would be left of it.

    Attributes:
        plain, torque, scored: G of the recorded torque with the nuisances in it, of it without them, and of what is
            scored, per fold and joint, (F, m, C, C).
        unknown: S_f of each fold, (F, C, C).
        std: s [1].
    """

    def __init__(self, evidence: Evidence, chosen: frozenset[Term], term: Term) -> None:
        self._evidence, self._term = evidence, term
        self._columns, self._own = columns_of(chosen), np.array(term.columns)
        self._charge = evidence.charge(chosen | {term}) - evidence.charge(chosen)
        # what it and the others move: all else stays what it is
        used = np.append(self._own, self._columns).astype(int)
        held = self._response(evidence.without_fold)[:, used]
        grams = (
            (evidence.torque.gram, evidence.torque),
            (evidence.reduced[0], evidence.torque),
            (evidence.reduced[-1], evidence.scored),
        )
        self.plain, self.torque, self.scored = (
            np.swapaxes(held, 1, 2)[:, None]
            @ gram[..., used[:, None], used]
            @ held[:, None]
            / np.maximum(equations.count, 1e-9)[..., None, None]
            for gram, equations in grams
        )
        self.unknown = self._covariance(evidence.without_fold)
        self.std = float(np.sqrt(self._covariance(evidence.together)[0, 0]))
        held = self._response(evidence.together)[:, :1]
        pull = evidence.together.delta[:, :-1] @ held[:-1]
        self._taken = float((pull.T @ evidence.prior @ pull).item())

    def _response(self, equations: NormalEquations) -> np.ndarray:
        """What the others take up of it, and it itself, with nothing else in the torque: (..., P + 1, C)."""
        least, own, columns = equations.least, self._own, self._columns
        out = np.zeros((*least.shape[:-1], len(own)))
        out[..., own, np.arange(len(own))] = -1.0
        if len(columns):
            block = least[..., columns[:, None], columns]
            out[..., columns, :] = _solved(block, least[..., columns[:, None], own])
        return out

    def _covariance(self, equations: NormalEquations) -> np.ndarray:
        """Of its coordinates beside the others, (..., C, C)."""
        used, count = np.append(self._own, self._columns).astype(int), len(self._own)
        block = equations.least[..., used[:, None], used]
        return _solved(block, np.eye(len(used)))[..., :count, :count]

    def sizes(
        self, scored2: np.ndarray, left2: Sequence[np.ndarray], deviation: np.ndarray
    ) -> Detectable:
        """The sizes at which it would be named, infinite where none is."""
        evidence, rows = self._evidence, self._evidence.rows
        share = rows / rows.sum(axis=0) / deviation**2
        column2 = float((self.plain[..., 0, 0] * share).sum(axis=0).max())
        shape = evidence.terms.shapes.get(self._term, ())
        # what moves no torque but by rounding
        if column2 <= MIN_SQUARE:
            return Detectable(self._term, np.inf, np.inf, shape)
        largest = LARGEST / float(np.sqrt(column2))
        expected2 = scored2 + evidence.scored.expected2
        spent = np.log1p(self._missed(self.scored) / expected2)

        def gain(size: float) -> float:
            """Evidence above what a move has to raise it by [nats]."""
            more = np.log1p(self.scored[..., 0, 0] * size**2 / expected2)
            misfit = float((evidence.scored.independent * (more - spent)).sum())
            unusual = evidence.unusual(self._own[:1], np.array([size]))
            taken = self._taken * size**2
            return (misfit + taken) / 2 - self._charge - unusual - MOVE_GAIN

        def closed(gram: np.ndarray, left: np.ndarray, size: float) -> float:
            """Torque NRMSE that closes on some joint above what a person can see [1]."""
            missed = [gram[..., 0, 0] * size**2, self._missed(gram)]
            wide, narrow = (np.sqrt(((left + x) * share).sum(axis=0)) for x in missed)
            return float((wide - narrow).max()) - VISIBLE_EFFECT

        seen = (
            rising_root(partial(closed, gram, left), largest)
            for gram, left in zip((self.plain, self.torque), left2, strict=True)
        )
        least = float(evidence.lowest[self._own[0]])
        half = max(rising_root(gain, largest), min(seen), least)
        most = half + float(norm.ppf(MOST)) * self.std
        return Detectable(self._term, half, most, shape)

    def _missed(self, gram: np.ndarray) -> np.ndarray:
        """What a model with it misses as its coordinates are not known exactly, (F, m)."""
        return np.asarray(np.einsum("fmab,fba->fm", gram, self.unknown))


def _solved(block: np.ndarray, right: np.ndarray) -> np.ndarray:
    """A^-1 B with the columns of A brought to one size; what a fold does not tell is hardly known there."""
    square = np.diagonal(block, axis1=-2, axis2=-1)
    # what no fold tells has no size of its own
    most = square.reshape(-1, square.shape[-1]).max(axis=0)
    size = np.sqrt(np.maximum(square, np.where(most > 0, UNTOLD * most, 1.0)))
    ridge = 1e-12 * np.eye(block.shape[-1])
    scaled = block / size[..., :, None] / size[..., None, :] + ridge
    return np.asarray(
        np.linalg.solve(scaled, right / size[..., :, None]) / size[..., :, None]
    )


def shown(selection: Selection) -> Iterator[Detectable]:
    """Sizes of each further effect at which it would be named beside what a search found."""
    fit, evidence = selection.fit, selection.evidence
    plain = evidence.held_out_mse(fit.terms, corrected=False)
    left2 = (plain, fit.held_out_mse)
    return detectable(evidence, fit.terms, fit.scored_mse, left2, selection.scale)


def could_show(
    arm: NominalArm, recordings: Iterable[Recording]
) -> Iterator[Detectable]:
    """The same of recordings that nobody has searched, or that are only planned: beside what a healthy arm leaves.

    What could be left is learnt from the recordings, all effects fitted at once.

    Args:
        arm: the nominal arm.
        recordings: with a torque, if only that of the nominal arm; others are left out.

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """
    used = [one for one in recordings if one.tau is not None]
    folds = folds_of([condition(one) for one in used])
    cutoff = min(TORQUE_CUTOFF, position_cutoff(used))
    model = nominal_model(arm, RigidBody(arm), folds, cutoff, {})
    evidence = expecting(model.linear)
    left2 = (evidence.expected2, evidence.expected2)
    scored2 = evidence.scored.expected2
    deviation = model.linear.data.torque_deviation
    return detectable(evidence, frozenset(), scored2, left2, deviation)
