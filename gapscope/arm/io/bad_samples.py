"""Samples that a log should not hold: spikes, stuck encoders."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import median_filter

# Spikes: one or two samples that leave their neighbours and come back, as bit errors and lost words make them.
#
# A sample is compared with the median of five, itself and two on either side, which neither two spikes beside each
# other nor a step move. Time stamps have no say, so that a jittery clock makes no spikes.


IMPOSSIBLE_ACCELERATION = 1e3
"""Positions that leave their neighbours by more than this asks for are no motion [rad/s^2]; impacts stay below 500."""
SPIKE_DEVIATIONS = 3.0
"""Torques and velocities that leave theirs by so many standard deviations of the joint are none [1]."""
SPIKE_ROUGHNESS = 8.0
"""A spike exceeds the usual second difference by this factor [1]: noise, encoder steps and motion have made that."""
EDGE_ROUGHNESS = 2.0
"""The first and last two positions have neighbours on one side: there this factor is added [1]. Torques are left as
they are there: a controller that is switched on jumps, and what is trimmed from a recording holds it."""
MAX_SPIKES = 0.02
"""With a larger share of a joint's samples it is no spikes but the signal [1]."""
ABSURD = 1e5
"""Numbers of more standard deviations than this are no samples [1]: they are left, and an error says where they are."""
LARGEST = 1e100
"""Beyond it nothing is computed: an error says where such a number is."""
CENTRAL = (0.025, 0.975)
"""Quantiles between which deviations are measured, so that spikes do not hide themselves; of a normal one..."""
CENTRAL_WIDTH = 3.92
"""...they are so many standard deviations apart [1]."""
FEWEST_ROWS = 20
"""In shorter recordings nothing is usual."""

SENSED = ("q", "dq", "tau", "tau_sensor")
BRIDGED = "spikes replaced by the curve through their neighbours: "
"""Note on them; the number of each column follows."""


def without_spikes(
    t: np.ndarray, values: dict[str, np.ndarray], per_radian: np.ndarray
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Channels whose spikes are replaced by the cubic spline through all other samples; and a note.

    Args:
        t: time [s], (N,).
        values: channels by name, (N, n) each.
        per_radian: what counts as a radian of each joint, (n,): see ``NominalArm.per_radian``.
    """
    if len(t) < FEWEST_ROWS:
        return values, ()
    step = float(np.median(np.diff(t)))
    out, counts = dict(values), []
    for name in SENSED:
        # so written that no number at all fails too
        if name not in values or not (np.abs(values[name]) < LARGEST).all():
            continue
        low, high = np.quantile(values[name], CENTRAL, axis=0)
        deviation = (high - low) / CENTRAL_WIDTH
        least = SPIKE_DEVIATIONS * deviation
        if name == "q":
            least = 0.5 * IMPOSSIBLE_ACCELERATION * step**2 * per_radian
        for j, series in enumerate(values[name].T):
            rows = spikes(series, float(least[j]), ends=name == "q")
            absurd = np.abs(series[rows] - np.median(series)) > ABSURD * deviation[j]
            if not len(rows) or absurd.any():
                continue
            if out[name] is values[name]:
                out[name] = values[name].copy()
            out[name][:, j] = _bridged(t, series, rows)
            counts.append(f"{name}{j + 1} {len(rows)}")
    return out, (BRIDGED + ", ".join(counts),) if counts else ()


def spikes(series: np.ndarray, least: float, *, ends: bool = True) -> np.ndarray:
    """Places of the spikes of a series, (N,), that are larger than ``least``; none if there are too many.

    ``ends``: whether the first and last two samples may be some.
    """
    bends = np.abs(np.diff(series, n=2))
    usual = float(np.median(bends[bends > 0])) if bends.any() else 0.0
    threshold = max(least, SPIKE_ROUGHNESS * usual)
    none = np.zeros(0, dtype=int)
    # most series have no spike, and a look at their second differences says so
    if threshold <= 0 or bends.max() < threshold:
        return none
    found = np.abs(series - median_filter(series, 5)) > threshold
    found[:2] = found[-2:] = False
    places = np.arange(len(series))
    cleaned = _bridged(places, series, np.flatnonzero(found))
    for end in (cleaned, cleaned[::-1]) if ends else ():
        _straighten(end, EDGE_ROUGHNESS * threshold)
    # a spike moves the median of its neighbours as well
    found = np.abs(series - cleaned) > threshold
    found &= _comes_back(series, found)
    return np.flatnonzero(found) if found.mean() <= MAX_SPIKES else none


def _comes_back(series: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Which samples lie farther from those beside them, found ones left out, than these from each other, (N,).

    Beside a leap, as of an encoder that was stuck, they do not.
    """
    places = np.arange(len(series))
    good = places[~found]
    after = np.clip(np.searchsorted(good, places), 1, len(good) - 1)
    left, right = series[good[after - 1]], series[good[after]]
    return np.asarray(np.abs(series - 0.5 * (left + right)) > np.abs(right - left))


def _straighten(series: np.ndarray, most: float) -> None:
    """Put the first two samples of a series on the line through those after them if they are farther off."""
    for k in (1, 0):
        expected = 2 * series[k + 1] - series[k + 2]
        if abs(series[k] - expected) > most:
            series[k] = expected


def _bridged(t: np.ndarray, series: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A series with some of its rows taken from the cubic spline through all others, (N,)."""
    good = np.ones(len(series), dtype=bool)
    good[rows] = False
    out = series.copy()
    out[rows] = make_interp_spline(t[good], series[good], k=3)(t[rows])
    return out


# Positions that an encoder or driver kept while the arm moved on: they stand still, and then leap.
#
# Where the arm was meanwhile is unknown: the rows are left out, and leave a gap in time.


STUCK_TIME = 0.1
"""A position that stands for less is left as it is [s]: slow updates do that."""
LEAP = 20.0
"""It was stuck if it then leaps by so many of its usual steps [1]."""
LEFT_OUT = "rows left out in which a position stands still and then leaps: "
"""Note on them; their number and share follow."""


def stuck_rows(t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rows in which a position is stuck, mask of shape (N,), and notes.

    Args:
        t: time [s], (N,).
        q: positions, any unit, (N, n).
    """
    stuck = np.zeros(len(t), dtype=bool)
    joints = []
    for j, series in enumerate(q.T):
        own = _stuck(t, series)
        stuck |= own
        if own.any():
            joints.append(f"q{j + 1}")
    if not joints:
        return stuck, ()
    note = f"{LEFT_OUT}{stuck.sum()} ({stuck.mean():.2%}), {', '.join(joints)}"
    return stuck, (note,)


def _stuck(t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Rows in which one joint's position, (N,), is stuck."""
    steps = np.diff(series)
    edges = np.flatnonzero(steps) + 1
    starts, stops = np.r_[0, edges], np.r_[edges, len(series)]
    out = np.zeros(len(series), dtype=bool)
    if not len(edges):
        return out
    usual = np.median(np.abs(steps[edges - 1]))
    leap = np.r_[np.abs(steps[edges - 1]), 0.0]
    long = t[stops - 1] - t[starts] >= STUCK_TIME
    for place in np.flatnonzero(long & (leap > LEAP * usual)):
        # the first of them was measured
        out[starts[place] + 1 : stops[place]] = True
    return out
