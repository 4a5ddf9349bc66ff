"""Significance by split samples, with the false discovery rate controlled.

Pieces of the recordings are assigned alternately to two halves, A and B. For an effect among those found,

    log e = l_B|A(all effects, fitted to A) - max l_B|A(all but this one)

with l_B|A the Gaussian log likelihood of the weighted gap of B, by effective samples, given what A says of the nominal
arm's errors: half of L(A) - L(A and B), L the least sum of squares over them. Whatever values A gives to the effect,
E[e] <= 1 if the effect is absent, so that 1 / e bounds the probability of such a value [wasserman2020]; the same holds
for the mean of e over both directions. Of m effects tried, those are confirmed of which the k-th largest e is at least
m / (k rate): then at most that share of them is expected to be there by chance, whatever their dependence [wang2022].

An effect that errors of the nominal arm could imitate is hard to confirm: once A has estimated these errors, they
predict B no worse. The evidence still prefers it, because one change of one body costs less than errors of all bodies.
On short or odd recordings the values that A gives to all other effects fail on B, and nothing is confirmed. An effect
that is not confirmed stays in the diagnosis, marked as such.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gapscope.diagnosis.model.normal_equations import NormalEquations, solve
from gapscope.diagnosis.selection.moves import by_finding
from gapscope.diagnosis.selection.resampling import alternate_pieces
from gapscope.diagnosis.selection.search import Selection
from gapscope.effects.catalogue import explained
from gapscope.model.terms import Term


def log_e_values(selection: Selection) -> dict[str, float]:
    """log e of each effect found [nats]; compliant joints have none, as no linear model is without them."""
    evidence, terms = selection.evidence, selection.fit.terms
    first, second = alternate_pieces(evidence)

    def least(total: np.ndarray) -> np.ndarray:
        return NormalEquations(total, evidence.terms.size, evidence.prior).least

    least_first, least_second = least(first), least(second)
    least_both = least(first + second)

    # Pairs of the half that is fitted, and what the other half adds to it.
    directions = [
        (least_first, least_both - least_first),
        (least_second, least_both - least_second),
    ]

    rigid = frozenset(t for t in terms if t.definition.locally_linear)
    out = {}
    for tested_terms in by_finding(rigid):
        logs = [
            log_e_value(terms, tested_terms, fitted, tested)
            for fitted, tested in directions
        ]
        name = next(iter(tested_terms)).finding
        out[name] = _log_mean(logs)
    return out


def false_discovery_rates(
    log_e: Mapping[str, float], tried: int | None = None
) -> dict[str, float]:
    """The least false discovery rate at which each effect would be confirmed, at most 1 (e-BH).

    With e-values in falling order, e_(1) >= e_(2) ..., the first k are confirmed at the rate m / (k e_(k)), and with
    them every larger one. Source: wang2022.

    Args:
        log_e: of each effect found [nats].
        tried: m, number of effects that were tried; ``None`` for all that a torque gap can show.
    """
    tried = len(explained()) if tried is None else tried
    ranked = sorted(log_e, key=lambda name: log_e[name], reverse=True)

    rates = []
    for k, name in enumerate(ranked, 1):
        # The bound keeps the inverse finite; the rate is 1 there anyway.
        inverse = float(np.exp(-max(log_e[name], -50.0)))
        rates.append(min(1.0, tried / k * inverse))

    # A larger e is confirmed whenever a smaller one is.
    return {name: min(rates[k:]) for k, name in enumerate(ranked)}


def log_e_value(
    terms: frozenset[Term],
    part: frozenset[Term],
    fitted: np.ndarray,
    tested: np.ndarray,
) -> float:
    """log e of some of the terms [nats].

    Args:
        terms: all terms.
        part: those that are tested.
        fitted: L of the half that is fitted, (P + 1, P + 1); half of [theta; -1]^T L [theta; -1] is the loss.
        tested: L of both halves less that of the fitted one, (P + 1, P + 1).
    """

    def loss(theta: np.ndarray) -> float:
        z = np.append(theta, -1.0)
        return 0.5 * float(z @ tested @ z)

    # Without the part, all others may fit the tested half itself: the most favourable case against the part.
    without_part = solve(tested, _columns(terms - part))
    with_all = solve(fitted, _columns(terms))
    return loss(without_part) - loss(with_all)


def _columns(terms: frozenset[Term]) -> np.ndarray:
    return np.array(sorted(c for t in terms for c in t.columns), dtype=int)


def _log_mean(logs: list[float]) -> float:
    """Logarithm of the mean of values with these logarithms."""
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))
