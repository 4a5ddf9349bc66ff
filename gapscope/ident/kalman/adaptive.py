"""A Kalman filter over base parameters and friction whose noise comes from the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.kalman.recursive import Recursive
from gapscope.ident.kalman.stretches import Stretches
from gapscope.ident.kalman.track import Track
from gapscope.ident.model.linear_problem import Problem
from gapscope.model.effective_samples import variance_inflation

WANDERS = "bcdso"
"""First letters of the parameters that may wander: friction and offsets warm up; masses and rotors stay."""
LEVELS = (0.0, 0.003, 0.01, 0.03, 0.1)
"""Process noise tried: share of its value by which a parameter wanders in one second [1/sqrt(s)]."""
WORTH = 0.02
"""Process noise has to lower the squared error of the torque predicted ahead by this share [1]."""
AHEAD = 1.0
"""Stretches are predicted from those that end this long before [s]: errors of the model last for less."""
SETTLED = 1 / 3
"""Share of the stretches after which predictions count in the choice of the process noise [1]."""


LEAST_NOISE = 1e-3
"""Least noise over the RMS of a joint's torque [1]: beside none a vague first covariance loses its digits."""


@dataclass(frozen=True)
class Opening:
    """A moment at which some parameters became unknown again, as when a load is picked up.

    Attributes:
        sample: the first sample after it.
        covariance: that is added to the estimate's, shape (b, b).
    """

    sample: int
    covariance: np.ndarray


@dataclass(frozen=True)
class Followed:
    """What the filter saw, K stretches of N samples of n joints.

    Attributes:
        problem: what it followed.
        stretches: how the samples were gathered.
        track: the estimate after each stretch.
        batch: weighted least squares of all samples, shape (b,).
        noise: RMS of the torque's noise [N m], shape (n,).
        inflation: f, how many samples count as one [1], shape (n,).
        level: process noise that was chosen, one of ``LEVELS``.
        innovation: each sample less its prediction from the stretches before its own, over the noise [1], (N, n).
    """

    problem: Problem
    stretches: Stretches
    track: Track
    batch: np.ndarray
    noise: np.ndarray
    inflation: np.ndarray
    level: float
    innovation: np.ndarray


def follow(problem: Problem, openings: Sequence[Opening] = ()) -> Followed:
    """Filter a problem, beta+ = beta + w, tau = W beta + v, stretch by stretch.

    The covariance of v is sigma_j^2 f_j per joint: sigma_j is the RMS residual of weighted least squares (of each part
    between openings, that of the filter's last estimate there) and f_j = 1 + 2 sum_k rho_k its variance inflation, so
    that errors of the model, which are smooth, count as few samples. By w friction and offsets wander by one of
    ``LEVELS`` times their values: the one with the least squared error of the torque predicted ``AHEAD`` seconds ahead,
    zero unless another gains ``WORTH``. Without wandering the last estimate is that of least squares with these
    weights.

    Args:
        problem: in the order of time.
        openings: in the order of time.

    Raises:
        InputError: the samples do not determine the parameters.

    Source: ljung1999.
    """
    batch = WeightedLeastSquares().estimate(problem)
    noise, inflation = _noise(problem, problem.residual(batch.value))
    stretches = Stretches.of(problem, noise * np.sqrt(inflation))
    if openings:
        # what changed is no noise: its size comes from the estimate of each part
        track = _filtered(stretches, openings, np.zeros_like(batch.value))
        residual = _residual_by_part(problem, stretches, track, openings)
        noise, inflation = _noise(problem, residual)
        stretches = Stretches.of(problem, noise * np.sqrt(inflation))
    best: tuple[float, float, Track] | None = None
    for level in LEVELS:
        track = _filtered(stretches, openings, level * np.abs(batch.value))
        error = _error_ahead(problem, stretches, track, noise)
        if best is None or error < (1 - WORTH) * best[0]:
            best = (error, level, track)
    assert best is not None
    _, level, track = best
    innovation = _predicted_ahead(problem, stretches, track, 1) / noise
    return Followed(
        problem=problem,
        stretches=stretches,
        track=track,
        batch=batch.value,
        noise=noise,
        inflation=inflation,
        level=level,
        innovation=innovation,
    )


def _noise(problem: Problem, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """RMS of a residual [N m], never zero, and how many of its samples count as one [1], (n,) each."""
    least = LEAST_NOISE * np.sqrt(np.mean(problem.torque**2, axis=0)) + 1e-9
    rms = np.sqrt(np.mean(residual**2, axis=0))
    return np.maximum(rms, least), variance_inflation(residual, problem.group)


def _residual_by_part(
    problem: Problem, stretches: Stretches, track: Track, openings: Sequence[Opening]
) -> np.ndarray:
    """What the last estimate of each part between openings leaves of its torque [N m], (N, n)."""
    stops = [own.stop for own in stretches.rows]
    edges = [0, *(opening.sample for opening in openings), len(problem.torque)]
    residual = np.empty_like(problem.torque)
    for start, stop in pairwise(edges):
        last = max(int(np.searchsorted(stops, stop, side="right")) - 1, 0)
        part = slice(start, stop)
        residual[part] = problem.rows(part).residual(track.value[last])
    return residual


def _filtered(
    stretches: Stretches, openings: Sequence[Opening], scale: np.ndarray
) -> Track:
    """The track under a process noise, with the covariance widened at each opening."""
    reduced = stretches.reduced
    names = tuple(reduced.names)
    drift = {
        name: float(size)
        for name, size in zip(names, scale, strict=True)
        if name[0] in WANDERS and size > 0
    }
    kalman = Recursive(np.ones(reduced.n_joints), drift=drift)
    stops = [own.stop for own in stretches.rows]
    cuts = [int(np.searchsorted(stops, opening.sample + 1)) for opening in openings]
    edges = [0, *cuts, len(stops)]
    tracks: list[Track] = []
    for k, (start, stop) in enumerate(pairwise(edges)):
        if k:
            added = openings[k - 1].covariance
            kalman = _widened(kalman, tracks, added)
        if stop > start:
            own = slice(start, stop)
            tracks.append(kalman.follow(reduced.rows(own), stretches.ends[own]))
    return _joined(tracks)


def _widened(kalman: Recursive, tracks: list[Track], added: np.ndarray) -> Recursive:
    """The filter that goes on from the last estimate, less sure by a covariance."""
    if not tracks:
        return kalman
    last = tracks[-1]
    return replace(kalman, start=last.value[-1], covariance=last.covariance[-1] + added)


def _joined(tracks: list[Track]) -> Track:
    """Tracks one after the other."""
    series = ("t", "value", "covariance", "innovation", "walk")
    joined = {
        name: np.concatenate([getattr(track, name) for track in tracks])
        for name in series
    }
    return Track(names=tracks[0].names, **joined)


def _predicted_ahead(
    problem: Problem, stretches: Stretches, track: Track, lag: int
) -> np.ndarray:
    """Torque less its prediction from the estimate ``lag`` stretches before [N m], (N, n); zero where there is none."""
    out = np.zeros_like(problem.torque)
    for k in range(lag, len(stretches.rows)):
        own = stretches.rows[k]
        predicted = problem.matrix[own] @ track.value[k - lag]
        out[own] = problem.torque[own] - predicted
    return out


def _error_ahead(
    problem: Problem, stretches: Stretches, track: Track, noise: np.ndarray
) -> float:
    """Squared error of the torque predicted ``AHEAD`` seconds ahead, over the noise [1].

    The mean within a stretch, of which the median over the stretches: those of a motion that is new are not predicted
    yet, whatever the process noise.
    """
    lag = 1 + round(AHEAD / stretches.length)
    first = max(lag, int(SETTLED * len(stretches.rows)))
    # a record shorter than that is judged one stretch ahead
    if first >= len(stretches.rows):
        lag, first = 1, min(1, len(stretches.rows) - 1)
    error = _predicted_ahead(problem, stretches, track, lag) / noise
    squares = [np.mean(error[own] ** 2) for own in stretches.rows[first:]]
    return float(np.median(squares))
