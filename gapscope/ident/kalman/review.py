"""The filter beside the batch: when it converged, where it departs, whether its innovations are white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.ident.kalman.filters import SETTLED, Followed, Opening, follow
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.samples import Samples
from gapscope.ident.uncertainty.examination import (
    Whiteness,
    band_correlation,
    whiteness,
)
from gapscope.model.changes import Change

BAND = 4.0
"""Standard errors by which the filter departs from the batch; 3.9 is reached once in 10 000 by chance."""
DETERMINED = 1e-6
"""Least singular value of the columns in which a change moves parameters, over the largest [1]. (numerics)"""
WIDER = 3.0
"""Variance of a parameter that changed, over the squared size of the change [1]."""


@dataclass(frozen=True)
class Departure:
    """A parameter whose estimate at some moment excludes the batch's.

    Attributes:
        parameter: its place among the base parameters.
        stretch: where it is farthest off.
        size: distance over the filter's standard error [1].
    """

    parameter: int
    stretch: int
    size: float


@dataclass(frozen=True)
class FilterReview:
    """A filter beside the batch estimate, K stretches of n joints, b parameters.

    Attributes:
        followed: what the filter saw.
        batch: the estimate it is compared with, shape (b,).
        recordings: name of the recording of each stretch, K of them.
        times: time in it at the end of each stretch [s], shape (K,).
        converged: number of the first stretch from which on the uncertainty of the parameters adds less to the
            predicted torque than its noise; ``None`` if there is none.
        departures: after that, one for each parameter that departs, the farthest first.
        whiteness: of the innovations after that.
        changes: those that the filter was told of: there it started anew with what changed.
        moved: by how much each of them moved the parameters, shape (C, b).
    """

    followed: Followed
    batch: np.ndarray
    recordings: tuple[str, ...]
    times: np.ndarray
    converged: int | None
    departures: tuple[Departure, ...]
    whiteness: Whiteness
    changes: tuple[Change, ...]
    moved: np.ndarray

    @property
    def elapsed(self) -> np.ndarray:
        """Time of the samples so far, all recordings together [s], shape (K,)."""
        return self.followed.stretches.ends

    @property
    def rms(self) -> np.ndarray:
        """RMS of the innovations after convergence over the RMS residual of the batch [1], shape (n,)."""
        counted = self.followed.innovation[_first_sample(self.followed, self.converged)]
        return np.asarray(np.sqrt(np.mean(counted**2, axis=0)))


def review(
    samples: Samples,
    problem: Problem,
    batch: np.ndarray | None,
    changes: Sequence[Change],
) -> FilterReview:
    """Filter the samples of an identification, and compare with its estimate.

    Args:
        samples: that were fitted.
        problem: the same in the base columns.
        batch: the estimate of all samples, shape (b,); weighted least squares if ``None``.
        changes: found during recordings; of those in the samples the filter is told.
    """
    names = np.array([samples.segments[k].recording for k in samples.group])
    told, moved, openings = [], [], []
    for found in changes:
        after = np.flatnonzero(
            (names == found.recording) & (samples.times > found.time)
        )
        if len(after):
            D = _moved(found, problem, names, samples.times)
            openings += _openings(found, D, after)
            told.append(found)
            moved.append(D @ found.value)
    openings = [some for some in openings if some.sample < len(names)]
    openings.sort(key=lambda opening: opening.sample)
    followed = follow(problem, openings)
    ends = np.array([own.stop - 1 for own in followed.stretches.rows])
    batch = followed.batch if batch is None else batch
    converged = _converged(followed)
    return FilterReview(
        followed=followed,
        batch=batch,
        recordings=tuple(names[ends].tolist()),
        times=samples.times[ends],
        converged=converged,
        departures=_departures(followed, batch, converged),
        whiteness=_whiteness(followed, samples.band.cutoff, converged),
        changes=tuple(told),
        moved=np.array(moved),
    )


def _moved(
    found: Change, problem: Problem, names: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """By how much each coordinate of a change moves the parameters, as far as its torque can be theirs, (b, linear).

    Args:
        found: the change.
        problem: in the base columns.
        names: of the recordings of its samples, (N,).
        times: of its samples [s], (N,).
    """
    torque = np.zeros((*problem.torque.shape, len(found.value)))
    for name, (t, columns) in found.columns.items():
        here = np.flatnonzero(names == name)
        for j, k in np.ndindex(columns.shape[1:]):
            torque[here, j, k] = np.interp(times[here], t, columns[:, j, k])
    # a joint that does not count there has a row of zeros
    torque *= np.any(problem.matrix, axis=2, keepdims=True)
    W = problem.matrix.reshape(torque[..., 0].size, -1)
    scale = np.linalg.norm(W, axis=0)
    right = torque.reshape(len(W), -1)
    return np.linalg.lstsq(W / scale, right, rcond=DETERMINED)[0] / scale[:, None]


def _openings(found: Change, moved: np.ndarray, after: np.ndarray) -> list[Opening]:
    """What changed is unknown after the moment, and again where the recording ends if another follows."""
    variance = WIDER * (found.value**2 + found.deviation**2)
    covariance = (moved * variance) @ moved.T
    return [Opening(int(k), covariance) for k in (after[0], after[-1] + 1)]


def _converged(followed: Followed) -> int | None:
    """The first stretch from which on W P W^T, the variance that the estimate adds, is below that of the noise."""
    problem, rows = followed.problem, followed.stretches.rows
    first = 1
    for k in range(1, len(rows)):
        W = problem.matrix[rows[k]]
        # P of the estimate before the stretch
        spread = W @ followed.track.covariance[k - 1]
        added = np.einsum("mja,mja->mj", spread, W) / followed.noise**2
        if added.mean() > 1:
            first = k + 1
    return first if first < len(rows) else None


def _first_sample(followed: Followed, converged: int | None) -> slice:
    """The samples after convergence; of a filter that did not converge those after it settled."""
    rows = followed.stretches.rows
    first = converged
    if first is None:
        first = min(max(1, int(SETTLED * len(rows))), len(rows) - 1)
    return slice(rows[first].start, None)


def _departures(
    followed: Followed, batch: np.ndarray, converged: int | None
) -> tuple[Departure, ...]:
    if converged is None:
        return ()
    track = followed.track
    deviation = np.maximum(track.deviation[converged:], 1e-300)
    size = np.abs(track.value[converged:] - batch) / deviation
    farthest = size.argmax(axis=0)
    found = [
        Departure(i, converged + int(k), float(size[k, i]))
        for i, k in enumerate(farthest)
        if size[k, i] > BAND
    ]
    return tuple(sorted(found, key=lambda departure: -departure.size))


def _whiteness(followed: Followed, cutoff: float, converged: int | None) -> Whiteness:
    """Of the innovations sampled at the cut-off, as in the validation."""
    rate = 1.0 / followed.problem.interval
    step = max(1, round(rate / cutoff))
    counted = _first_sample(followed, converged)
    series = followed.innovation[counted][::step]
    group = followed.problem.group[counted][::step]
    return whiteness(series, group, band_correlation(rate, cutoff, step))
