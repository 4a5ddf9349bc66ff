"""Significance by split samples, with the rate of false discoveries held.

Pieces of the recordings are dealt alternately to two halves, A and B. For an effect among those found,

    log e = l_B(all effects, fitted to A) - max l_B(all but this one, fitted to B)

with l the Gaussian log likelihood of the weighed gap, by effective samples. Whatever A made of the effect, E[e] <= 1
where there is none, so that 1 / e bounds the probability of such a value [wasserman2020]; so does the mean of e over
both directions. Of m effects tried, those are kept of which the k-th largest e is at least m / (k rate): then at most
that share of the effects kept is expected to be there by chance, however they depend on each other [wang2022].
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from diagnosis.evidence import Evidence
from diagnosis.moves import RINGING, by_finding
from diagnosis.normal import Normal
from diagnosis.search import Search
from diagnosis.terms import EXPLAINED, Term

RATE = 0.05
"""Share of the effects named that may be there by chance."""


def log_e_values(found: Search) -> dict[str, float]:
    """log e of each effect found [nats]; not of joints that ring or play, of which a linear model without is none."""
    evidence, terms = found.evidence, found.fit.terms
    halves = evidence.halves()
    calm = frozenset(t for t in terms if t.effect not in RINGING)
    return {
        next(iter(part)).finding: _mean([_log_e(evidence, terms, part, a, b) for a, b in halves])
        for part in by_finding(calm)
    }


def false_discovery_rates(log_e: Mapping[str, float], tried: int = len(EXPLAINED)) -> dict[str, float]:
    """The least rate of false discoveries at which each effect would be kept, at most 1.

    Args:
        log_e: of each effect found [nats].
        tried: effects that were tried.
    """
    ranked = sorted(log_e, key=lambda name: log_e[name], reverse=True)
    rates = [min(1.0, tried / (k + 1) * float(np.exp(-max(log_e[name], -50.0)))) for k, name in enumerate(ranked)]
    return {name: min(rates[k:]) for k, name in enumerate(ranked)}


def _mean(logs: list[float]) -> float:
    """Logarithm of the mean of values with these logarithms."""
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))


def _log_e(
    evidence: Evidence, terms: frozenset[Term], part: frozenset[Term], fitted: np.ndarray, tested: np.ndarray
) -> float:
    """log e of some of the terms, with one half's normal equations to fit and the other's to test."""

    def loss(half: np.ndarray, chosen: frozenset[Term]) -> float:
        columns = np.array(sorted(c for t in chosen for c in t.columns), dtype=int)
        normal = Normal(half, evidence.terms.size, evidence.spread)
        theta = normal.solve(columns)
        z = np.concatenate([-theta, -normal.nuisance(theta, columns), [1.0]])
        return 0.5 * float(z @ tested @ z)

    return loss(tested, terms - part) - loss(fitted, terms)
