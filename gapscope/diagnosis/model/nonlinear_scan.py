"""The search for parameters in which the torque is not linear, scanned over what they can be.

For each candidate the columns of its linear coordinates are projected on the residual of a joint's gap when
everything that acts on that joint is taken out; the gain of a candidate is the sum of squares that its columns explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from gapscope.diagnosis.gap.prediction import Prediction
from gapscope.diagnosis.model.candidate_columns import (
    beyond,
    cycle_step,
    grid_of,
    grid_unit,
    grid_values,
    law_columns,
    least_limit,
    recorded_torque,
    waves,
)
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.scan import NonlinearParameters, Scan
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.thresholds import (
    HELD_NEAR_LIMIT,
    LEAST_NEED_AT_LIMIT,
    LEAST_RIPPLE_CYCLES,
    LIMITED_TIME_TRACKING,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift, Path
from gapscope.ident.signals.conditioning import Segment


def around(value: float, lowest: float, highest: float) -> np.ndarray:
    """Candidates about a value, in equal ratios."""
    return np.clip(value * np.geomspace(0.6, 1 / 0.6, 13), lowest, highest)


class ScannedArm:
    """The arm whose gap is scanned.

    Args:
        corrected: the arm.
        predictions: what it predicts on each segment.
    """

    def __init__(
        self, corrected: CorrectedArm, predictions: Sequence[Prediction]
    ) -> None:
        self.corrected, self._predictions = corrected, predictions

    def torque(self, j: int) -> list[np.ndarray]:
        """Torque that the arm predicts on a joint [N m], (N,) for each segment."""
        return [at.torque[:, j] for at in self._predictions]

    @cached_property
    def steady_friction(self) -> list[np.ndarray]:
        """Friction of the joints as if it did not drift [N m], (N, n) for each segment."""
        effects = self.corrected.effects
        steady = tuple(e for e in effects if not isinstance(e.effect, Drift))
        arm = replace(self.corrected, effects=steady)
        smooth, out = _without_friction(arm), []
        for at in self._predictions:
            none = np.zeros_like(at.rigid)
            both = (one.needed_torque(none, at.motion) for one in (arm, smooth))
            out.append(np.subtract(*both))
        return out


def search_nonlinear(
    term: Term, arm: ScannedArm, data: FitData, scan: Scan, known: float | None
) -> NonlinearParameters:
    """The best nonlinear parameters of a joint effect's term; near ``known`` if it has been found before.

    Raises:
        KeyError: the effect has no nonlinear parameter on a joint.
    """
    j, effect = term.joint - 1, term.definition
    needed = arm.torque(j)
    if effect.limits:
        return _saturation(j, data, scan, known, needed)
    if isinstance(effect, Path):
        return _ripple(j, arm.corrected, data, scan, known)
    if isinstance(effect, Drift):
        values = _values(term, data.segments, known)
        friction = [x[:, j, None] for x in arm.steady_friction]
        return _drift(effect, values, friction, data, scan)
    if known is None and (of_velocity := data.candidates.law(term)) is not None:
        columns = scan.weighted(of_velocity.columns)
        return scan.best(of_velocity.values, columns, term.parametrisation.linear)
    values = _values(term, data.segments, known)
    by_segment = []
    for segment, load in zip(data.segments, needed, strict=True):
        position = arm.corrected.true_position(segment.motion.q)[:, j, None]
        law = law_columns(term, values, segment, position, load[:, None])
        by_segment.append(law)
    columns = scan.weighted(data.rows(by_segment))
    return scan.best(values, columns, term.parametrisation.linear)


def _values(term: Term, segments: list[Segment], known: float | None) -> np.ndarray:
    """Values of a term's nonlinear parameter to try: the effect's grid, or values about one that is known."""
    if known is None:
        return grid_values(term, segments)
    grid = grid_of(term)
    unit = grid_unit(grid, term.joint - 1, segments)
    lowest, highest = grid.bounds
    return around(known, unit * lowest, unit * highest)


def _drift(
    drift: Drift,
    times: np.ndarray,
    friction: Sequence[np.ndarray],
    data: FitData,
    scan: Scan,
) -> NonlinearParameters:
    """The best time constant of a drift of a joint's friction [N m], (N, 1) for each segment."""
    series = []
    for s, steady in zip(data.segments, friction, strict=True):
        change = drift.change(s.motion.t[:, None], np.ones(len(times)), times)
        series.append(steady * change)
    return scan.best(times, scan.weighted(data.rows(series)))


def _without_friction(arm: CorrectedArm) -> CorrectedArm:
    """The same arm without any friction."""
    bare = replace(
        arm.arm, coulomb=0.0 * arm.arm.coulomb, viscous=0.0 * arm.arm.viscous
    )
    return CorrectedArm(
        bare, tuple(e for e in arm.effects if e.effect.family != "friction")
    )


def _ripple(
    j: int, arm: CorrectedArm, data: FitData, scan: Scan, known: float | None
) -> NonlinearParameters:
    """The best number of cycles; about one that is known."""
    if known is None:
        # the columns are not weighed by trust: a ripple shows as well where a joint sticks
        cycles, columns, products = data.candidates.ripples(j)
        return scan.best(cycles, columns, 2, products)
    q = [arm.true_position(s.motion.q)[:, j, None] for s in data.segments]
    size = arm.arm.per_radian[j]
    step = cycle_step([x / size for x in q]) / size
    cycles = np.maximum(
        known + step * np.linspace(-0.6, 0.6, 9), LEAST_RIPPLE_CYCLES / size
    )
    columns = data.rows([waves(cycles, x) for x in q])
    return scan.best(cycles, scan.weighted(columns), 2)


def _saturation(
    j: int,
    data: FitData,
    scan: Scan,
    known: float | None,
    needed: Sequence[np.ndarray],
) -> NonlinearParameters:
    """A limit that the torque seldom exceeds, while about the limit is needed; if there is none, the largest torque.

    Without the second, to call most of a torque lost would explain any gap.
    """
    torque = recorded_torque(data.segments, j)
    recorded = np.vstack(torque)[:, 0]
    largest, least = float(np.abs(recorded).max()), least_limit(torque)
    if largest == 0:
        # any limit lets a torque of zero through
        return NonlinearParameters((1.0,), (1.0,))
    none = NonlinearParameters((0.999 * largest,), (0.5 * largest,))
    if known is None:
        limits, columns, _ = data.candidates.limits(j)
        possible = _possible(limits, recorded, np.concatenate(needed))
        limits, lost = limits[possible], scan.weighted(columns[:, possible])
    else:
        near = known * np.linspace(0.9, 1.1, 21)
        limits = np.clip(near, least, 0.999 * largest)
        limits = limits[_possible(limits, recorded, np.concatenate(needed))]
        lost = scan.weighted(data.rows([beyond(x, limits) for x in torque]))
    if not len(limits):
        return none
    found = scan.best(limits, lost)
    # at the lowest limit the scan would go on to call even more of the torque lost
    return found if found.values[0] > 1.02 * least else none


def _possible(
    limits: np.ndarray, recorded: np.ndarray, needed: np.ndarray
) -> np.ndarray:
    """Which limits the motion allows, (L,), by the torque recorded and the torque needed [N m], (N,) each."""
    # needed torque in the direction of the recorded one, while that exceeds the limit: mean and mean square
    along, size = np.sign(recorded) * needed, np.abs(recorded)
    order = np.argsort(size)
    within = np.searchsorted(size[order], limits, side="right")
    count = len(size) - within
    sums = [_sums_from(x[order], within) for x in (along, along**2)]
    mean, mean_square = sums / np.maximum(count, 1)
    apart2 = mean_square - 2 * mean * limits + limits**2
    apart = np.sqrt(np.maximum(apart2, 0.0))
    seldom = count / len(size) < LIMITED_TIME_TRACKING
    held = apart < HELD_NEAR_LIMIT * limits
    return (mean > LEAST_NEED_AT_LIMIT * limits) & (seldom | held)


def _sums_from(series: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Sums of a series (N,) from each of some places to its end, (L,)."""
    up_to = np.append(0.0, np.cumsum(series))
    return np.asarray(up_to[-1] - up_to[starts])
