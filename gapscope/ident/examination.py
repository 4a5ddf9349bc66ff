"""An identification examined: what can be identified, and how it predicts motions it was not fitted to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfreqz
from scipy.stats import chi2

from gapscope.ident.intervals import (
    DOUBT,
    GroupComparison,
    TorqueInterval,
)
from gapscope.ident.model.base_parameters import (
    TINY,
    BaseParameters,
    EssentialParameters,
    rank_by_gap,
    unit_triangle,
)
from gapscope.ident.samples import Band, SampleCount
from gapscope.model.conditioning import Segment
from gapscope.model.effective_samples import (
    autocovariance,
)

# Which parameters of an arm a motion determines: rank, condition, spectrum, standing of each parameter.


CONDITION_LIMIT = 1000.0
"""Condition number above which a report warns."""
_WEAK = 0.3


@dataclass(frozen=True)
class Identifiability:
    """What samples determine of p parameters pi of an arm, whose structure leaves b base parameters.

    Attributes:
        base: base parameters of the arm.
        rank: how many base parameters, or combinations of them, the samples determine.
        condition: condition number of the base columns, scaled to unit norm [1].
        singular_values: of the unit base columns over their largest, shape (b,), falling.
        column_norms: RMS torque of each parameter per unit of it [N m per unit], shape (p,).
        weakest: the base parameters that make up the worst determined combination, largest share first.
        warnings: what makes results doubtful, each a sentence with a remedy.
    """

    base: BaseParameters
    rank: int
    condition: float
    singular_values: np.ndarray
    column_norms: np.ndarray
    weakest: tuple[str, ...]
    warnings: tuple[str, ...]


def identifiability(samples: np.ndarray, base: BaseParameters) -> Identifiability:
    """What samples determine of the parameters of an arm.

    Args:
        samples: regressor of all p parameters, shape (M, p) or (N, n, p).
        base: base parameters of the arm (``structural_base``), which separate what the arm cannot show from what the
            motion does not show.

    Raises:
        InputError: values that are not finite, too few rows, or no motion at all.

    Source: gautier1992.
    """
    scaled, norms = unit_triangle(samples, base.names)
    unit = scaled[:, base.kept]
    values, right = np.linalg.svd(unit)[1:]
    relative = values / values[0]
    rank, condition = rank_by_gap(relative), float(np.linalg.cond(unit))
    # the parameters that make up the direction that the samples show least
    last, names = np.abs(right[-1]), base.kept_names
    order = np.argsort(-last).tolist()
    weakest = tuple(names[k] for k in order if last[k] > _WEAK * last.max())
    warnings = []
    if rank < base.count:
        warnings.append(
            f"the samples determine only {rank} of {base.count} base parameters, not {', '.join(weakest)}; "
            "record a motion that moves every joint, up to higher speed and acceleration"
        )
    if condition > CONDITION_LIMIT:
        warnings.append(
            f"condition number {condition:.3g} with unit columns is above {CONDITION_LIMIT:g}: "
            f"{', '.join(weakest)} cannot be separated; record an optimised exciting motion, or drop what is not "
            "essential"
        )
    # columns without content are zero, and have the norm 1
    seen = scaled.any(axis=0) * norms / np.sqrt(samples.size / len(norms))
    return Identifiability(
        base=base,
        rank=rank,
        condition=condition,
        singular_values=relative,
        column_norms=seen,
        weakest=weakest,
        warnings=tuple(warnings),
    )


# Validation: how well the identified model predicts recordings, per joint, and whether the residual is noise.


MOVING = 0.05
"""A joint moves when it is faster than this [rad/s]."""
LAGS = 20
"""Lags of the test for whiteness."""
Predict = Callable[[Segment], np.ndarray]


@dataclass(frozen=True)
class Errors:
    """Errors of predicted torque on some samples, n joints.

    Attributes:
        rmse: [N m], shape (n,).
        relative: RMS residual over RMS torque [1], shape (n,); NaN if there is no sample.
        largest: [N m], shape (n,).
        overall: RMS residual over RMS torque of all joints together [1].
        share: of the samples that count, per joint [1], shape (n,).
    """

    rmse: np.ndarray
    relative: np.ndarray
    largest: np.ndarray
    overall: float
    share: np.ndarray


@dataclass(frozen=True)
class Whiteness:
    """Whether residuals are what the band leaves of white noise, sampled at the cut-off, n joints.

    Attributes:
        statistic: Ljung and Box's Q over ``LAGS`` lags [1], shape (n,).
        p_value: how often white noise has a larger one, shape (n,).
        largest: largest autocorrelation beyond the band's own at lags from 1 [1], shape (n,).
        bound: what white noise stays below with 99 % probability at any one lag [1].
    """

    statistic: np.ndarray
    p_value: np.ndarray
    largest: np.ndarray
    bound: float

    @property
    def white(self) -> np.ndarray:
        """Joints whose residual may be noise, shape (n,)."""
        return self.p_value > DOUBT


@dataclass(frozen=True)
class Validation:
    """Prediction against a group of recordings.

    Attributes:
        recordings: their names.
        role: ``fit`` or ``judge``.
        every: errors on every sample whose torque was measured.
        moving: errors while the joint is faster than ``MOVING``.
        nominal: errors of the nominal arm on every sample.
        whiteness: of the residual.
        t: time, of the segments one after the other [s], shape (M,).
        torque, predicted, before: recorded, predicted and the nominal arm's torque in the band [N m], (M, n).
        velocity: dq [rad/s], (M, n).
        edges: rows at which segments begin, and the end.
    """

    recordings: tuple[str, ...]
    role: str
    every: Errors
    moving: Errors
    nominal: Errors
    whiteness: Whiteness
    t: np.ndarray
    torque: np.ndarray
    predicted: np.ndarray
    before: np.ndarray
    velocity: np.ndarray
    edges: tuple[int, ...]


def validate(
    role: str,
    segments: Sequence[Segment],
    band: Band,
    predict: Predict,
    nominal: Predict,
) -> Validation:
    """Compare predictions with recorded torque, both in the band.

    Args:
        role: ``fit`` or ``judge``.
        segments: with torque.
        band: in which both sides are compared.
        predict: the identified model, segment to torque [N m], (N, n).
        nominal: the nominal arm, likewise.
    """
    parts: list[tuple[np.ndarray, ...]] = []
    for segment in segments:
        rows = band.rows(segment)
        motion = segment.motion
        sides = (np.asarray(segment.torque), predict(segment), nominal(segment))
        filtered = (band.filtered(side, segment) for side in sides)
        known = motion.t[rows], motion.dq[rows], segment.measured[rows]
        parts.append((*known, *filtered))
    t, dq, every, torque, after, before = map(np.concatenate, zip(*parts, strict=True))
    lengths = [len(part[0]) for part in parts]
    edges = np.cumsum([0, *lengths])
    group = np.repeat(np.arange(len(parts)), lengths)
    names = tuple(dict.fromkeys(segment.recording for segment in segments))
    rate = segments[0].motion.rate
    # the test of whiteness sees the samples that the band holds, not more
    step = max(1, round(rate / band.cutoff))
    residual = np.where(every, torque - after, 0.0)[::step]
    expected = band_correlation(rate, band.cutoff, step)
    return Validation(
        recordings=names,
        role=role,
        every=errors(torque, after, every),
        moving=errors(torque, after, every & (np.abs(dq) > MOVING)),
        nominal=errors(torque, before, every),
        whiteness=whiteness(residual, group[::step], expected),
        t=t,
        torque=torque,
        predicted=after,
        before=before,
        velocity=dq,
        edges=tuple(edges.tolist()),
    )


def errors(torque: np.ndarray, predicted: np.ndarray, counted: np.ndarray) -> Errors:
    """Errors [N m] on the samples that count; torque, prediction and mask of shape (N, n)."""
    residual, known = (np.where(counted, x, 0.0) for x in (torque - predicted, torque))
    count = counted.sum(axis=0)
    squares, power = (residual**2).sum(axis=0), (known**2).sum(axis=0)
    # a joint without samples has no relative error
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(count > 0, np.sqrt(squares / power), np.nan)
        overall = float(np.sqrt(squares.sum() / power.sum()))
    return Errors(
        rmse=np.sqrt(squares / np.maximum(count, 1)),
        relative=relative,
        largest=np.abs(residual).max(axis=0),
        overall=overall,
        share=count / len(torque),
    )


def band_correlation(rate: float, cutoff: float, step: int) -> np.ndarray:
    """Autocorrelation that the zero-phase low-pass gives white noise at multiples of ``step`` samples, (LAGS + 1,)."""
    filter_ = butter(4, min(cutoff, 0.95 * rate / 2), output="sos", fs=rate)
    frequency, response = sosfreqz(filter_, 4096, fs=rate)
    # forward and backward: the power gain is the fourth power of the response
    power = np.abs(response) ** 4
    lags = np.arange(LAGS + 1) * step / rate
    phase = 2 * np.pi * lags[:, None] * frequency
    covariance = (power * np.cos(phase)).sum(axis=1)
    return np.asarray(covariance / covariance[0])


def whiteness(
    residual: np.ndarray, group: np.ndarray, expected: np.ndarray
) -> Whiteness:
    """Ljung and Box's test, Q = N (N + 2) sum_{k=1}^{m} (rho_k - rho0_k)^2 / (N - k), chi-squared of m degrees.

    Args:
        residual: [N m], shape (N, n).
        group: stretch that a sample belongs to, shape (N,).
        expected: rho0, autocorrelation of noise that has passed the band, from lag 0, shape (at least m + 1,).

    Source: ljung1978.
    """
    n = len(residual)
    lags = max(1, min(LAGS, n // 4))
    covariance = autocovariance(residual - residual.mean(axis=0), group, lags)
    rho = covariance[1:] / np.maximum(covariance[0], TINY)
    beyond_band = rho - expected[1 : lags + 1, None]
    pairs = (n - np.arange(1, lags + 1))[:, None]
    statistic = n * (n + 2) * (beyond_band**2 / pairs).sum(axis=0)
    p_value = chi2.sf(statistic, lags)
    # 99 % of the correlations of white noise lie within this
    bound = float(2.576 / np.sqrt(n))
    return Whiteness(
        statistic=statistic,
        p_value=p_value,
        largest=np.abs(beyond_band).max(axis=0),
        bound=bound,
    )


# What recordings determine of the parameters, and how far the model may be off: the findings beside the estimate.


@dataclass(frozen=True)
class Examination:
    """What recordings determine of the parameters.

    Attributes:
        shown: rank, condition and spectrum of the samples, against the base parameters of the arm's structure.
        essential: base parameters that explain the fitted torque; ``None`` if samples do not suffice.
        groups: segments identified one by one; ``None`` if one does not determine the parameters.
        interval: of predicted torque; ``None`` if the others do not determine the parameters when one is held out.
        counted: how many independent samples there are.
        reasons: why something is ``None``, each a sentence.
    """

    shown: Identifiability
    essential: EssentialParameters | None
    groups: GroupComparison | None
    interval: TorqueInterval | None
    counted: SampleCount
    reasons: tuple[str, ...]

    def warnings(self) -> tuple[str, ...]:
        """What makes the result doubtful, each with a remedy."""
        found: list[str] = []
        shown = self.shown
        if shown.rank < shown.base.count or shown.condition > CONDITION_LIMIT:
            found += shown.warnings[:1]
        model_error = self.interval is not None and bool(self.interval.warnings)
        found += self.counted.warnings(model_error=model_error)
        if self.interval is not None:
            found += self.interval.warnings
        elif self.reasons:
            last = self.reasons[-1]
            found.append(f"the recordings cannot be checked for model error: {last}")
        return tuple(found)
