"""Evidence for a set of terms: how well it predicts data that it was not fitted to, less what it costs.

Score of a set S, in nats, over folds f (half a recording left out each) and joints j:

    score = -1/2 sum_fj n_fj log(1 + mse_fj / floor_fj^2) - charge(S) - 1/2 (|delta / sigma|^2 + log det)

with n the effective number of samples, mse the mean square of the unseen gap, and delta the errors of the nominal
inertials, a nuisance that every model may use and pays for by its size relative to sigma. A second nuisance is the skew
between torque and motion that sampling leaves, the same on all joints: a torque held from one tick of the controller to
the next acts half a tick late on average.

With joint torque sensors j runs over both sides of each joint (``gapscope/diagnosis/model/torque_sensor.py``), and
the errors of the sensors are a third nuisance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.model.linearisation import Fold, Linearisation
from gapscope.diagnosis.model.normal_equations import NormalEquations
from gapscope.diagnosis.model.terms import (
    Term,
    cost,
    count_findings,
    parametrisation_of,
)
from gapscope.diagnosis.thresholds import (
    LEAST_DELAY,
    MODEL_FORM,
    NEW_EFFECT,
    NOMINAL_ERROR,
    SKEW_CHARGE,
    SKEWS,
)
from gapscope.effects.catalogue import explained


@dataclass(frozen=True)
class Fit:
    """A set of terms fitted.

    Attributes:
        terms: the set.
        score: evidence [nats].
        cost: what was taken off the likelihood for terms, nuisances and skew [nats].
        theta: values fitted to all folds, shape (P,).
        unseen: mean square of the gap per fold and joint, each fold predicted from the others [N^2 m^2], (F, n).
        missed: the same of the rows that were scored, (F, m): joints, or with sensors both sides of them.
        impossible: terms whose values cannot be; the score is minus infinity where there are any.
    """

    terms: frozenset[Term]
    score: float
    cost: float
    theta: np.ndarray
    held_out_mse: np.ndarray
    scored_mse: np.ndarray
    impossible: frozenset[Term] = frozenset()


class Rows:
    """Normal equations of folds at one skew of sampling, m rows of each.

    Attributes:
        skew: the skew [s].
        gram: X^T W X of X = [A, N, y], (F, m, P + K + 1, P + K + 1).
        plain: the same without skew.
        count: weight of the rows, (F, m).
        floor2: mean square of a healthy arm [N^2 m^2], (F, m).
        independent: effective number of independent samples, (F, m).
    """

    def __init__(self, folds: Sequence[Fold], skew: float) -> None:
        self.skew = skew
        raw = np.array([fold.gram.sum(axis=0) for fold in folds])
        self.gram = _with_skew(raw, skew)
        self.plain = _with_skew(raw, 0.0)
        self.count = np.array([fold.rows.sum(axis=0) for fold in folds])
        self.floor2 = np.array([fold.floor for fold in folds]) ** 2
        self.independent = np.array([fold.independent for fold in folds])


class Evidence:
    """Scores sets of terms on one linearisation.

    Args:
        linearisation: normal equations per fold and joint.
        missed: mean square of the rows that are scored under the model so far, for the weights, (F, m).
        sigma: relative error of the nominal inertials.
        rows: rows of the recorded torque, and those that are scored; see the attributes.

    Attributes:
        skew: skew of sampling [s].
        torque: rows of the recorded torque, in which gaps are told.
        told: rows from which values and scores come: the same, or with sensors both sides of each joint.
        spread: standard deviation of each nuisance, in its unit, (K,).
    """

    def __init__(
        self,
        linearisation: Linearisation,
        scored_mse: np.ndarray,
        sigma: float,
        rows: tuple[Rows, Rows],
    ) -> None:
        self.linear, self.sigma = linearisation, sigma
        self.terms = linearisation.terms
        self.torque, self.scored = rows
        self.skew = self.torque.skew
        scored = self.scored
        self.weights = (
            scored.independent
            / np.maximum(scored.count, 1e-9)
            / (scored_mse + scored.floor2)
        )
        weighted = np.array(
            [
                np.tensordot(w, g, axes=1)
                for w, g in zip(self.weights, scored.gram, strict=True)
            ]
        )
        total = weighted.sum(axis=0)
        k, bodies = total.shape[0] - 1 - self.terms.size, len(linearisation.data.units)
        self.spread = np.where(
            np.arange(k) < bodies, sigma, 1.0
        )  # the sensors' errors are in units of theirs
        self._all = NormalEquations(total, self.terms.size, self.spread)
        self._without = [
            NormalEquations(total - w, self.terms.size, self.spread) for w in weighted
        ]
        self.lowest = _lowest(linearisation)
        last = linearisation.body.last_link
        self._one_body = frozenset(
            {*self.terms.of("payload"), self.terms.of("link_inertia")[last]}
        )
        information = total[self.terms.size : -1, self.terms.size : -1] * np.outer(
            self.spread, self.spread
        )
        self._log_det = 0.5 * float(np.linalg.slogdet(np.eye(k) + information)[1])
        self.per_parameter = 0.5 * float(np.log(scored.independent.sum()))

    @property
    def rows(self) -> np.ndarray:
        """Weight of the rows of the recorded torque, (F, n)."""
        return self.torque.count

    @property
    def floor2(self) -> np.ndarray:
        """Mean square of a healthy arm's torque gap [N^2 m^2], (F, n)."""
        return self.torque.floor2

    def fit(self, terms: frozenset[Term]) -> Fit:
        """Fit and score a set of terms; the score is minus infinity where a value could not be."""
        theta = self._all.solve(_columns(terms))
        held_out_mse = self.held_out_mse(terms)
        delta = self._all.nuisance(theta, _columns(terms))
        scored_mse = held_out_mse
        if self.scored is not self.torque:
            scored_mse = _mean_square(
                self.scored.gram,
                self.scored.count,
                self._without,
                _columns(terms),
                corrected=True,
            )
        cost = (
            self.charge(terms)
            + SKEW_CHARGE * (self.skew > 0)
            + NOMINAL_ERROR[self.sigma]
        )
        cost += 0.5 * float(((delta / self.spread) ** 2).sum()) + self._log_det
        score = (
            -0.5
            * float(
                (
                    self.scored.independent * np.log1p(scored_mse / self.scored.floor2)
                ).sum()
            )
            - cost
        )
        impossible = self.terms.impossible(theta, terms, self.lowest)
        if self._one_body <= terms:  # a payload is part of the last link
            impossible |= frozenset(t for t in self._one_body if t.effect == "payload")
        return Fit(
            terms,
            -np.inf if impossible else score,
            cost,
            theta,
            held_out_mse,
            scored_mse,
            impossible,
        )

    def charge(self, terms: frozenset[Term]) -> float:
        """What a set costs [nats]: half the logarithm of the samples per parameter, and so much per effect named."""
        return self.per_parameter * cost(terms) + NEW_EFFECT * count_findings(terms)

    def bootstrap(
        self, terms: frozenset[Term], rng: np.random.Generator, draws: int = 200
    ) -> np.ndarray:
        """Values of the terms on pieces of the data drawn with replacement, shape (draws, P): a block bootstrap.

        To each draw an error is added that pieces of the same data cannot show: what the form of the model, wrong by
        ``MODEL_FORM``, may shift a value by, were half of it proportional to the term's own column.
        """
        columns = _columns(terms)
        last = self.scored.gram.shape[-1] - 1
        pieces = self._pieces(
            np.concatenate([columns, np.arange(self.terms.size, last + 1)])
        )
        values = np.zeros((draws, self.terms.size))
        for draw in range(draws):
            counts = np.bincount(
                rng.integers(len(pieces), size=len(pieces)), minlength=len(pieces)
            ).astype(float)
            total = np.tensordot(counts, pieces, axes=1)
            values[draw, columns] = NormalEquations(
                total, len(columns), self.spread
            ).solve(np.arange(len(columns)))
        return values + rng.normal(size=values.shape) * self._systematic()

    def halves(self) -> tuple[np.ndarray, np.ndarray]:
        """Weighed normal equations of every other piece of the data, and of those between."""
        pieces = self._pieces(np.arange(self.scored.gram.shape[-1]))
        return pieces[::2].sum(axis=0), pieces[1::2].sum(axis=0)

    def _pieces(self, places: np.ndarray) -> np.ndarray:
        """Weighed normal equations of every piece of the data, over some of the columns, (pieces, C, C)."""
        return np.concatenate(
            [
                np.einsum(
                    "bjxy,j->bxy",
                    _with_skew(fold.scored.gram, self.skew)[
                        :, :, places[:, None], places
                    ],
                    w,
                )
                for fold, w in zip(self.linear.folds, self.weights, strict=True)
            ]
        )

    def _systematic(self) -> np.ndarray:
        """Standard deviation that the form of the model adds to each value, (P,)."""
        power = np.diagonal(self.torque.gram, axis1=2, axis2=3)[
            :, :, : self.terms.size
        ].sum(axis=0)
        column = np.sqrt(power / self.rows.sum(axis=0)[:, None])
        torque = self.linear.data.torque_deviation[:, None]
        return (0.5 * MODEL_FORM * torque / np.maximum(column, 1e-12)).min(axis=0)

    def without_last(self, terms: frozenset[Term]) -> np.ndarray:
        """Values of the terms fitted without the last recording, shape (P,)."""
        weighted = (self.scored.gram * self.weights[:, :, None, None]).sum(axis=1)
        total = weighted[:-2].sum(axis=0) if len(weighted) > 2 else weighted.sum(axis=0)
        return NormalEquations(total, self.terms.size, self.spread).solve(
            _columns(terms)
        )

    def left_out(self, terms: frozenset[Term]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Per recording the values of the terms fitted without its first, and without its second half, (P,) each."""
        values = [normal.solve(_columns(terms)) for normal in self._without]
        return list(zip(values[::2], values[1::2], strict=True))

    def held_out_mse(
        self, terms: frozenset[Term], *, corrected: bool = True
    ) -> np.ndarray:
        """Mean square of the gap on each fold under values fitted to the others [N^2 m^2], (F, n).

        ``corrected`` says whether the nuisances, errors of the nominal inertials and skew, are taken out as well.
        """
        return self._gap(terms, self._without, corrected)

    def in_sample_mse(
        self, terms: frozenset[Term], *, corrected: bool = True
    ) -> np.ndarray:
        """Mean square of the gap on each fold under values fitted to all folds [N^2 m^2], (F, n)."""
        return self._gap(terms, [self._all] * len(self.rows), corrected)

    def sensor_errors(self, terms: frozenset[Term]) -> np.ndarray | None:
        """Zero, scale and lag of each joint's torque sensor with a set of terms, over their spread, (3 n,)."""
        if self.scored is self.torque:
            return None
        delta = self._all.nuisance(self._all.solve(_columns(terms)), _columns(terms))
        return delta[len(self.linear.data.units) :]

    def _gap(
        self, terms: frozenset[Term], normals: list[NormalEquations], corrected: bool
    ) -> np.ndarray:
        gram = self.torque.gram if corrected else self.torque.plain
        return _mean_square(
            gram, self.torque.count, normals, _columns(terms), corrected=corrected
        )


def _mean_square(
    gram: np.ndarray,
    count: np.ndarray,
    normals: list[NormalEquations],
    columns: np.ndarray,
    *,
    corrected: bool,
) -> np.ndarray:
    """Mean square of what is left of each fold's rows, (F, m), with values from its normal equations."""
    squares = [
        normal.rest(of_fold, normal.solve(columns), columns, corrected=corrected)
        for of_fold, normal in zip(gram, normals, strict=True)
    ]
    return np.array(squares) / np.maximum(count, 1e-9)


def _columns(terms: frozenset[Term]) -> np.ndarray:
    return np.array(sorted(c for t in terms for c in t.columns), dtype=int)


def _with_skew(gram: np.ndarray, skew: float) -> np.ndarray:
    """Normal equations of [A, N, y - skew d] from those of [A, N, y, d]; over the last two axes."""
    if skew == 0:
        return gram[..., :-1, :-1]
    out = gram[..., :-1, :-1].copy()
    out[..., :-1, -1] -= skew * gram[..., :-2, -1]
    out[..., -1, :-1] = out[..., :-1, -1]
    out[..., -1, -1] += skew**2 * gram[..., -1, -1] - 2 * skew * gram[..., -2, -1]
    return out


def _lowest(linearisation: Linearisation) -> np.ndarray:
    """Lowest values: friction, armature and the last link's mass may not fall below zero in total.

    A delay must be longer than what sampling explains.
    """
    arm, terms = linearisation.arm, linearisation.terms
    lowest = np.full(terms.size, -np.inf)
    for effect in explained():
        fitted, places = parametrisation_of(effect), terms.block(effect.name)[0]
        lowest[places] = LEAST_DELAY if effect.delays else fitted.lowest
        if fitted.data_sheet is not None:
            lowest[places] = -getattr(arm, fitted.data_sheet) - 1e-9
    own = linearisation.body.inertial_parameters()[::10]
    lowest[terms.block("payload")[0]] = -own[linearisation.body.last_link]
    lowest[terms.block("link_inertia")[0]] = -0.95 * own
    return lowest


def evidences(
    linearisation: Linearisation, scored_mse: np.ndarray, terms: frozenset[Term]
) -> tuple[Evidence, ...]:
    """The evidence under each error of the nominal inertials, best first, with the skew that explains the data best."""

    def ranked(candidates: list[Evidence]) -> tuple[Evidence, ...]:
        return tuple(
            sorted(
                candidates, key=lambda evidence: evidence.fit(terms).score, reverse=True
            )
        )

    def rows(skew: float) -> tuple[Rows, Rows]:
        torque = Rows(linearisation.folds, skew)
        return torque, Rows(
            [f.scored for f in linearisation.folds], skew
        ) if linearisation.data.sensed else torque

    best = ranked(
        [Evidence(linearisation, scored_mse, 0.01, rows(skew)) for skew in SKEWS]
    )[0]
    return ranked(
        [
            Evidence(linearisation, scored_mse, sigma, (best.torque, best.scored))
            for sigma in NOMINAL_ERROR
        ]
    )
