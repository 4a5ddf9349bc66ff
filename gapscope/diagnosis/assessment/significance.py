"""Significance by split samples, with the rate of false discoveries held.

Pieces of the recordings are dealt alternately to two halves, A and B. For an effect among those found,

    log e = l_B|A(all effects, fitted to A) - max l_B|A(all but this one)

with l_B|A the Gaussian log likelihood of the weighed gap of B, by effective samples, once A has told what it can of the
nominal arm's errors: half of L(A) - L(A and B), L the least sum of squares over them. Whatever A made of the effect,
E[e] <= 1 where there is none, so that 1 / e bounds the probability of such a value [wasserman2020]; so does the mean of
e over both directions. Of m effects tried, those are confirmed of which the k-th largest e is at least m / (k rate):
then at most that share of them is expected to be there by chance, however they depend on each other [wang2022].

What errors of the nominal arm could do as well is hard to confirm so: once A has told them, they predict B no worse.
Evidence prefers one change on one body there, for its size. On short or odd recordings the values that A gives to all
the other effects fail on B, and nothing is confirmed. An effect that is not confirmed stays, and is told so.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gapscope.diagnosis.model.normal_equations import NormalEquations, solve
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.moves import by_finding
from gapscope.diagnosis.selection.search import Selection
from gapscope.effects.catalogue import explained


def log_e_values(selection: Selection) -> dict[str, float]:
    """log e of each effect found [nats]; not of joints that ring or play, of which a linear model without is none."""
    evidence, terms = selection.evidence, selection.fit.terms
    pieces = evidence.halves()

    def least(total: np.ndarray) -> np.ndarray:
        return NormalEquations(total, evidence.terms.size, evidence.spread).least

    both = least(pieces[0] + pieces[1])
    halves = [(one, both - one) for one in map(least, pieces)]
    calm = frozenset(t for t in terms if t.definition.locally_linear)
    return {
        next(iter(part)).finding: _mean(
            [_log_e(terms, part, fitted, tested) for fitted, tested in halves]
        )
        for part in by_finding(calm)
    }


def false_discovery_rates(
    log_e: Mapping[str, float], tried: int | None = None
) -> dict[str, float]:
    """The least rate of false discoveries at which each effect would be confirmed, at most 1.

    Args:
        log_e: of each effect found [nats].
        tried: number of effects that were tried; ``None`` for all that a torque gap can show.
    """
    tried = len(explained()) if tried is None else tried
    ranked = sorted(log_e, key=lambda name: log_e[name], reverse=True)
    rates = [
        min(1.0, tried / (k + 1) * float(np.exp(-max(log_e[name], -50.0))))
        for k, name in enumerate(ranked)
    ]
    return {name: min(rates[k:]) for k, name in enumerate(ranked)}


def _mean(logs: list[float]) -> float:
    """Logarithm of the mean of values with these logarithms."""
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))


def _log_e(
    terms: frozenset[Term],
    part: frozenset[Term],
    fitted: np.ndarray,
    tested: np.ndarray,
) -> float:
    """log e of some of the terms, with L of the half to fit, and that of both less it; each (P + 1, P + 1)."""

    def columns(chosen: frozenset[Term]) -> np.ndarray:
        return np.array(sorted(c for t in chosen for c in t.columns), dtype=int)

    def loss(theta: np.ndarray) -> float:
        z = np.append(theta, -1.0)
        return 0.5 * float(z @ tested @ z)

    return loss(solve(tested, columns(terms - part))) - loss(
        solve(fitted, columns(terms))
    )
