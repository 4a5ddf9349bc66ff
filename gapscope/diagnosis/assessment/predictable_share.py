"""What a flexible model still predicts of the gap that the effects leave, on data that it has not seen.

Noise cannot be predicted; what can be, is a cause that the catalogue lacks. The model is a ridge regression on random
Fourier features, a kernel method whose fit to any set of folds follows from sums of normal equations, so that leaving
folds out costs next to nothing and nothing beyond numpy is needed; beside it an oscillation that follows no motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.assessment.curves import Curve, Variable, curve_of, variables
from gapscope.diagnosis.assessment.oscillation import amplitudes, predict_oscillation
from gapscope.diagnosis.assessment.ridge_folds import Folds, predict_unseen
from gapscope.diagnosis.gap.torque_gap import TorqueGap
from gapscope.diagnosis.localisation.stacked_rows import Rows
from gapscope.diagnosis.thresholds import (
    FOLD_GUARD,
    FOURIER_FEATURES,
    KERNEL_LENGTHS,
    LEAST_OSCILLATION,
    MOST_OSCILLATION,
    PREDICTABLE_LEAST_RATIO,
    ROWS_PER_CUTOFF,
)
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF
from gapscope.ident.uncertainty.validation import band_correlation, whiteness

OSCILLATION = "frequency"
"""Name of the oscillation among the variables."""


@dataclass(frozen=True)
class Predictable:
    """What can be predicted of one joint's gap that the effects leave.

    Attributes:
        joint: from 1.
        share: of the squared gap above the floor, predicted on unseen data from everything together [1]; 0 where the
            gap is not above the floor.
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
    after: TorqueGap, rows: Rows, floor: np.ndarray, joints: list[int]
) -> list[Predictable]:
    """What a flexible model predicts of a gap, for each joint asked for.

    Each half of a recording is predicted with the model fitted to its other half and to all other recordings.

    Args:
        after: gap of the corrected arm on unseen data, M samples of n joints.
        rows: motion of the same samples.
        floor: RMS that a healthy arm leaves [N m], (n,).
        joints: from 1.
    """
    if not joints:
        return []
    kept, folds = _thinned(rows)
    posture = _posture(rows.q[kept])
    p_value = _whiteness(after, rows)
    return [
        _of_joint(joint, after, rows, floor, kept, folds, posture, p_value)
        for joint in joints
    ]


def _of_joint(
    joint: int,
    after: TorqueGap,
    rows: Rows,
    floor: np.ndarray,
    kept: np.ndarray,
    folds: Folds,
    posture: np.ndarray,
    p_value: np.ndarray,
) -> Predictable:
    """What can be predicted of one joint; ``posture`` are features of the arm's, (K, F), ``kept`` the rows, (K,)."""
    j, t, segment = joint - 1, rows.t[kept], rows.segment[kept]
    gap = after.error[kept, j]
    power = float(np.mean(gap**2))
    above = (
        power - float(floor[j]) ** 2
        if power > (PREDICTABLE_LEAST_RATIO * floor[j]) ** 2
        else 0.0
    )
    seen = variables(rows, kept, j, after.predicted[kept, j])
    if above == 0.0:
        nothing = {**{v.name: 0.0 for v in seen}, OSCILLATION: 0.0}
        return Predictable(
            joint, 0.0, nothing, float(p_value[j]), curve_of(seen[0], gap)
        )
    by = {
        v.name: _share(gap, predict_unseen(v.hats(), gap, folds), above) for v in seen
    }
    line = predict_oscillation(t, gap, segment, folds.fold)
    by[OSCILLATION] = _share(gap, line, above)
    line = line if by[OSCILLATION] > 0.0 else np.zeros_like(gap)
    features = np.column_stack([_features(seen, np.random.default_rng(joint)), posture])
    share = _share(gap, line + predict_unseen(features, gap - line, folds), above)
    told = max(by, key=lambda name: by[name])
    if told == OSCILLATION:
        frequency = np.arange(LEAST_OSCILLATION, MOST_OSCILLATION, 0.05)
        curve = Curve(
            OSCILLATION, "Hz", frequency, amplitudes(t, gap, segment, frequency)
        )
    else:
        curve = curve_of(next(v for v in seen if v.name == told), gap)
    # one variable alone may do better than all together, which have more to learn
    return Predictable(joint, max(share, by[told]), by, float(p_value[j]), curve)


def _thinned(rows: Rows) -> tuple[np.ndarray, Folds]:
    """Rows that are kept, (K,), and the halves of recordings that they lie in."""
    kept, folds, fitted = [], [], []
    for segment, rate in enumerate(rows.rates):
        own = np.flatnonzero(rows.segment == segment)[
            :: max(1, int(rate / (ROWS_PER_CUTOFF * TORQUE_CUTOFF)))
        ]
        half = np.arange(len(own)) >= len(own) / 2
        t = rows.t[own]
        kept.append(own)
        folds.append(2 * segment + half)
        fitted.append(np.abs(t - t[int(np.argmax(half))]) > FOLD_GUARD)
    return np.concatenate(kept), Folds(np.concatenate(folds), np.concatenate(fitted))


def _features(seen: list[Variable], rng: np.random.Generator) -> np.ndarray:
    """A 1, a joint's signals, and random Fourier features of them; (K, 1 + signals + features)."""
    x = np.column_stack([c for v in seen for c in v.smooth()])
    x = (x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-9)
    return np.column_stack([np.ones(len(x)), x, _waves(x, FOURIER_FEATURES, rng)])


def _posture(q: np.ndarray) -> np.ndarray:
    """Random Fourier features of the arm's posture, (K, FEATURES), of positions [rad], (K, n)."""
    x = np.hstack([np.sin(q), np.cos(q)])
    return _waves(
        (x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 0.05),
        FOURIER_FEATURES // 2,
        np.random.default_rng(0),
    )


def _waves(x: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random Fourier features, sqrt 2 cos(x W + b) with W normal over a length and b uniform. Source: rahimi2007."""
    lengths = np.repeat(KERNEL_LENGTHS, count) * np.sqrt(2.0 * x.shape[1])
    angle = x @ (rng.standard_normal((x.shape[1], len(lengths))) / lengths)
    return np.asarray(
        np.sqrt(2.0) * np.cos(angle + rng.uniform(0.0, 2.0 * np.pi, len(lengths)))
    )


def _share(gap: np.ndarray, predicted: np.ndarray, above: float) -> float:
    """Share of the squared gap above the floor that a prediction takes away [1]."""
    taken = float(np.mean(gap**2) - np.mean((gap - predicted) ** 2))
    return float(np.clip(taken / above, 0.0, 1.0)) if above > 0.0 else 0.0


def _whiteness(after: TorqueGap, rows: Rows) -> np.ndarray:
    """Ljung and Box's p-value of the gap of each joint, sampled at its cut-off, (n,)."""
    rate = float(np.median(rows.rates))
    cutoff = min(TORQUE_CUTOFF, 0.95 * rate / 2)
    step = max(1, round(rate / cutoff))
    return whiteness(
        after.error[::step], rows.segment[::step], band_correlation(rate, cutoff, step)
    ).p_value
