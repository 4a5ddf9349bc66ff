"""Columns of candidates for nonlinear parameters, and those of them that follow from the recordings alone.

A search scans the latter at every linearisation on what is left there; they are computed and filtered once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gapscope.effects.effect import Drift, Effect, Path, Signals, TorqueLaw
from gapscope.effects.parametrisation import JointSeries
from gapscope.model.conditioning import Segment, low_pass
from gapscope.model.decimated_segments import DecimatedSegments
from gapscope.model.terms import Term


class Candidates(NamedTuple):
    """Candidates for a nonlinear parameter.

    Attributes:
        values: of the parameter, (K,).
        columns: of its linear coordinates, which lie side by side, on the rows of all segments, (M, K c).
    """

    values: np.ndarray
    columns: np.ndarray


class JointSignals(NamedTuple):
    """What the laws on one joint may depend on, on one segment, (N, 1) each.

    Attributes:
        t: time since the start of the recording [s].
        position, velocity: [rad], [rad/s].
        recorded: torque [N m].
        load: torque that the arm predicts [N m].
        friction: its friction as if it did not drift [N m].
    """

    t: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    recorded: np.ndarray
    load: np.ndarray
    friction: np.ndarray


def unit_columns(
    effect: Effect, values: np.ndarray, signals: JointSignals
) -> np.ndarray:
    """Torque of an effect of unit coordinates for each value of (K,) of its nonlinear parameter [N m], (N, K c).

    Raises:
        KeyError: no law of its kind has a nonlinear parameter on a joint.
    """
    columns = []
    for unit in np.eye(effect.fitted.linear):
        x = np.repeat(unit[:, None], len(values), axis=1)
        by_name = effect.fitted.values(x, values[None])
        parameters = [by_name[name] for name in effect.names]
        if isinstance(effect, Path):
            u = signals.recorded
            torque = effect.applied(u, signals, *parameters) - u
        elif isinstance(effect, Drift):
            torque = signals.friction * effect.change(signals.t, *parameters)
        elif isinstance(effect, TorqueLaw):
            state = signals.t, signals.position, signals.velocity, signals.load
            torque = effect.law(Signals(*state), *parameters)
        else:
            raise KeyError(f"{effect.name} has no nonlinear parameter on a joint")
        columns.append(np.broadcast_to(torque, (len(signals.t), len(values))))
    return np.stack(columns, axis=2).reshape(len(signals.t), -1)


def shows_at_rest(effect: Effect) -> bool:
    """Whether rows on which the joint sticks show it as well as others: what friction hides is not on the way there."""
    return isinstance(effect, Path) and not effect.limits


class CandidateColumns:
    """Columns of candidates on the rows of some segments, each computed when it is first asked for.

    Args:
        data: the segments.
        per_radian: what counts as a radian of each joint, (n,).
    """

    def __init__(self, data: DecimatedSegments, per_radian: np.ndarray) -> None:
        self._data, self._per_radian = data, per_radian
        self._known: dict[Term, Candidates | None] = {}

    def series(self, j: int) -> JointSeries:
        """What a joint, from 0, did in all recordings."""
        segments = self._data.segments
        return JointSeries(
            [s.motion.t for s in segments],
            [s.motion.q[:, j] for s in segments],
            [s.motion.dq[:, j] for s in segments],
            [s.torque[:, j] for s in segments if s.torque is not None],
            float(self._per_radian[j]),
        )

    def of(self, term: Term) -> Candidates | None:
        """First values of a term's nonlinear parameter, with their columns.

        ``None`` if its law depends on what the effects of the arm change.
        """
        if term not in self._known:
            self._known[term] = self._of(term)
        return self._known[term]

    def _of(self, term: Term) -> Candidates | None:
        effect, j = term.definition, term.joint - 1
        if effect.fitted.grid is None:
            raise KeyError(f"{effect.name} says no values of its nonlinear parameter")
        values = effect.fitted.grid(self.series(j), None)
        # of a torque of zero
        if not len(values):
            return Candidates(values, np.zeros((0, 0)))
        many, columns = shows_at_rest(effect), []
        for segment in self._data.segments:
            stride = self._stride(segment) if many else 1
            signals = _recorded(segment, j, stride)
            if not isinstance(effect, Path):
                # a zero that is off shifts the phase of what acts on the way to the joint, and more of other laws
                signals = signals._replace(position=np.full_like(signals.t, np.nan))
            own = unit_columns(effect, values, signals)
            # what is not a number shows in the torque of a law that depends on it
            if not np.isfinite(own).all():
                return None
            if many:
                columns.append(self._sparse(segment, own))
            else:
                columns.append(self._data.thin(own, segment))
        if not many:
            return Candidates(values, np.vstack(columns))
        return Candidates(values, np.vstack(columns).astype(np.float32))

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


def _recorded(segment: Segment, j: int, stride: int) -> JointSignals:
    """Signals of a joint, from 0, on every so many samples of a segment; what an arm's effects change is unknown."""
    assert segment.torque is not None
    motion, own = segment.motion, np.s_[::stride, j, None]
    unknown = np.full((len(motion.t[::stride]), 1), np.nan)
    return JointSignals(
        motion.t[::stride, None],
        motion.q[own],
        motion.dq[own],
        segment.torque[own],
        unknown,
        unknown,
    )
