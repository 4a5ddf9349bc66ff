"""Columns of candidates for nonlinear parameters that follow from the recordings alone, whatever the arm's effects are.

A search scans them at every linearisation on what is left there; they are computed and filtered once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gapscope.diagnosis.model.decimated_segments import DecimatedSegments
from gapscope.diagnosis.model.scan import products
from gapscope.diagnosis.model.terms import Term, parametrisation_of
from gapscope.diagnosis.thresholds import (
    FASTEST,
    LEAST_RIPPLE_CYCLES,
    LEAST_RIPPLE_PERIODS,
    LEAST_TORQUE_LIMIT,
    LIMITED_TIME_HELD,
    MOST_RIPPLE_CYCLES,
    TORQUE_LIMIT_GRID,
)
from gapscope.effects.effect import Signals, TorqueLaw
from gapscope.effects.parametrisation import Grid
from gapscope.ident.signals.conditioning import Segment, low_pass

LEAST_TRAVEL = 1e-6
"""Travel below which a joint stands still [rad]."""


class Candidates(NamedTuple):
    """Candidates for a nonlinear parameter.

    Attributes:
        values: of the parameter, (K,).
        columns: of its linear coordinates, which lie side by side, on the rows of all segments, (M, K c).
        products: X^T X of each candidate's columns, (K, c, c), of columns that are not weighed by trust.
    """

    values: np.ndarray
    columns: np.ndarray
    products: np.ndarray | None = None


class CandidateColumns:
    """Columns of candidates on the rows of some segments, each computed when it is first asked for.

    Args:
        data: the segments.
        per_radian: what counts as a radian of each joint, (n,).
    """

    def __init__(self, data: DecimatedSegments, per_radian: np.ndarray) -> None:
        self._data, self._per_radian = data, per_radian
        self._ripples: dict[int, Candidates] = {}
        self._limits: dict[int, Candidates] = {}
        self._laws: dict[Term, Candidates | None] = {}

    def ripples(self, j: int) -> Candidates:
        """Cycles of ripples to look for on a joint, with sine and cosine of each."""
        if j not in self._ripples:
            self._ripples[j] = self._waves(j)
        return self._ripples[j]

    def limits(self, j: int) -> Candidates:
        """Limits of a joint's torque [N m], with what each would have kept from the joint [N m]."""
        if j not in self._limits:
            torque = recorded_torque(self._data.segments, j)
            limits = _torque_limits(torque)
            lost = [beyond(x, limits) for x in torque]
            self._limits[j] = Candidates(limits, self._data.rows(lost))
        return self._limits[j]

    def law(self, term: Term) -> Candidates | None:
        """Values of a law's nonlinear parameter, with its torque of unit amplitude [N m].

        ``None`` if the law depends on more than time and velocity: on what the effects of the arm change.
        """
        if term not in self._laws:
            self._laws[term] = self._of_velocity(term)
        return self._laws[term]

    def _of_velocity(self, term: Term) -> Candidates | None:
        values = grid_values(term, self._data.segments)
        columns = []
        for segment in self._data.segments:
            # what is not a number shows in the torque of a law that depends on it
            unknown = np.full((len(segment.motion.t), 1), np.nan)
            columns.append(law_columns(term, values, segment, unknown, unknown))
        if not all(np.isfinite(x).all() for x in columns):
            return None
        return Candidates(values, self._data.rows(columns))

    def _waves(self, j: int) -> Candidates:
        data = self._data
        q = [s.motion.q[:, j, None] for s in data.segments]
        # of a slide, periods per 2 pi of what counts as a radian
        size = self._per_radian[j]
        dq = np.concatenate([s.motion.dq[:, j] for s in data.segments])
        cycles = _ripple_cycles([x / size for x in q], dq / size) / size
        columns = [
            self._sparse(s, waves(cycles, x[:: self._stride(s)]))
            for s, x in zip(data.segments, q, strict=True)
        ]
        stacked = np.vstack(columns).astype(np.float32)
        return Candidates(cycles, stacked, products(stacked, 2))

    def _stride(self, segment: Segment) -> int:
        """Every how many samples many columns are computed: a divisor of ``step`` that leaves four times the band."""
        step = self._data.step(segment)
        most = max(1, int(segment.motion.rate // (4 * self._data.cutoff)))
        return max(k for k in range(1, most + 1) if step % k == 0)

    def _sparse(self, segment: Segment, series: np.ndarray) -> np.ndarray:
        """Rows of series that are given on every so many samples only."""
        stride, inner = self._stride(segment), segment.inner
        kept = low_pass(series, segment.motion.rate / stride, self._data.cutoff)
        rows = np.arange(inner.start, inner.stop, self._data.step(segment)) / stride
        return kept[np.minimum(np.round(rows).astype(int), len(kept) - 1)]


def grid_values(term: Term, segments: list[Segment]) -> np.ndarray:
    """Values of a term's nonlinear parameter to try, by its effect's grid, (K,).

    Raises:
        KeyError: the effect has no grid.
    """
    grid = grid_of(term)
    unit = grid_unit(grid, term.joint - 1, segments)
    return unit * np.geomspace(grid.lowest, grid.highest, grid.points)


def grid_of(term: Term) -> Grid:
    """The grid of a term's nonlinear parameter.

    Raises:
        KeyError: the effect has none.
    """
    grid = term.parametrisation.grid
    if grid is None:
        raise KeyError(f"{term.effect} says no grid for its nonlinear parameter")
    return grid


def grid_unit(grid: Grid, j: int, segments: list[Segment]) -> float:
    """What the values of a grid count in, in the parameter's own unit: 1, a time [s], or a speed [rad/s]."""
    if grid.unit == "duration":
        # blocks of a recording begin when it has run for a while
        last = max(float(s.motion.t[-1]) for s in segments)
        return last - min(float(s.motion.t[0]) for s in segments)
    if grid.unit == "largest speed":
        speeds = [np.abs(s.motion.dq[:, j]) for s in segments]
        # a joint that never moves still needs a unit; nothing is found on it
        return max(float(np.quantile(np.concatenate(speeds), FASTEST)), 1e-3)
    return 1.0


def law_columns(
    term: Term,
    values: np.ndarray,
    segment: Segment,
    position: np.ndarray,
    load: np.ndarray,
) -> np.ndarray:
    """Torque of a term's law for each value of (K,) of its nonlinear parameter [N m], (N, K c).

    Those of c linear coordinates, each one alone and of size one, lie side by side.

    Args:
        term: the term.
        values: of the parameter.
        segment: where the joint moves.
        position: true positions of the joint [rad], (N, 1).
        load: torque through its transmission [N m], (N, 1).
    """
    law, motion = term.definition, segment.motion
    assert isinstance(law, TorqueLaw)
    fit, count = parametrisation_of(law), len(values)
    velocity = motion.dq[:, term.joint - 1, None]
    signals = Signals(motion.t[:, None], position, velocity, load)
    columns = []
    for unit in np.eye(fit.linear):
        parameters = fit.values(np.outer(unit, np.ones(count)), values[None])
        torque = law.law(signals, *(parameters[name] for name in law.names))
        columns.append(np.broadcast_to(torque, (len(motion.t), count)))
    return np.stack(columns, axis=2).reshape(len(motion.t), -1)


def waves(cycles: np.ndarray, q: np.ndarray) -> np.ndarray:
    """sin n q and cos n q side by side for each n of (K,), shape (N, 2 K); q in rad, (N, 1)."""
    return np.stack([np.sin(cycles * q), np.cos(cycles * q)], axis=2).reshape(
        len(q), -1
    )


def cycle_step(q: Sequence[np.ndarray]) -> float:
    """Cycles per revolution that recordings of a joint's position [rad] can separate."""
    return 0.8 / max(max(float(np.ptp(x)) for x in q), 0.3)


def _ripple_cycles(q: Sequence[np.ndarray], dq: np.ndarray) -> np.ndarray:
    """Cycles per revolution to look for on a joint, as far as its slow motion keeps them within the filter's band."""
    speed = float(np.quantile(np.abs(dq), 0.3))
    # a joint that stands still shows no ripple; its columns are constant then, whatever the cycles
    travel = max(max(float(np.ptp(x)) for x in q), LEAST_TRAVEL)
    least = max(LEAST_RIPPLE_CYCLES, LEAST_RIPPLE_PERIODS * 2 * np.pi / travel)
    band = max(min(MOST_RIPPLE_CYCLES, 75.0 / max(speed, 1e-3)), 30.0)
    return np.arange(least, least + band, cycle_step(q))


def recorded_torque(segments: list[Segment], j: int) -> list[np.ndarray]:
    """Recorded torque of a joint on each segment [N m], (N, 1)."""
    return [s.torque[:, j, None] for s in segments if s.torque is not None]


def beyond(torque: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """What each limit of (K,) keeps of a torque (N, 1), (N, K), all [N m]."""
    return torque - np.clip(torque, -limits, limits)


def least_limit(torque: Sequence[np.ndarray]) -> float:
    """The lowest limit [N m] that a joint's recorded torque may have; 0 if there is no torque."""
    recorded = np.abs(np.concatenate(torque))
    seldom = float(np.quantile(recorded, 1.0 - LIMITED_TIME_HELD))
    return max(LEAST_TORQUE_LIMIT * float(recorded.max()), seldom)


def _torque_limits(torque: Sequence[np.ndarray]) -> np.ndarray:
    """Limits to try [N m], (K,): from the least up to the largest torque in even steps and ratios; none without any."""
    largest = float(np.abs(np.concatenate(torque)).max())
    if largest == 0:
        return np.zeros(0)
    least = least_limit(torque)
    steps = np.linspace(least, 0.98 * largest, TORQUE_LIMIT_GRID)
    ratios = np.geomspace(least, 0.97 * largest, TORQUE_LIMIT_GRID)[1:]
    return np.sort([*steps, *ratios])
