"""The search for shapes: parameters in which the torque is not linear, scanned over what they can be.

For each candidate of a shape the columns of its linear coordinates are projected on the residual gap of a joint when
everything that acts on that joint is taken out; the gain of a candidate is the sum of squares that its columns explain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.diagnosis.model.terms import Term, parametrisation_of
from gapscope.diagnosis.thresholds import (
    FORCE_WINDOW_BIN,
    HELD_NEAR_LIMIT,
    LEAST_FORCE_WINDOW,
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
from gapscope.ident.signals.conditioning import Segment


@dataclass(frozen=True)
class NonlinearParameters:
    """A shape found.

    Attributes:
        values: of the shape's parameters.
        std: their standard deviations, from the curvature of the gain.
    """

    values: tuple[float, ...]
    std: tuple[float, ...]


@dataclass(frozen=True)
class Scan:
    """The residual gap of a joint, and how columns are brought to its rows.

    Attributes:
        residual: what no column of the basis explains [N m], (M,).
        basis: orthonormal columns taken out of it, (M, K).
        thin: from series on the segments' grids to the rows: filtered, trimmed, decimated and weighed; takes one array
            (N, K) per segment and gives (M, K).
        noise: variance of the residual, counted per independent sample [N^2 m^2].
    """

    residual: np.ndarray
    basis: np.ndarray
    thin: Callable[[Sequence[np.ndarray]], np.ndarray]
    noise: float

    def left(self, series: np.ndarray) -> np.ndarray:
        """What the basis leaves of a series on the rows, (M,)."""
        return series - self.basis @ (self.basis.T @ series)

    def gains(self, columns: np.ndarray, per_candidate: int) -> np.ndarray:
        """Sum of squares explained by each candidate's columns, which stand side by side, (M, K per_candidate)."""
        size2 = (columns**2).sum(axis=0).reshape(-1, per_candidate)
        within = (self.basis.T @ columns).reshape(
            self.basis.shape[1], -1, per_candidate
        )
        x = columns.reshape(len(columns), -1, per_candidate)
        gram = np.einsum("mki,mkj->kij", x, x) - np.einsum(
            "mki,mkj->kij", within, within
        )
        right = (columns.T @ self.residual).reshape(-1, per_candidate)
        least = 1e-4 * size2.max(axis=1) + 1e-12
        gram += least[:, None, None] * np.eye(per_candidate)
        return np.einsum(
            "ki,ki->k", right, np.linalg.solve(gram, right[:, :, None])[:, :, 0]
        )

    def best(
        self, candidates: np.ndarray, columns: np.ndarray, per_candidate: int = 1
    ) -> NonlinearParameters:
        """The candidate, shape (K,), with the largest gain, refined by a parabola through its neighbours."""
        gains = self.gains(columns, per_candidate)
        k = int(np.argmax(gains))
        if (
            k in (0, len(candidates) - 1)
            or not np.diff(candidates[k - 1 : k + 2]).all()
        ):  # two at a bound
            return NonlinearParameters(
                (float(candidates[k]),), (float(np.ptp(candidates) / 2),)
            )
        curve = np.polyfit(candidates[k - 1 : k + 2], gains[k - 1 : k + 2], 2)
        if curve[0] >= 0:
            return NonlinearParameters(
                (float(candidates[k]),), (float(np.ptp(candidates[k - 1 : k + 2]) / 2),)
            )
        peak = float(
            np.clip(-curve[1] / (2 * curve[0]), candidates[k - 1], candidates[k + 1])
        )
        return NonlinearParameters((peak,), (float(np.sqrt(self.noise / -curve[0])),))


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
    """The best shape of a joint effect's term; near ``known``, if it has been found before.

    ``needed`` is the torque that the arm predicts on the joint [N m], (N,) for each segment.

    Raises:
        KeyError: the effect has no shape on a joint.
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
    if known is not None:
        return around(known, *grid.bounds)
    values = np.geomspace(grid.lowest, grid.highest, grid.points)
    if not grid.in_durations:
        return values
    return max(float(s.motion.t[-1] - s.motion.t[0]) for s in segments) * values


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
    arm, series = (
        replace(
            arm,
            effects=tuple(e for e in arm.effects if not isinstance(e.effect, Drift)),
        ),
        [],
    )
    for s in segments:
        motion, none = s.motion, np.zeros_like(s.motion.q)
        friction = (
            arm.needed_torque(none, motion)
            - _without_friction(arm).needed_torque(none, motion)
        )[:, j, None]
        since_start = (motion.t - motion.t[0])[:, None]
        change = drift.change(since_start, np.ones(len(times)), times)
        series.append(friction * change)
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
    cycles = np.maximum(
        known + cycle_step(q) * np.linspace(-0.6, 0.6, 9), LEAST_RIPPLE_CYCLES
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
    least = max(
        LEAST_RIPPLE_CYCLES,
        LEAST_RIPPLE_PERIODS * 2 * np.pi / max(float(np.ptp(x)) for x in q),
    )
    return np.arange(
        least,
        least + max(min(MOST_RIPPLE_CYCLES, 75.0 / max(speed, 1e-3)), 30.0),
        cycle_step(q),
    )


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
    u, need = np.vstack(torque)[:, 0], np.concatenate(needed)
    largest = float(np.abs(u).max())
    least = max(
        LEAST_TORQUE_LIMIT * largest,
        float(np.quantile(np.abs(u), 1.0 - LIMITED_TIME_HELD)),
    )
    limits = np.sort(
        [
            *np.linspace(least, 0.98 * largest, TORQUE_LIMIT_GRID),
            *np.geomspace(least, 0.97 * largest, TORQUE_LIMIT_GRID)[1:],
        ]
    )
    if known is not None:
        limits = np.clip(known * np.linspace(0.9, 1.1, 21), least, 0.999 * largest)
    beyond = np.abs(u)[:, None] > limits
    count, along = np.maximum(beyond.sum(axis=0), 1), np.sign(u) * need
    held = along @ beyond / count
    apart = np.sqrt(
        np.maximum(along**2 @ beyond / count - 2 * held * limits + limits**2, 0.0)
    )
    seldom = beyond.mean(axis=0) < LIMITED_TIME_TRACKING
    possible = (held > LEAST_NEED_AT_LIMIT * limits) & (
        seldom | (apart < HELD_NEAR_LIMIT * limits)
    )
    none = NonlinearParameters((0.999 * largest,), (0.5 * largest,))
    if not possible.any():
        return none
    limits = limits[possible]
    found = scan.best(
        limits, scan.thin([x - np.clip(x, -limits, limits) for x in torque])
    )
    return found if found.values[0] > 1.02 * least else none


def force_window(
    t: np.ndarray,
    residual: np.ndarray,
    force: np.ndarray,
    weight: np.ndarray,
    bases: Sequence[np.ndarray],
) -> NonlinearParameters | None:
    """The window of time in which a constant force explains most of the residual; ``None`` if none helps.

    Args:
        t: time of the rows since the start of their recording [s], (M,).
        residual: the residual gap of all joints [N m], (M, n).
        force: columns of a unit force on the same rows, (M, n, 3).
        weight: of the joints [1/(N m)^2], (n,).
        bases: per joint what was taken out of the residual, orthonormal columns, (M, K).
    """
    count = int(np.ceil((t.max() - t.min()) / FORCE_WINDOW_BIN))
    least = round(LEAST_FORCE_WINDOW / FORCE_WINDOW_BIN)
    if count <= least:
        return None
    place = np.minimum(((t - t.min()) / FORCE_WINDOW_BIN).astype(int), count - 1)
    gram: np.ndarray = np.zeros((count + 1, 3, 3))
    right: np.ndarray = np.zeros((count + 1, 3))
    np.add.at(gram, place + 1, np.einsum("mji,j,mjk->mik", force, weight, force))
    np.add.at(right, place + 1, np.einsum("mji,j,mj->mi", force, weight, residual))
    gram, right = gram.cumsum(axis=0), right.cumsum(axis=0)
    ridge = 1e-6 * np.trace(gram[-1]) / 3 * np.eye(3)
    starts, ends = np.triu_indices(count + 1, least)
    inside, pull = gram[ends] - gram[starts] + ridge, right[ends] - right[starts]
    for j, basis in enumerate(bases):
        within = np.zeros((count + 1, basis.shape[1], 3))
        np.add.at(within, place + 1, basis[:, :, None] * force[:, j, None, :])
        within = within.cumsum(axis=0)
        taken = within[ends] - within[starts]
        inside -= weight[j] * taken.transpose(0, 2, 1) @ taken
    gains = np.einsum(
        "wi,wi->w", pull, np.linalg.solve(inside, pull[:, :, None])[:, :, 0]
    )
    best = int(np.argmax(gains))
    start, end = (
        float(t.min() + FORCE_WINDOW_BIN * edge) for edge in (starts[best], ends[best])
    )
    return NonlinearParameters(
        (start, end), (FORCE_WINDOW_BIN / 2, FORCE_WINDOW_BIN / 2)
    )
