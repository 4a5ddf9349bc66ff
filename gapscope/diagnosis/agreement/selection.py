"""Which quantities differ between recordings: the strongest first, until the rest agrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from gapscope.diagnosis.agreement.difference_test import (
    Difference,
    contrasts,
    difference,
    recording_values,
    visible_size,
)
from gapscope.diagnosis.agreement.equations import Equations
from gapscope.diagnosis.agreement.hypotheses import Hypothesis
from gapscope.diagnosis.agreement.stretch_model import StretchModel
from gapscope.diagnosis.thresholds import (
    ALIKE_EVIDENCE,
    FALSE_ALARM_RATE,
    MOST_DIFFERENCES,
    VISIBLE_EFFECT,
)


@dataclass(frozen=True)
class Selection:
    """What differs.

    Attributes:
        model: with values of their own per recording for what differs.
        differences: test of each hypothesis that differs when it was chosen, by key, the strongest first.
        alternatives: keys that would have explained a difference about as well, by key.
        level: probability below which a hypothesis differs [1].
    """

    model: StretchModel
    differences: Mapping[str, Difference]
    alternatives: Mapping[str, tuple[str, ...]]
    level: float


def select(
    of: Equations,
    every: Sequence[Hypothesis],
    determined: Mapping[str, np.ndarray],
) -> Selection:
    """Give recordings values of their own for one hypothesis after another.

    Something differs if an F-test says so at the false-alarm rate divided by the number of hypotheses, and if the
    difference moves some joint's torque visibly. Of all that differ at the undivided rate the one whose
    explanation chance would give least often is next; the others are tested again beside it.

    Args:
        of: the equations.
        every: the hypotheses.
        determined: numbers of the recordings that determine each, by key; with fewer than two it is not tested.
    """
    model = StretchModel.shared(of)
    testable = [one for one in every if len(determined[one.key]) > 1]
    level = FALSE_ALARM_RATE / max(len(testable), 1)
    differences: dict[str, Difference] = {}
    alternatives: dict[str, tuple[str, ...]] = {}
    while len(differences) < MOST_DIFFERENCES:
        rest = [one for one in testable if one.key not in differences]
        tests = _visible(model, rest, determined)
        if all(test.p >= level for test in tests.values()):
            break
        worth = _worth(tests)
        best = max(worth, key=lambda key: worth[key])
        alike = ALIKE_EVIDENCE * tests[best].between
        alternatives[best] = tuple(
            key for key, t in tests.items() if key != best and t.between >= alike
        )
        differences[best] = tests[best]
        chosen = next(one for one in testable if one.key == best)
        model = model.extended(_columns(of, chosen, determined[best]), best)
    return Selection(model, differences, alternatives, level)


def _worth(tests: Mapping[str, Difference]) -> dict[str, float]:
    """-ln of the probability that chance lowers the sum of squares as much, over a scatter common to all, by key.

    One scatter, so that a cause is not beaten by a symptom that happens to scatter less.
    """
    scatter = float(np.median([test.scatter for test in tests.values()]))
    return {
        key: -_log_chance(test.between / scatter, test.between_freedom)
        for key, test in tests.items()
    }


def _log_chance(squares: float, freedom: int) -> float:
    """Ln of the probability that chi-squared exceeds a value; its leading term if that is too small to compute."""
    exact = float(chi2.logsf(squares, freedom))
    if np.isfinite(exact):
        return exact
    y, k = squares / 2.0, freedom / 2.0
    return float(-y + (k - 1.0) * np.log(y) - gammaln(k))


def _visible(
    model: StretchModel,
    rest: Sequence[Hypothesis],
    determined: Mapping[str, np.ndarray],
) -> dict[str, Difference]:
    """Tests of the hypotheses that each alone would differ, and visibly, by key."""
    found = {}
    for one in rest:
        recordings = determined[one.key]
        test = difference(model, one, recordings)
        if test.p >= FALSE_ALARM_RATE:
            continue
        values = recording_values(model, one, recordings, test.scatter)
        if visible_size(model.of, one, values) >= VISIBLE_EFFECT:
            found[one.key] = test
    return found


def _columns(of: Equations, one: Hypothesis, recordings: np.ndarray) -> np.ndarray:
    """Columns that give these recordings values of their own, (q, K, n, b)."""
    between = contrasts(of, recordings)[0]
    columns = np.einsum("rk,dja->rdkja", between, one.directions)
    return columns.reshape(-1, *columns.shape[2:])
