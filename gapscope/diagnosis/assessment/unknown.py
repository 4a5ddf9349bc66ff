"""What is unknown: what of a gap comes again with the motion, or with time, though nothing that is named explains it.

Noise is what a flexible model leaves of data that it has not seen; what it predicts there has a cause. The model is a
ridge regression on random Fourier features, a kernel method whose fit to any set of folds follows from sums of normal
equations, so that leaving folds out costs little; beside it an oscillation at one frequency that follows no motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.io.json_file import plain
from gapscope.arm.nominal import smooth_sign
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.locate import MotionRows
from gapscope.diagnosis.thresholds import (
    FOLD_GUARD,
    FOURIER_FEATURES,
    HEALTHY_REAL,
    MAX_OSCILLATION,
    MIN_OSCILLATION,
    OSCILLATION_GRID,
    RIDGE_STRENGTHS,
    STANDS_OUT,
    UNKNOWN_TORQUE,
)
from gapscope.effects.actuation import MIN_DELAY
from gapscope.effects.residual import Memory
from gapscope.ident.intervals import whiteness
from gapscope.model.conditioning import MIN_FLOOR, TORQUE_CUTOFF
from gapscope.model.design import drawn_waves
from gapscope.model.difference import ANY
from gapscope.model.effective_samples import variance_inflation
from gapscope.model.torque_gap import TorqueGap

# Curves of a gap over one variable.

KNOTS = 16
"""Knots of a curve, at equal shares of the samples and of the range in turn."""

SMOOTH = 0.02
"""Weight of a curve's second differences, over the number of samples per knot."""


@dataclass(frozen=True)
class Curve:
    """The gap over one variable: x in ``unit``, y [N m], each (K,)."""

    variable: str
    unit: str
    x: np.ndarray
    y: np.ndarray


@dataclass(frozen=True)
class Variable:
    """One variable of a joint at every row.

    Attributes:
        name: ``position``, ``velocity``, ``speed``, ``direction``, ``acceleration``, ``load`` or ``time``.
        unit: its unit.
        values: shape (M,).
    """

    name: str
    unit: str
    values: np.ndarray

    @property
    def knots(self) -> np.ndarray:
        """Knots of a curve over the variable, ascending, (K,)."""
        # A direction is -1 or 1, hardly ever between.
        if self.name == "direction":
            return np.array([-1.0, 0.0, 1.0])
        low, high = float(self.values.min()), float(self.values.max())
        if low == high:
            return np.array([low - 1.0, low + 1.0])

        quantiles = np.quantile(self.values, np.linspace(0.0, 1.0, KNOTS))
        even = np.linspace(low, high, KNOTS)
        # Even in samples alone, knots would be rare at the ends; even in range alone, some would hold no sample.
        return np.asarray(0.5 * (quantiles + even))

    def hats(self) -> np.ndarray:
        """Hat functions over the knots: a curve through values at the knots is linear in them; (M, K)."""
        knots = self.knots
        each = [
            np.interp(self.values, knots, heights) for heights in np.eye(len(knots))
        ]
        return np.column_stack(each)


def variables(rows: MotionRows, j: int, load: np.ndarray) -> list[Variable]:
    """The variables of joint j (from 0), (M,).

    ``speed`` is dq without its sign, ``velocity`` with it, ``load`` the torque that the corrected arm predicts,
    ``time`` counts from the start of each recording.
    """
    v = rows.dq[:, j]
    return [
        Variable("position", "rad", rows.q[:, j]),
        Variable("speed", "rad/s", np.abs(v)),
        Variable("velocity", "rad/s", v),
        Variable("direction", "1", smooth_sign(v)),
        Variable("acceleration", "rad/s^2", rows.ddq[:, j]),
        Variable("load", "N m", load),
        Variable("time", "s", rows.clock),
    ]


def curve_of(variable: Variable, gap: np.ndarray, weight: np.ndarray) -> Curve:
    """The smooth curve nearest to a gap [N m], (M,): least squares on hats with second differences held small.

    Args:
        variable: of the curve.
        gap: times the weight of its row [N m], (M,).
        weight: of the rows [1], (M,).
    """
    hats, knots = variable.hats() * weight[:, None], variable.knots

    identity = np.eye(len(knots))
    bends = np.diff(identity, 2, axis=0)
    stiffness = SMOOTH * len(gap) / len(knots)

    # The last term decides at knots without samples.
    least = 1e-9 * len(gap) * identity
    gram = hats.T @ hats + stiffness * bends.T @ bends + least

    heights = np.linalg.solve(gram, hats.T @ gap)
    return Curve(variable.name, variable.unit, knots, heights)


# Prediction of held-out halves of recordings: a ridge regression, and an oscillation that does not follow the motion.


class Halves(NamedTuple):
    """Rows, M in all, in halves of recordings.

    Attributes:
        t: time since the start of their recording [s], (M,).
        segment: their recording, (M,).
        fold: their half, which is left out together, (M,).
        fitted: those that may be fitted, (M,); all are predicted.
    """

    t: np.ndarray
    segment: np.ndarray
    fold: np.ndarray
    fitted: np.ndarray


def halves_of(rows: MotionRows) -> Halves:
    """The halves of recordings."""
    folds, fitted = [], []
    for segment in range(len(rows.rates)):
        t = rows.t[rows.segment == segment]
        second_half = np.arange(len(t)) >= len(t) / 2
        border = t[int(np.argmax(second_half))]
        folds.append(2 * segment + second_half)
        # Rows beside the border are nearly those on its other side: fitting them would leak what is held out.
        fitted.append(np.abs(t - border) > FOLD_GUARD)
    return Halves(rows.t, rows.segment, np.concatenate(folds), np.concatenate(fitted))


def predict_held_out(x: np.ndarray, y: np.ndarray, rows: Halves) -> np.ndarray:
    """Prediction of y, (M,), each half with a ridge regression on columns x, (M, p), of the other halves.

    The strength for a half is the one that predicts the other halves best, those being left out in turn. If even the
    best is worse than predicting 0 there, the prediction is 0.
    """
    halves = [rows.fold == fold for fold in np.unique(rows.fold)]
    # normal equations of each half: those of all others are sums less its own
    used = [half & rows.fitted for half in halves]
    grams = [x[own].T @ x[own] for own in used]
    rights = [x[own].T @ y[own] for own in used]
    gram, right = np.sum(grams, axis=0), np.sum(rights, axis=0)
    ridges = np.array(RIDGE_STRENGTHS) * np.trace(gram) / len(gram)
    by_strength = np.zeros((len(ridges), len(y)))
    for half, own_gram, own_right in zip(halves, grams, rights, strict=True):
        # one decomposition serves all strengths: a ridge adds to every eigenvalue
        value, vector = np.linalg.eigh(gram - own_gram)
        rotated = vector.T @ (right - own_right)
        ridged = np.maximum(value[:, None] + ridges, SMALLEST)
        coefficients = vector @ (rotated[:, None] / ridged)
        by_strength[:, half] = (x[half] @ coefficients).T
    # squared errors per strength and half, and those of predicting 0
    squares = (y - by_strength) ** 2
    errors = np.column_stack([squares[:, half].sum(axis=1) for half in halves])
    powers = np.array([(y[half] ** 2).sum() for half in halves])
    out = np.zeros(len(y))
    for k, half in enumerate(halves):
        # a half has no say in its own strength: it is chosen by how the others are predicted
        on_others = errors.sum(axis=1) - errors[:, k]
        best = int(np.argmin(on_others))
        if on_others[best] < powers.sum() - powers[k]:
            out[half] = by_strength[best, half]
    return out


def predict_oscillation(
    gap: np.ndarray, weight: np.ndarray, rows: Halves
) -> np.ndarray:
    """Prediction of weighted gaps [N m], (M, n), as a sin(2 pi f t) + b cos(2 pi f t), a and b per recording.

    Each half of a joint is predicted with f from all others, and a and b from the rest of its own recording; 0 if a
    recording has no rest.

    Args:
        gap: of n joints, times the weight of its row [N m], (M, n).
        weight: [1], (M, n).
        rows: the rows.
    """
    t, segment, fold = rows.t, rows.segment, rows.fold
    recordings = np.unique(segment)
    longest = max(float(np.ptp(t[segment == s])) for s in recordings)
    out = np.zeros_like(gap)
    if longest <= 0:
        return out
    step = 1.0 / (OSCILLATION_GRID * longest)
    frequency = np.arange(MIN_OSCILLATION, MAX_OSCILLATION, step)
    # the power spectrum of any set of halves follows from the Fourier sums of each
    sums = {
        f: fourier(frequency, t[fold == f], gap[fold == f]) for f in np.unique(fold)
    }
    for left_out in sums:
        own = fold == left_out
        rest = (segment == segment[own][0]) & ~own
        # a phase is known within a recording alone
        if not rest.any():
            continue
        power = np.zeros(sums[left_out].shape)
        for s in recordings:
            kept = (segment == s) & ~own
            parts = [sums[f] for f in np.unique(fold[kept])]
            if parts:
                power += np.abs(np.sum(parts, axis=0)) ** 2 / kept.sum()
        for j, f in enumerate(frequency[np.argmax(power, axis=0)]):
            angle = 2.0 * np.pi * f * t
            waves = np.column_stack([np.sin(angle), np.cos(angle)]) * weight[:, j, None]
            amplitude, *_ = np.linalg.lstsq(waves[rest], gap[rest, j], rcond=None)
            out[own, j] = waves[own] @ amplitude
    return out


def fourier(frequency: np.ndarray, t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Sum of series(t), (M, ...), times exp(-2 pi i f t), (K, ...); to single precision."""
    # whole turns are taken off before the precision is
    turns = np.outer(frequency, t) % 1.0
    angle = (2.0 * np.pi * turns).astype(np.float32)
    values = series.astype(np.float32)
    return np.asarray(np.cos(angle) @ values - 1j * (np.sin(angle) @ values))


# What follows the motion of what is left.


OSCILLATION = "frequency"
"""Name of the oscillation among the variables."""


@dataclass(frozen=True)
class Predictable:
    """What can be predicted of one joint's gap that the effects leave.

    Attributes:
        joint: from 1.
        share: of the squared gap, predicted on held-out data from all variables together [1].
        by: the same from one variable alone, by its name; ``frequency`` is an oscillation that follows no motion.
        whiteness_p: how often white noise, filtered as the gap is, would look less white (Ljung and Box) [1].
        curve: the gap as a function of the variable that predicts most; over ``frequency`` its amplitude.
        evidence: log evidence of what predicts it over none [nats].
    """

    joint: int
    share: float
    by: dict[str, float]
    whiteness_p: float
    curve: Curve
    evidence: float

    @property
    def oscillates(self) -> bool:
        """Whether an oscillation that follows no motion predicts more than any variable of the motion."""
        return self.curve.variable == OSCILLATION

    def document(self) -> dict[str, object]:
        """The entry in ``diagnosis.json``."""
        entry: dict[str, object] = plain(self)
        return {key: entry[key] for key in entry if key != "evidence"}


@dataclass(frozen=True)
class Unknown:
    """What follows the motion of a gap that is left, n joints.

    Attributes:
        left: mean square of the gap by trust [N^2 m^2], (n,).
        predictable: of each joint.
        scale: normalisation of the torque gap [N m], (n,).
        white2: variance of the noise of a row, over its square [1], (n,).
    """

    left: np.ndarray
    predictable: list[Predictable]
    scale: np.ndarray
    white2: np.ndarray

    @cached_property
    def follows2(self) -> np.ndarray:
        """Mean square of what follows a joint's motion [N^2 m^2], (n,).

        0 if that is less likely than not, or of no size that is worth a search.
        """
        share2 = np.array([p.share for p in self.predictable]) * self.left
        evidence = np.array([p.evidence for p in self.predictable])
        # on any of the joints, as an effect of some name would be
        likely = evidence > np.log(len(self.scale) / ANY)
        seen = share2 > (UNKNOWN_TORQUE * self.scale) ** 2
        return np.where(likely & seen, share2, 0.0)

    @cached_property
    def torque2(self) -> np.ndarray:
        """Mean square of the torque that has an unknown cause [N^2 m^2], (n,); 0 on joints without one.

        Models of real arms have errors of form everywhere: what follows the motion of a joint has a cause if it stands
        out from what the other joints leave, or is an oscillation that follows no motion. What is no noise has one as
        well if it stands out farther than the worst of healthy arms from the best, though nothing predicts it. Beside
        that, an arm has one if more is left than any complete model of a healthy arm leaves.
        """
        left2 = self.left / self.scale**2
        oscillates = np.array([p.oscillates for p in self.predictable])
        others2 = _others2(left2)
        above2 = STANDS_OUT**2 * others2 * self.scale**2
        stands_out = (self.follows2 > above2) | oscillates
        least2, most2 = np.square(HEALTHY_REAL)
        lasting2 = np.maximum(left2 - self.white2, 0.0)
        lasts = (lasting2 > most2 / least2 * others2) & (lasting2 > UNKNOWN_TORQUE**2)
        # on average over the joints: a single one may have a cause of its own
        beyond2 = np.maximum(left2 - most2, 0.0) * (left2.mean() > most2)
        unpredicted2 = np.maximum(lasting2 * lasts, beyond2) * self.scale**2
        return np.maximum(self.follows2 * stands_out, unpredicted2)

    @property
    def share(self) -> np.ndarray:
        """The same over what is left [1], (n,)."""
        return np.asarray(self.torque2 / np.maximum(self.left, MIN_FLOOR**2))

    @property
    def joints(self) -> list[int]:
        """Joints on which there is an unknown cause, from 1."""
        return [int(j) + 1 for j in np.flatnonzero(self.torque2)]


def _others2(left2: np.ndarray) -> np.ndarray:
    """Geometric mean of the squares that all other joints leave [1], (n,); of one joint alone, of a usual real arm."""
    # a joint of which nothing is left has no logarithm
    known = left2 > MIN_FLOOR**2
    log2 = np.log(np.where(known, left2, 1.0))
    count = known.sum() - known
    others = (log2.sum() - log2) / np.maximum(count, 1)
    # of one joint: the geometric mean of both ends of what is usual, squared
    return np.exp(np.where(count > 0, others, np.log(np.prod(HEALTHY_REAL))))


def unknown(
    gap: TorqueGap,
    rows: MotionRows,
    trust: np.ndarray,
    scale: np.ndarray,
    white2: np.ndarray,
) -> Unknown:
    """What a flexible model predicts of a gap, for each joint.

    Each half of a recording is predicted with the model fitted to its other half and to all other recordings.

    Args:
        gap: of the corrected arm on held-out data, M samples of n joints.
        rows: motion of the same samples.
        trust: how far friction is known on each of them [1], (M, n): a joint that may stick hides what is there.
        scale: normalisation of the torque gap [N m], (n,).
        white2: variance of the noise of a row, over its square [1], (n,).
    """
    halves = halves_of(rows)
    load = gap.predicted
    angles = np.hstack([np.sin(rows.q), np.cos(rows.q)])
    # a joint that hardly moves gives no information: its deviation counts as 0.05 at least
    spread = np.maximum(angles.std(axis=0), 0.05)
    posture = (angles - angles.mean(axis=0)) / spread
    # velocities and loads of all joints act on others by couplings; what all joints share is computed once
    of_arm = np.hstack(
        [
            _normalised(np.hstack([rows.dq, load])),
            _unit_waves(posture, FOURIER_FEATURES),
        ]
    )
    memory = _memory(rows, load)
    # of the gap sampled at its cut-off
    rates = np.asarray(rows.rates)[rows.segment]
    p_values = whiteness(gap.error, rows.segment, rates, TORQUE_CUTOFF).p_value
    # a joint of which no row is known has weights of 0
    known2 = np.maximum((trust**2).mean(axis=0), SMALLEST)
    weight = trust / np.sqrt(known2)
    left = (gap.error - _skewed(gap, rows, trust / scale)) * weight
    waves = predict_oscillation(left, weight, halves)
    every = []
    for j, p_value in enumerate(p_values.tolist()):
        known = variables(rows, j, load[:, j])
        # any hysteresis is a sum of stop operators: waves of them have more to learn, and predict no more
        columns = []
        for variable in known:
            if variable.name == "position":
                # angles repeat after a turn
                columns += [np.sin(variable.values), np.cos(variable.values)]
            elif variable.name != "speed":
                # a speed is no smooth function of the velocity, and follows from it
                columns.append(variable.values)
        signals = _normalised(np.column_stack(columns))
        features = np.column_stack(
            [
                np.ones(len(load)),
                signals,
                _normalised(memory[:, j]),
                _unit_waves(signals, 2 * FOURIER_FEATURES),
                of_arm,
            ]
        )
        residual = _Residual(left[:, j], weight[:, j], halves)
        found = _of_joint(residual, j + 1, known, waves[:, j], features, p_value)
        every.append(found)
    return Unknown((left**2).mean(axis=0), every, scale, white2)


def _skewed(gap: TorqueGap, rows: MotionRows, weight: np.ndarray) -> np.ndarray:
    """What a skew d between torque and motion that is common to all joints, and no delay yet, leaves [N m], (M, n).

    tau(t - d) - tau = -d dtau/dt, d by weighted least squares, of no more than the shortest delay either way.
    """
    rate = np.zeros_like(gap.predicted)
    for segment in range(len(rows.rates)):
        own = np.flatnonzero(rows.segment == segment)
        # of few rows no rate is known
        if len(own) > 3:
            torque = make_interp_spline(rows.t[own], gap.predicted[own], k=3)
            rate[own] = torque(rows.t[own], 1)
    moved, seen = rate * weight, gap.error * weight
    slope = float((moved * seen).sum() / max((moved**2).sum(), SMALLEST))
    return float(np.clip(slope, -MIN_DELAY, MIN_DELAY)) * rate


class _Residual(NamedTuple):
    """The gap of one joint, weighted [N m], and the weights of its rows [1], (M,) each."""

    gap: np.ndarray
    weight: np.ndarray
    rows: Halves

    def predicted(self, columns: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Prediction of a weighted gap from columns, (M, p), on rows that are held out, (M,)."""
        return predict_held_out(columns * self.weight[:, None], gap, self.rows)

    def share(self, predicted: np.ndarray) -> float:
        """Share of the squared gap that a prediction, (M,), takes away [1]."""
        before = np.mean(self.gap**2)
        remaining = np.mean((self.gap - predicted) ** 2)
        return float(np.clip(1.0 - remaining / max(before, SMALLEST), 0.0, 1.0))


def _of_joint(
    residual: _Residual,
    joint: int,
    known: list[Variable],
    wave: np.ndarray,
    features: np.ndarray,
    p_value: float,
) -> Predictable:
    """The predictable share of one joint.

    Args:
        residual: its gap.
        joint: it, from 1.
        known: variables of the joint, by which the gap may be predicted.
        wave: what an oscillation predicts of it [N m], (M,).
        features: of the joint and of the arm, (M, F).
        p_value: of its whiteness.
    """
    gap, segment = residual.gap, residual.rows.segment
    # each variable alone, as a curve of any form
    predicted = {one.name: residual.predicted(one.hats(), gap) for one in known}
    predicted[OSCILLATION] = wave
    by = {name: residual.share(some) for name, some in predicted.items()}
    if by[OSCILLATION] == 0.0:
        wave = np.zeros_like(gap)
    # the oscillation is taken out first: features of the motion cannot predict it
    together = wave + residual.predicted(features, gap - wave)
    best = max(by, key=lambda name: by[name])
    share = residual.share(together)
    # one variable alone may predict more than all together, as a model of many features has more to learn
    if by[best] > share:
        share, together = by[best], predicted[best]
    # a prediction that leaves the share 1 - s of the squares has the log likelihood -m/2 ln(1 - s) over none
    inflation = variance_inflation((gap - together)[:, None], segment)[0]
    evidence = -len(gap) / inflation / 2 * np.log(max(1.0 - share, np.finfo(float).eps))
    # it is the best of so many
    evidence -= np.log(len(by) + 1)
    if best == OSCILLATION:
        curve = _amplitudes(residual)
    else:
        chosen = next(one for one in known if one.name == best)
        curve = curve_of(chosen, gap, residual.weight)
    return Predictable(joint, share, by, p_value, curve, float(evidence))


def _amplitudes(residual: _Residual) -> Curve:
    """Amplitude of a gap over frequency [N m], root mean square over the recordings."""
    frequency = np.arange(MIN_OSCILLATION, MAX_OSCILLATION, 0.05)
    power = np.zeros(len(frequency))
    t, segment = residual.rows.t, residual.rows.segment
    for s in np.unique(segment):
        rows = segment == s
        count = rows.sum()
        amplitude = 2.0 / count * fourier(frequency, t[rows], residual.gap[rows])
        power += count * np.abs(amplitude) ** 2
    return Curve(OSCILLATION, "Hz", frequency, np.sqrt(power / len(t)))


def _memory(rows: MotionRows, load: np.ndarray) -> np.ndarray:
    """What joints remember of their motion and of their load (M, n) [N m], (M, n, states)."""
    out = []
    for segment in range(len(rows.rates)):
        own = np.flatnonzero(rows.segment == segment)
        memory = Memory(rows.q[own[0]])
        steps = np.diff(rows.t[own], prepend=rows.t[own[0]]).tolist()
        # memory is a state: rows one after the other, from the start of each recording
        for row, step in zip(own.tolist(), steps, strict=True):
            out.append(memory.advance(rows.q[row], load[row], step))
    return np.array(out)


def _normalised(signals: np.ndarray) -> np.ndarray:
    """Signals about 0 with a deviation of 1, (M, S)."""
    deviation = np.maximum(signals.std(axis=0), MIN_FLOOR)
    return np.asarray((signals - signals.mean(axis=0)) / deviation)


def _unit_waves(state: np.ndarray, count: int) -> np.ndarray:
    """Waves of a state, (M, d), as large as signals that are normalised, (M, count)."""
    return np.sqrt(count) * drawn_waves(state, count)
