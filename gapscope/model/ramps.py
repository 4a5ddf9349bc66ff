"""Changes that take a while: a parameter that rises or falls evenly between two moments of a recording.

The torque r that a recording has beside all else, of variance s^2, is taken as w(t) x d(t), with d the torque of a term
and w 0 up to a moment a, 1 from a moment b on, and even in between. The likeliest x explains

    G(a, b) = (sum w r d / s^2)^2 / (2 sum w^2 d^2 / s^2)    [nats].

With a = b that is a change at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

EDGES = 40
"""Moments of a recording between which a ramp is looked for, and of one of its ends when that is placed. (budget)"""


class Ramp(NamedTuple):
    """An even change.

    Attributes:
        begin, end: of it [s].
        begins: between which moments it begins, with a given probability [s].
        share: what it reaches, over the term's torque [1].
        explained: that is explained [nats].
        mean: evidence of a ramp between any two moments, each pair as likely [nats].
        at_once: the same of a change at once.
    """

    begin: float
    end: float
    begins: tuple[float, float]
    share: float
    explained: float
    mean: float
    at_once: float


def best_ramp(
    t: np.ndarray, right: np.ndarray, square: np.ndarray, shortest: float, sure: float
) -> Ramp | None:
    """The likeliest ramp of a term in a recording; ``None`` if none fits into it.

    Args:
        t: times of its rows [s], (T,).
        right: sum over joints of r d / s^2 on each row, (T,).
        square: sum over joints of d^2 / s^2 on each row, (T,).
        shortest: a shorter ramp is none [s].
        sure: probability that it begins between the moments that are told [1].
    """
    edges = np.linspace(t[0], t[-1], EDGES)
    a, b = (x.ravel() for x in np.meshgrid(edges, edges))
    gain, _ = _explained(t, right, square, a, b)
    ramps = gain[b - a >= shortest]
    if not len(ramps):
        return None
    # at once, before each row
    pull, weight = (x[::-1].cumsum()[::-1] for x in (right, square))
    steps = pull**2 / np.maximum(weight, 1e-12) / 2
    of_ramps = np.where(b - a >= shortest, gain, -np.inf)
    k, width = int(of_ramps.argmax()), edges[1] - edges[0]
    # once more, about the best
    near = np.linspace(-width, width, EDGES)
    a, b = (x.ravel() for x in np.meshgrid(a[k] + near, b[k] + near))
    longer = b - a >= shortest
    a, b = a[longer], b[longer]
    gain, share = _explained(t, right, square, a, b)
    k = int(gain.argmax())
    order = np.argsort(a, kind="stable")
    likely = np.exp(gain - gain.max())[order].cumsum()
    low, high = np.searchsorted(likely / likely[-1], [(1 - sure) / 2, (1 + sure) / 2])
    step = width / EDGES + float(np.median(np.diff(t)))
    begins = float(a[order][low]) - step, float(a[order][high]) + step
    return Ramp(
        float(a[k]),
        float(b[k]),
        begins,
        float(share[k]),
        float(gain[k]),
        _mean(ramps),
        _mean(steps),
    )


def _explained(
    t: np.ndarray, right: np.ndarray, square: np.ndarray, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """G of each pair of moments [nats], (K,), and the likeliest x, (K,)."""
    length = np.maximum(b - a, 1e-9)[:, None]
    w = np.clip((t - a[:, None]) / length, 0.0, 1.0)
    pull, weight = w @ right, w**2 @ square
    share = pull / np.maximum(weight, 1e-12)
    return share * pull / 2, share


def _mean(gain: np.ndarray) -> float:
    return float(np.logaddexp.reduce(gain) - np.log(len(gain)))
