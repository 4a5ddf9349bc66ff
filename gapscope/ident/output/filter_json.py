"""The filter beside the batch, as ``identification.json`` holds it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np

from gapscope.ident.kalman.review import Departure, FilterReview
from gapscope.ident.kalman.states_and_friction import StatesAndFriction
from gapscope.ident.uncertainty.validation import LEVEL

MOMENTS = 60
"""Moments at which the estimates are written, at most."""


def filter_document(review: FilterReview, expressions: Sequence[str]) -> dict[str, Any]:
    """Estimates over time with standard deviations, innovations, convergence, departures.

    Args:
        review: of the filter.
        expressions: the base parameters in words, shape (b,).
    """
    followed, white = review.followed, review.whiteness
    track, count = followed.track, len(review.times)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOMENTS)).astype(int))
    value, deviation = track.value[chosen], track.deviation[chosen]
    start = review.converged
    return {
        "process_noise": followed.level,
        "stretch": followed.stretches.length,
        "converged": None if start is None else review.elapsed[start],
        "elapsed": review.elapsed[chosen],
        "recordings": _recordings(review),
        "parameters": [
            {
                "expression": expression,
                "batch": review.batch[i],
                "value": _rounded(value[:, i]),
                "std": _rounded(deviation[:, i]),
            }
            for i, expression in enumerate(expressions)
        ],
        "innovations": {
            "rms": review.rms,
            "samples_per_independent": followed.inflation,
            "ljung_box": white.statistic,
            "p_value": white.p_value,
            "level": LEVEL,
            "white": white.white,
            "largest_autocorrelation": white.largest,
            "bound": white.bound,
        },
        "departures": [
            _departure(review, departure, expressions)
            for departure in review.departures
        ],
    }


def states_document(states: StatesAndFriction | None) -> dict[str, Any] | None:
    """Friction by the unscented filter over time, and how well it predicts the encoders; ``None`` if not asked for."""
    if states is None:
        return None
    track = states.track
    count = len(track.t)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MOMENTS)).astype(int))
    value, deviation = states.friction[chosen], states.deviation[chosen]
    return {
        "recording": states.recording,
        "time": track.t[chosen],
        "innovation_rms": np.sqrt(np.mean(track.innovation[1:] ** 2, axis=0)),
        "parameters": [
            {
                "name": name,
                "identified": states.start[i],
                "value": _rounded(value[:, i]),
                "std": _rounded(deviation[:, i]),
            }
            for i, name in enumerate(states.names)
        ],
    }


def _recordings(review: FilterReview) -> list[dict[str, Any]]:
    """The recordings in the order of the filter, each with its end."""
    stretches = zip(review.recordings, review.elapsed, strict=True)
    runs = groupby(stretches, key=lambda stretch: stretch[0])
    return [{"name": name, "until": list(run)[-1][1]} for name, run in runs]


def _departure(
    review: FilterReview, departure: Departure, expressions: Sequence[str]
) -> dict[str, Any]:
    k, i = departure.stretch, departure.parameter
    track = review.followed.track
    return {
        "expression": expressions[i],
        "recording": review.recordings[k],
        "time": review.times[k],
        "elapsed": review.elapsed[k],
        "filter": track.value[k, i],
        "std": track.deviation[k, i],
        "batch": review.batch[i],
        "standard_errors": departure.size,
    }


def _rounded(series: np.ndarray) -> list[float]:
    """Five significant digits, which keeps the file small."""
    return [float(f"{x:.5g}") for x in series]
