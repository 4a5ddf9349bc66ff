"""Which share of what remains follows the motion: folds of a flexible model, and vibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.assessment.curves import Curve, Variable, curve_of, variables
from gapscope.diagnosis.locate import MotionRows
from gapscope.diagnosis.thresholds import (
    FOLD_GUARD,
    FOURIER_FEATURES,
    KERNEL_LENGTHS,
    MAX_OSCILLATION,
    MIN_OSCILLATION,
    OSCILLATION_GRID,
    PREDICTABLE_MIN_RATIO,
    RIDGE_STRENGTHS,
    ROWS_PER_CUTOFF,
)
from gapscope.ident.examination import band_correlation, whiteness
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.torque_gap import TorqueGap

# Ridge regression with prediction of held-out folds, from sums of normal equations.


@dataclass(frozen=True)
class Folds:
    """How rows are left out together.

    Attributes:
        fold: of each row, (M,).
        fitted: rows that may be fitted, (M,); all are predicted.
    """

    fold: np.ndarray
    fitted: np.ndarray


def predict_held_out(x: np.ndarray, y: np.ndarray, folds: Folds) -> np.ndarray:
    """Prediction of y, (M,), each fold with a ridge regression on columns x, (M, p), of the other folds.

    The strength for a fold is the one that predicts the other folds best, those being left out in turn. If even the
    best is worse than predicting 0 there, the prediction is 0.
    """
    rows_of_fold = [folds.fold == fold for fold in np.unique(folds.fold)]
    by_strength = _predictions(x, y, folds.fitted, rows_of_fold)

    # Squared errors per strength and fold, and those of predicting 0.
    squares = (y - by_strength) ** 2
    errors = np.column_stack([squares[:, rows].sum(axis=1) for rows in rows_of_fold])
    powers = np.array([(y[rows] ** 2).sum() for rows in rows_of_fold])

    out = np.zeros(len(y))
    for k, rows in enumerate(rows_of_fold):
        # A fold has no say in its own strength: it is chosen by how the others are predicted.
        on_others = errors.sum(axis=1) - errors[:, k]
        best = int(np.argmin(on_others))
        if on_others[best] < powers.sum() - powers[k]:
            out[rows] = by_strength[best, rows]
    return out


def _predictions(
    x: np.ndarray, y: np.ndarray, fitted: np.ndarray, rows_of_fold: list[np.ndarray]
) -> np.ndarray:
    """Prediction of each fold from the others under each strength of the ridge, (strengths, M)."""
    # Normal equations of each fold: those of all others are sums less its own.
    grams, rights = [], []
    for rows in rows_of_fold:
        own = rows & fitted
        columns = x[own]
        grams.append(columns.T @ columns)
        rights.append(columns.T @ y[own])
    gram = np.sum(grams, axis=0)
    right = np.sum(rights, axis=0)
    mean_square = np.trace(gram) / len(gram)

    out = np.zeros((len(RIDGE_STRENGTHS), len(y)))
    for rows, own_gram, own_right in zip(rows_of_fold, grams, rights, strict=True):
        # One decomposition serves all strengths: a ridge adds to every eigenvalue.
        value, vector = np.linalg.eigh(gram - own_gram)
        rotated = vector.T @ (right - own_right)

        for k, strength in enumerate(RIDGE_STRENGTHS):
            ridged = np.maximum(value + strength * mean_square, 1e-300)
            coefficients = vector @ (rotated / ridged)
            out[k, rows] = x[rows] @ coefficients
    return out


# An oscillation at one frequency that does not follow the motion, predicted on held-out halves of recordings.


def predict_oscillation(
    t: np.ndarray, gap: np.ndarray, segment: np.ndarray, fold: np.ndarray
) -> np.ndarray:
    """Prediction of a gap [N m], (M,), as a sin(2 pi f t) + b cos(2 pi f t), a and b per recording, f common.

    Each fold is predicted with f from all others, and a and b from the rest of its own recording; 0 if a recording
    has no rest.

    Args:
        t: time of the rows since the start of their recording [s], (M,).
        gap: [N m], (M,).
        segment: recording of each row, (M,).
        fold: what is left out together, (M,).
    """
    durations = [float(np.ptp(t[segment == s])) for s in np.unique(segment)]
    longest = max(durations)
    out = np.zeros(len(gap))
    if longest <= 0:
        return out

    step = 1.0 / (OSCILLATION_GRID * longest)
    frequency = np.arange(MIN_OSCILLATION, MAX_OSCILLATION, step)
    # The power spectrum of any set of folds follows from the Fourier sums of each.
    sums = {
        f: _fourier(frequency, t[fold == f], gap[fold == f]) for f in np.unique(fold)
    }

    for left_out in sums:
        own = fold == left_out
        recording = segment[own][0]
        rest = (segment == recording) & ~own

        # A phase is known within a recording alone.
        if not rest.any():
            continue
        power = _power_without(left_out, sums, segment, fold)
        strongest = frequency[int(np.argmax(power))]

        waves = _waves(strongest, t[rest])
        amplitude, *_ = np.linalg.lstsq(waves, gap[rest], rcond=None)
        out[own] = _waves(strongest, t[own]) @ amplitude
    return out


def _power_without(
    left_out: int, sums: dict[int, np.ndarray], segment: np.ndarray, fold: np.ndarray
) -> np.ndarray:
    """Power per frequency over all folds but one, (K,); phases count within a recording, not between recordings."""
    power = np.zeros(len(sums[left_out]))
    for s in np.unique(segment):
        kept = (segment == s) & (fold != left_out)
        parts = [sums[f] for f in np.unique(fold[kept])]

        if parts:
            power += np.abs(np.sum(parts, axis=0)) ** 2 / kept.sum()
    return power


def amplitudes(
    t: np.ndarray, gap: np.ndarray, segment: np.ndarray, frequency: np.ndarray
) -> np.ndarray:
    """Amplitude of a gap at some frequencies [N m], root mean square over the recordings, (K,)."""
    power = np.zeros(len(frequency))
    for s in np.unique(segment):
        rows = segment == s
        count = rows.sum()

        fourier = _fourier(frequency, t[rows], gap[rows])
        amplitude = np.abs(2.0 / count * fourier)
        power += count * amplitude**2
    return np.sqrt(power / len(gap))


def _fourier(frequency: np.ndarray, t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Sum of series(t) exp(-2 pi i f t), (K,); to single precision."""
    # Whole turns are taken off before the precision is.
    turns = np.outer(frequency, t) % 1.0
    angle = (2.0 * np.pi * turns).astype(np.float32)
    values = series.astype(np.float32)

    real = np.cos(angle) @ values
    imaginary = np.sin(angle) @ values
    return np.asarray(real - 1j * imaginary)


def _waves(frequency: float, t: np.ndarray) -> np.ndarray:
    """Sine and cosine, (M, 2)."""
    angle = 2.0 * np.pi * frequency * t
    return np.column_stack([np.sin(angle), np.cos(angle)])


# Share of the residual that a flexible model predicts on held-out data.
#
# Noise cannot be predicted; what can be, is a cause that the catalogue lacks. The model is a ridge regression on random
# Fourier features, a kernel method whose fit to any set of folds follows from sums of normal equations, so that leaving
# folds out costs little; beside it an oscillation at one frequency that does not follow the motion.


OSCILLATION = "frequency"
"""Name of the oscillation among the variables."""


@dataclass(frozen=True)
class Predictable:
    """What can be predicted of one joint's gap that the effects leave.

    Attributes:
        joint: from 1.
        share: of the squared gap above the floor, predicted on held-out data from all variables together [1]; 0 if
            the gap is not above the floor.
        by: the same from one variable alone, by its name; ``frequency`` is an oscillation that follows no motion.
        whiteness_p: how often white noise, filtered as the gap is, would look less white (Ljung and Box) [1].
        curve: the gap as a function of the variable that predicts most; over ``frequency`` its amplitude.
    """

    joint: int
    share: float
    by: dict[str, float]
    whiteness_p: float
    curve: Curve

    def document(self) -> dict[str, object]:
        """The entry in ``diagnosis.json``."""
        curve = self.curve
        return {
            "joint": self.joint,
            "share": self.share,
            "by": self.by,
            "whiteness_p": self.whiteness_p,
            "curve": {
                "variable": curve.variable,
                "unit": curve.unit,
                "x": curve.x.tolist(),
                "y": curve.y.tolist(),
            },
        }


def predictable(
    after: TorqueGap, rows: MotionRows, floor: np.ndarray, joints: list[int]
) -> list[Predictable]:
    """Share of a gap that a flexible model predicts, for each joint asked for.

    Each half of a recording is predicted with the model fitted to its other half and to all other recordings.

    Args:
        after: gap of the corrected arm on held-out data, M samples of n joints.
        rows: motion of the same samples.
        floor: RMS that a healthy arm leaves [N m], (n,).
        joints: from 1.
    """
    if not joints:
        return []

    # What all joints share is computed once.
    thinned = _thinned(rows)
    posture = _posture_features(rows.q[thinned.kept])
    p_values = _whiteness(after, rows)

    out = []
    for joint in joints:
        residual = _residual(joint, after, rows, floor, thinned)
        p_value = float(p_values[joint - 1])
        out.append(_of_joint(residual, posture, p_value))
    return out


@dataclass(frozen=True)
class _Thinned:
    """Rows that are kept, (K,), their recording, and the halves of recordings that are left out together."""

    kept: np.ndarray
    segment: np.ndarray
    folds: Folds


@dataclass(frozen=True)
class _Residual:
    """The gap of one joint on the rows kept.

    Attributes:
        joint: from 1.
        gap: [N m], (K,).
        above_floor: mean square of the gap above the floor [N^2 m^2]; 0 if it does not clearly exceed it.
        variables: of the joint, by which the gap may be predicted.
        t: time since the start of the recording [s], (K,).
        rows: the rows kept.
    """

    joint: int
    gap: np.ndarray
    above_floor: float
    variables: list[Variable]
    t: np.ndarray
    rows: _Thinned

    def share(self, predicted: np.ndarray) -> float:
        """Share of the squared gap above the floor that a prediction, (K,), takes away [1]."""
        before = np.mean(self.gap**2)
        remaining = np.mean((self.gap - predicted) ** 2)
        taken = float(before - remaining)
        return float(np.clip(taken / self.above_floor, 0.0, 1.0))


def _residual(
    joint: int, after: TorqueGap, rows: MotionRows, floor: np.ndarray, thinned: _Thinned
) -> _Residual:
    j, kept = joint - 1, thinned.kept
    gap = after.error[kept, j]
    power = float(np.mean(gap**2))

    # A share of a residual that hardly exceeds the floor would be a share of almost nothing.
    clear = power > (PREDICTABLE_MIN_RATIO * floor[j]) ** 2
    above_floor = power - float(floor[j]) ** 2 if clear else 0.0
    known = variables(rows, kept, j, after.predicted[kept, j])
    return _Residual(joint, gap, above_floor, known, rows.t[kept], thinned)


def _of_joint(residual: _Residual, posture: np.ndarray, p_value: float) -> Predictable:
    """The predictable share of one joint; ``posture`` are features of the arm's posture, (K, F)."""
    gap, folds = residual.gap, residual.rows.folds
    names = [*(v.name for v in residual.variables), OSCILLATION]
    if residual.above_floor == 0.0:
        curve = curve_of(residual.variables[0], gap)
        return Predictable(
            residual.joint, 0.0, dict.fromkeys(names, 0.0), p_value, curve
        )

    # Each variable alone, as a curve of any form.
    by = {}
    for variable in residual.variables:
        alone = predict_held_out(variable.hats(), gap, folds)
        by[variable.name] = residual.share(alone)

    wave = predict_oscillation(residual.t, gap, residual.rows.segment, folds.fold)
    by[OSCILLATION] = residual.share(wave)
    if by[OSCILLATION] == 0.0:
        wave = np.zeros_like(gap)

    # The oscillation is taken out first: features of the motion cannot predict it.
    rng = np.random.default_rng(residual.joint)
    own = _signal_features(residual.variables, rng)
    features = np.column_stack([own, posture])
    together = wave + predict_held_out(features, gap - wave, folds)

    best = max(by, key=lambda name: by[name])
    # One variable alone may predict more than all together, as a model of many features has more to learn.
    share = max(residual.share(together), by[best])
    return Predictable(residual.joint, share, by, p_value, _curve(residual, best))


def _curve(residual: _Residual, name: str) -> Curve:
    """The gap as a function of a variable, or its amplitude over frequency."""
    if name == OSCILLATION:
        frequency = np.arange(MIN_OSCILLATION, MAX_OSCILLATION, 0.05)
        amplitude = amplitudes(
            residual.t, residual.gap, residual.rows.segment, frequency
        )
        return Curve(OSCILLATION, "Hz", frequency, amplitude)
    variable = next(v for v in residual.variables if v.name == name)
    return curve_of(variable, residual.gap)


def _thinned(rows: MotionRows) -> _Thinned:
    """Rows at about the rate of what a filtered gap holds, in halves of recordings."""
    kept, folds, fitted = [], [], []
    for segment, rate in enumerate(rows.rates):
        step = max(1, int(rate / (ROWS_PER_CUTOFF * TORQUE_CUTOFF)))
        own = np.flatnonzero(rows.segment == segment)[::step]

        second_half = np.arange(len(own)) >= len(own) / 2
        t = rows.t[own]
        border = t[int(np.argmax(second_half))]

        kept.append(own)
        folds.append(2 * segment + second_half)
        # Rows beside the border are nearly those on its other side: fitting them would leak what is held out.
        fitted.append(np.abs(t - border) > FOLD_GUARD)

    places = np.concatenate(kept)
    halves = Folds(np.concatenate(folds), np.concatenate(fitted))
    return _Thinned(places, rows.segment[places], halves)


def _signal_features(known: list[Variable], rng: np.random.Generator) -> np.ndarray:
    """A 1, a joint's signals, and random Fourier features of them; (K, 1 + signals + features)."""
    columns = [column for variable in known for column in variable.smooth()]
    signals = np.column_stack(columns)

    deviation = np.maximum(signals.std(axis=0), 1e-9)
    normalised = (signals - signals.mean(axis=0)) / deviation

    waves = _fourier_features(normalised, FOURIER_FEATURES, rng)
    return np.column_stack([np.ones(len(signals)), normalised, waves])


def _posture_features(q: np.ndarray) -> np.ndarray:
    """Random Fourier features of the arm's posture, (K, FOURIER_FEATURES), of positions [rad], (K, n)."""
    angles = np.hstack([np.sin(q), np.cos(q)])

    # A joint that hardly moves gives no information: its deviation counts as 0.05 at least.
    deviation = np.maximum(angles.std(axis=0), 0.05)
    normalised = (angles - angles.mean(axis=0)) / deviation
    rng = np.random.default_rng(0)
    return _fourier_features(normalised, FOURIER_FEATURES // 2, rng)


def _fourier_features(
    x: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Random Fourier features, sqrt 2 cos(x W + b) with W normal over a length and b uniform. Source: rahimi2007."""
    dimensions = x.shape[1]
    # Two normalised samples lie sqrt(2 d) apart on average.
    distance = np.sqrt(2.0 * dimensions)
    lengths = np.repeat(KERNEL_LENGTHS, count) * distance

    weights = rng.standard_normal((dimensions, len(lengths))) / lengths
    phases = rng.uniform(0.0, 2.0 * np.pi, len(lengths))
    waves = np.cos(x @ weights + phases)
    return np.asarray(np.sqrt(2.0) * waves)


def _whiteness(after: TorqueGap, rows: MotionRows) -> np.ndarray:
    """Ljung and Box's p-value of the gap of each joint, sampled at its cut-off, (n,)."""
    rate = float(np.median(rows.rates))
    # The filter correlates neighbours: rows are thinned to its cut-off, and the rest of the correlation is known.
    cutoff = min(TORQUE_CUTOFF, 0.95 * rate / 2)
    step = max(1, round(rate / cutoff))
    expected = band_correlation(rate, cutoff, step)

    test = whiteness(after.error[::step], rows.segment[::step], expected)
    return test.p_value
