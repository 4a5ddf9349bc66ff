"""The search for parameters in which the torque is not linear, scanned over what they can be.

For each candidate the columns of its linear coordinates are projected on the residual of a joint's gap when
everything that acts on that joint is taken out; the gain of a candidate is the sum of squares that its columns explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.model.scan import NonlinearParameters, Scan
from gapscope.diagnosis.model.terms import Term, parametrisation_of
from gapscope.diagnosis.thresholds import (
    FASTEST,
    HELD_NEAR_LIMIT,
    LEAST_NEED_AT_LIMIT,
    LEAST_RIPPLE_CYCLES,
    LEAST_RIPPLE_PERIODS,
    LEAST_TORQUE_LIMIT,
    LIMITED_TIME_HELD,
    LIMITED_TIME_TRACKING,
    MOST_RIPPLE_CYCLES,
    TORQUE_LIMIT_GRID,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift, Path, Signals, TorqueLaw
from gapscope.effects.parametrisation import Grid
from gapscope.ident.signals.conditioning import Segment

LEAST_TRAVEL = 1e-6
"""Travel below which a joint stands still [rad]."""


def around(value: float, lowest: float, highest: float) -> np.ndarray:
    """Candidates about a value, in equal ratios."""
    return np.clip(value * np.geomspace(0.6, 1 / 0.6, 13), lowest, highest)


def search_nonlinear(
    term: Term,
    corrected: CorrectedArm,
    segments: list[Segment],
    scan: Scan,
    known: float | None,
    needed: Sequence[np.ndarray],
) -> NonlinearParameters:
    """The best nonlinear parameters of a joint effect's term; near ``known`` if it has been found before.

    ``needed`` is the torque that the arm predicts on the joint [N m], (N,) for each segment.

    Raises:
        KeyError: the effect has no nonlinear parameter on a joint.
    """
    j, effect = term.joint - 1, term.definition
    if effect.limits:
        return _saturation(j, segments, scan, known, needed)
    if isinstance(effect, Path):
        return _ripple(j, corrected, segments, scan, known)
    candidates = _candidates(term, segments, known)
    if isinstance(effect, Drift):
        return _drift(effect, candidates, j, corrected, segments, scan)
    assert isinstance(effect, TorqueLaw)
    columns = [
        _law_columns(effect, candidates, j, corrected, s, load)
        for s, load in zip(segments, needed, strict=True)
    ]
    return scan.best(candidates, scan.thin(columns))


def _candidates(term: Term, segments: list[Segment], known: float | None) -> np.ndarray:
    """Values of a term's nonlinear parameter to try: the effect's grid, or values about one that is known."""
    grid = term.parametrisation.grid
    if grid is None:
        raise KeyError(f"{term.effect} says no grid for its nonlinear parameter")
    unit = _grid_unit(grid, term.joint - 1, segments)
    if known is None:
        return unit * np.geomspace(grid.lowest, grid.highest, grid.points)
    lowest, highest = grid.bounds
    return around(known, unit * lowest, unit * highest)


def _grid_unit(grid: Grid, j: int, segments: list[Segment]) -> float:
    """What the values of a grid count in, in the parameter's own unit: 1, a time [s], or a speed [rad/s]."""
    if grid.unit == "duration":
        return max(float(s.motion.t[-1] - s.motion.t[0]) for s in segments)
    if grid.unit == "largest speed":
        speeds = [np.abs(s.motion.dq[:, j]) for s in segments]
        # a joint that never moves still needs a unit; nothing is found on it
        return max(float(np.quantile(np.concatenate(speeds), FASTEST)), 1e-3)
    return 1.0


def _law_columns(
    law: TorqueLaw,
    candidates: np.ndarray,
    j: int,
    arm: CorrectedArm,
    segment: Segment,
    load: np.ndarray,
) -> np.ndarray:
    """Torque of a law of unit amplitude on joint j, for each candidate of (K,) of its nonlinear parameter, (N, K)."""
    motion = segment.motion
    values = parametrisation_of(law).values(
        np.ones((1, len(candidates))), candidates[None]
    )
    signals = Signals(
        motion.t[:, None],
        arm.true_position(motion.q)[:, j, None],
        motion.dq[:, j, None],
        load[:, None],
    )
    return law.law(signals, *(values[name] for name in law.names))


def _drift(
    drift: Drift,
    times: np.ndarray,
    j: int,
    arm: CorrectedArm,
    segments: list[Segment],
    scan: Scan,
) -> NonlinearParameters:
    """The best time constant of a drift."""
    steady = tuple(e for e in arm.effects if not isinstance(e.effect, Drift))
    arm = replace(arm, effects=steady)
    smooth, series = _without_friction(arm), []
    for s in segments:
        motion, none = s.motion, np.zeros_like(s.motion.q)
        friction = arm.needed_torque(none, motion) - smooth.needed_torque(none, motion)
        since_start = (motion.t - motion.t[0])[:, None]
        change = drift.change(since_start, np.ones(len(times)), times)
        series.append(friction[:, j, None] * change)
    return scan.best(times, scan.thin(series))


def _without_friction(arm: CorrectedArm) -> CorrectedArm:
    """The same arm without any friction."""
    bare = replace(
        arm.arm, coulomb=0.0 * arm.arm.coulomb, viscous=0.0 * arm.arm.viscous
    )
    return CorrectedArm(
        bare, tuple(e for e in arm.effects if e.effect.family != "friction")
    )


def _ripple(
    j: int, arm: CorrectedArm, segments: list[Segment], scan: Scan, known: float | None
) -> NonlinearParameters:
    """Near a number of cycles that is known."""
    assert known is not None
    q = [arm.true_position(s.motion.q)[:, j, None] for s in segments]
    size = arm.arm.per_radian[j]
    step = cycle_step([x / size for x in q]) / size
    cycles = np.maximum(
        known + step * np.linspace(-0.6, 0.6, 9), LEAST_RIPPLE_CYCLES / size
    )
    return scan.best(cycles, scan.thin([waves(cycles, x) for x in q]), 2)


def cycle_step(q: Sequence[np.ndarray]) -> float:
    """Cycles per revolution that recordings of a joint's position [rad] can separate."""
    return 0.8 / max(max(float(np.ptp(x)) for x in q), 0.3)


def waves(cycles: np.ndarray, q: np.ndarray) -> np.ndarray:
    """sin n q and cos n q side by side for each n of (K,), shape (N, 2 K); q in rad, (N, 1)."""
    return np.stack([np.sin(cycles * q), np.cos(cycles * q)], axis=2).reshape(
        len(q), -1
    )


def ripple_candidates(q: Sequence[np.ndarray], dq: np.ndarray) -> np.ndarray:
    """Cycles per revolution to look for on a joint, as far as its slow motion keeps them within the filter's band."""
    speed = float(np.quantile(np.abs(dq), 0.3))
    # a joint that stands still shows no ripple; its columns are constant then, whatever the cycles
    travel = max(max(float(np.ptp(x)) for x in q), LEAST_TRAVEL)
    least = max(LEAST_RIPPLE_CYCLES, LEAST_RIPPLE_PERIODS * 2 * np.pi / travel)
    band = max(min(MOST_RIPPLE_CYCLES, 75.0 / max(speed, 1e-3)), 30.0)
    return np.arange(least, least + band, cycle_step(q))


def _saturation(
    j: int,
    segments: list[Segment],
    scan: Scan,
    known: float | None,
    needed: Sequence[np.ndarray],
) -> NonlinearParameters:
    """A limit that the torque seldom exceeds, while about the limit is needed; if there is none, the largest torque.

    Without the second, to call most of a torque lost would explain any gap.
    """
    torque = [s.torque[:, j, None] for s in segments if s.torque is not None]
    recorded = np.vstack(torque)[:, 0]
    largest = float(np.abs(recorded).max())
    if largest == 0:
        # any limit lets a torque of zero through
        return NonlinearParameters((1.0,), (1.0,))
    least = max(
        LEAST_TORQUE_LIMIT * largest,
        float(np.quantile(np.abs(recorded), 1.0 - LIMITED_TIME_HELD)),
    )
    limits = _limits(least, largest, known)
    limits = limits[_possible(limits, recorded, np.concatenate(needed))]
    none = NonlinearParameters((0.999 * largest,), (0.5 * largest,))
    if not len(limits):
        return none
    lost = [x - np.clip(x, -limits, limits) for x in torque]
    found = scan.best(limits, scan.thin(lost))
    # at the lowest limit the scan would go on to call even more of the torque lost
    return found if found.values[0] > 1.02 * least else none


def _limits(least: float, largest: float, known: float | None) -> np.ndarray:
    """Limits to try [N m]: about one that is known, or up to the largest torque in even steps and ratios."""
    if known is not None:
        return np.clip(known * np.linspace(0.9, 1.1, 21), least, 0.999 * largest)
    steps = np.linspace(least, 0.98 * largest, TORQUE_LIMIT_GRID)
    ratios = np.geomspace(least, 0.97 * largest, TORQUE_LIMIT_GRID)[1:]
    return np.sort([*steps, *ratios])


def _possible(
    limits: np.ndarray, recorded: np.ndarray, needed: np.ndarray
) -> np.ndarray:
    """Which limits the motion allows, (L,), by the torque recorded and the torque needed [N m], (N,) each."""
    beyond = np.abs(recorded)[:, None] > limits
    count = np.maximum(beyond.sum(axis=0), 1)
    # needed torque in the direction of the recorded one, while that exceeds the limit: mean and mean square
    along = np.sign(recorded) * needed
    mean = along @ beyond / count
    mean_square = along**2 @ beyond / count
    apart2 = mean_square - 2 * mean * limits + limits**2
    apart = np.sqrt(np.maximum(apart2, 0.0))
    seldom = beyond.mean(axis=0) < LIMITED_TIME_TRACKING
    held = apart < HELD_NEAR_LIMIT * limits
    return (mean > LEAST_NEED_AT_LIMIT * limits) & (seldom | held)
