"""Whether a quantity differs between recordings by more than between stretches of one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, f

from gapscope.diagnosis.agreement.equations import Equations
from gapscope.diagnosis.agreement.hypotheses import Hypothesis
from gapscope.diagnosis.agreement.stretch_model import Scores, StretchModel

RANK = 1e-6
"""A direction of which no more than this share lies outside the model is none [1]."""


@dataclass(frozen=True)
class Difference:
    """Analysis of variance of one hypothesis, all else as the model has it.

    Attributes:
        between: what recordings with values of their own lower the sum of weighted squares by [1].
        between_freedom: degrees of freedom of that, at least 0.
        within: what further values for every stretch lower it by [1].
        within_freedom: degrees of freedom of that.
    """

    between: float
    between_freedom: int
    within: float
    within_freedom: int

    @property
    def scatter(self) -> float:
        """Mean square of the differences between stretches of one recording over what noise gives, at least 1 [1]."""
        return max(1.0, self.within / max(self.within_freedom, 1))

    @property
    def evidence(self) -> float:
        """``between`` over ``scatter`` [1]."""
        return self.between / self.scatter

    @property
    def p(self) -> float:
        """Probability of a difference at least as large if all recordings have one value [1]: F-test."""
        if not self.between_freedom:
            return 1.0
        if not self.within_freedom:
            return float(chi2.sf(self.evidence, self.between_freedom))
        ratio = self.evidence / self.between_freedom
        return float(f.sf(ratio, self.between_freedom, self.within_freedom))


@dataclass(frozen=True)
class RecordingValues:
    """A hypothesis' values in each recording; nan in a recording that does not determine them.

    Attributes:
        every: along its d directions, (R, d).
        std: standard deviation of the first of them, widened by the scatter between stretches, (R,).
    """

    every: np.ndarray
    std: np.ndarray

    @property
    def value(self) -> np.ndarray:
        """The first of them, in the unit of the hypothesis, (R,)."""
        return np.asarray(self.every[:, 0])


def information_ratio(model: StretchModel, one: Hypothesis) -> np.ndarray:
    """Prior variance of a value over the variance that each recording leaves of it, all else shared [1], (R,)."""
    reduced = model.without("", one.replaces) if one.replaces is not None else model
    scores = reduced.scores(one.directions)
    spread = one.spread / scores.unit[0]
    ratios = []
    for number in range(model.of.count):
        own = model.of.recording == number
        block = scores.information[own][:, :, own].sum(axis=(0, 2))
        ratios.append(spread**2 * _information_of_first(block))
    return np.array(ratios)


def difference(
    model: StretchModel, one: Hypothesis, recordings: np.ndarray
) -> Difference:
    """Test whether a hypothesis' values differ between these recordings, numbers of shape (k,)."""
    scores = model.scores(one.directions)
    means, rests = contrasts(model.of, recordings)
    between, first = _explained(scores, means)
    every, both = _explained(scores, np.concatenate([means, rests]))
    return Difference(between, first, max(every - between, 0.0), max(both - first, 0))


def recording_values(
    model: StretchModel, one: Hypothesis, recordings: np.ndarray, scatter: float
) -> RecordingValues:
    """Values of a hypothesis in these recordings, all else as the model has it."""
    of = model.of
    reduced = model.without(one.key, one.replaces)
    scores = reduced.scores(one.directions)
    basis = _indicators(of, recordings)
    if one.replaces is None:
        basis = contrasts(of, recordings)[0]
    s, v = _combined(scores, basis)
    inverse = _pseudo_inverse(v)[0]
    d = len(one.directions)
    # from coordinates of the basis to values per recording
    back = basis @ _indicators(of, recordings).T / _stretches(of, recordings)
    every = np.kron(back, np.diag(scores.unit)).T
    variances = np.diag(every @ inverse @ every.T)[::d]
    found = (every @ inverse @ s).reshape(-1, d)
    if one.replaces is None:
        # only differences are determined: values count from the first recording, deviations from the mean
        found = found - found[0]
    out = RecordingValues(np.full((of.count, d), np.nan), np.full(of.count, np.nan))
    out.every[recordings] = found
    out.every[recordings, 0] += one.centre
    out.std[recordings] = np.sqrt(np.maximum(variances, 0.0) * scatter)
    return out


def visible_size(of: Equations, one: Hypothesis, values: RecordingValues) -> float:
    """Largest RMS torque by which two recordings differ, over the torque's scale of that joint [1]."""
    power = np.einsum("dja,jab,ejb->jde", one.directions, of.power, one.directions)
    known = values.every[np.isfinite(values.std)]
    apart = known[:, None] - known[None]
    squares = np.einsum("rsd,jde,rse->rsj", apart, power, apart, optimize=True)
    return float(np.sqrt(np.maximum(squares, 0.0).max(initial=0.0)))


def contrasts(of: Equations, recordings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Contrasts over the stretches: between these recordings, (k - 1, K), and within each of them, (m, K)."""
    indicators = _indicators(of, recordings)
    between = _helmert(len(recordings)) @ indicators
    within = []
    for number in recordings:
        places = np.flatnonzero(of.recording == number)
        rows = np.zeros((len(places) - 1, len(of.recording)))
        rows[:, places] = _helmert(len(places))
        within.append(rows)
    return between, np.concatenate(within)


def _indicators(of: Equations, recordings: np.ndarray) -> np.ndarray:
    """1 in the stretches of each of these recordings, (k, K)."""
    return (of.recording == recordings[:, None]).astype(float)


def _stretches(of: Equations, recordings: np.ndarray) -> np.ndarray:
    """Number of stretches of each of these recordings, (k,)."""
    return _indicators(of, recordings).sum(axis=1)


def _helmert(count: int) -> np.ndarray:
    """Orthonormal contrasts of ``count`` values, (count - 1, count): deviations from their mean."""
    centring = np.eye(count) - 1.0 / count
    return np.asarray(np.linalg.eigh(centring)[1][:, 1:].T)


def _combined(scores: Scores, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Score and information in coordinates of a basis over the stretches, (r, K): (r d,) and (r d, r d)."""
    size = len(basis) * len(scores.unit)
    s = (basis @ scores.score).reshape(size)
    v = np.einsum("rk,kdle,sl->rdse", basis, scores.information, basis, optimize=True)
    return s, v.reshape(size, size)


def _explained(scores: Scores, basis: np.ndarray) -> tuple[float, int]:
    """S^T V^+ s in a basis over the stretches, and the rank of V."""
    s, v = _combined(scores, basis)
    inverse, rank = _pseudo_inverse(v)
    return float(s @ inverse @ s), rank


def _pseudo_inverse(v: np.ndarray) -> tuple[np.ndarray, int]:
    """Inverse of an information matrix on the directions that are determined, and how many there are."""
    values, vectors = np.linalg.eigh(v)
    kept = values > RANK
    vectors = vectors[:, kept]
    return (vectors / values[kept]) @ vectors.T, int(kept.sum())


def _information_of_first(v: np.ndarray) -> float:
    """Information on the first of d values if the others are unknown; 0 if it is not determined."""
    inverse = _pseudo_inverse(v)[0]
    determined = float((inverse @ v)[0, 0])
    if determined < 1.0 - 1e-3 or inverse[0, 0] <= 0.0:
        return 0.0
    return 1.0 / float(inverse[0, 0])
