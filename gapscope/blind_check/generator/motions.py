"""Motions that excite an arm: sums of sines slow and fast, point to point, crawl; at rest at both ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.blind_check.generator.arms import Arm

KINDS = ("slow", "middle", "fast", "point_to_point", "crawl")
"""Names of the kinds of motion."""
_BANDS = {"slow": (0.09, 0.55, 5), "middle": (0.1, 1.6, 7), "crawl": (0.03, 0.25, 3)}
"""Lowest and highest frequency [Hz] and number of sines per joint."""


@dataclass(frozen=True)
class Motion:
    """A reference motion: t [s] (N,); q [rad], dq [rad/s], ddq [rad/s^2] of shape (N, n)."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


def draw_motion(
    kind: str, arm: Arm, duration: float, rate: float, rng: np.random.Generator
) -> Motion:
    """A motion of one kind, within the arm's range, sampled at the controller's rate [Hz]."""
    t = np.arange(round(duration * rate)) / rate
    top = rng.uniform(1.2, 1.8) * rng.uniform(0.85, 1.0, arm.n)
    if kind == "point_to_point":
        return _added(arm.home, t, _points(arm, t, top, rng))
    if kind == "fast":
        base = _within(_sines(t, (0.09, 0.5), 4, 0.6 * top, rng), 0.9 * arm.half)
        above = _sines(t, (3.0, 7.5), 4, 0.4 * top, rng)
        way = tuple(b + a for b, a in zip(base, above, strict=True))
    else:
        low, high, count = _BANDS[kind]
        share = {"crawl": 0.2, "slow": float(rng.uniform(0.6, 1.0)), "middle": 1.0}[
            kind
        ]
        way = _within(_sines(t, (low, high), count, share * top, rng), arm.half)
    return _added(arm.home, t, _faded(t, way))


def _added(home: np.ndarray, t: np.ndarray, way: tuple[np.ndarray, ...]) -> Motion:
    return Motion(t, home + way[0], way[1], way[2])


def _sines(
    t: np.ndarray,
    band: tuple[float, float],
    count: int,
    top: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, ...]:
    """Sums of sines whose speed peaks at ``top`` [rad/s]; q, dq, ddq of shape (N, n)."""
    out: tuple[list[np.ndarray], ...] = ([], [], [])
    for peak in top:
        w = 2 * np.pi * np.sort(rng.uniform(*band, count))
        phase, size = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.4, 1.0, count)
        angle = np.outer(t, w) + phase
        speed = np.sin(angle) @ size
        scale = peak / np.abs(speed).max()
        for series, values in zip(
            out,
            (-(np.cos(angle) / w) @ size, speed, (np.cos(angle) * w) @ size),
            strict=True,
        ):
            series.append(scale * values)
    return tuple(np.stack(series, axis=1) for series in out)


def _within(way: tuple[np.ndarray, ...], half: np.ndarray) -> tuple[np.ndarray, ...]:
    """A motion moved to the middle and shrunk to its range [rad]."""
    q = way[0]
    shrink = np.minimum(1.0, 2 * half / np.maximum(np.ptp(q, axis=0), 1e-9))
    return (
        (q - (q.max(axis=0) + q.min(axis=0)) / 2) * shrink,
        way[1] * shrink,
        way[2] * shrink,
    )


def _faded(
    t: np.ndarray, way: tuple[np.ndarray, ...], ramp: float = 1.0
) -> tuple[np.ndarray, ...]:
    """The motion times a quintic that rises from 0 and falls back to it within ``ramp`` [s]; product rule."""
    q, dq, ddq = way
    rise, fall = (_quintic(x, ramp) for x in (t, t[-1] - t))
    e = rise[0] * fall[0]
    de, dde = (
        rise[1] * fall[0] - fall[1] * rise[0],
        rise[2] * fall[0] + fall[2] * rise[0],
    )
    e, de, dde = e[:, None], de[:, None], dde[:, None]
    return e * q, de * q + e * dq, dde * q + 2 * de * dq + e * ddq


def _quintic(
    t: np.ndarray, duration: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """10 x^3 - 15 x^4 + 6 x^5 with its derivatives by time, x = t / duration in 0..1 [biagiotti2008]."""
    x = np.clip(t / duration, 0.0, 1.0)
    return (
        x**3 * (10 - 15 * x + 6 * x**2),
        x**2 * (30 - 60 * x + 30 * x**2) / duration,
        x * (60 - 180 * x + 120 * x**2) / duration**2,
    )


def _points(
    arm: Arm, t: np.ndarray, top: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """From posture to posture, with short rests; starts in the home posture."""
    q, dq, ddq = (np.zeros((len(t), arm.n)) for _ in range(3))
    now, here = 0.2, np.zeros(arm.n)
    while now < t[-1]:
        goal = rng.uniform(-1, 1, arm.n) * arm.half
        takes = max(1.2, float((1.875 * np.abs(goal - here) / top).max()))
        rows = t >= now
        s, ds, dds = (x[:, None] for x in _quintic(t[rows] - now, takes))
        q[rows], dq[rows], ddq[rows] = (
            here + s * (goal - here),
            ds * (goal - here),
            dds * (goal - here),
        )
        now, here = now + takes + float(rng.uniform(0.1, 0.5)), goal
    return q, dq, ddq
