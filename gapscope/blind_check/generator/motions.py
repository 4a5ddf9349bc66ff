"""Motions that excite an arm: sums of sines slow and fast, point to point, crawl; at rest at both ends."""

from __future__ import annotations

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.blind_check.generator.arms import Arm

KINDS = ("slow", "middle", "fast", "point_to_point", "crawl")
"""Names of the kinds of motion."""
_BANDS = {"slow": (0.09, 0.55, 5), "middle": (0.1, 1.6, 7), "crawl": (0.03, 0.25, 3)}
"""Lowest and highest frequency [Hz] and number of sines per joint."""

Series = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Position [rad], velocity [rad/s] and acceleration [rad/s^2], each (N, n)."""


def draw_motion(
    kind: str, arm: Arm, duration: float, rate: float, rng: np.random.Generator
) -> Motion:
    """A motion of one kind, within the arm's range, sampled at the controller's rate [Hz]."""
    t = np.arange(round(duration * rate)) / rate
    top = rng.uniform(1.2, 1.8) * rng.uniform(0.85, 1.0, arm.n)
    if kind == "point_to_point":
        return _about(arm.home, t, _points(arm, t, top, rng))
    if kind == "fast":
        series = _fast(arm, t, top, rng)
    else:
        low, high, count = _BANDS[kind]
        # drawn for every kind, so that a seed gives the same draws whatever the kind
        slow_share = float(rng.uniform(0.6, 1.0))
        share = {"crawl": 0.2, "slow": slow_share, "middle": 1.0}[kind]
        series = _sines(t, (low, high), count, share * top, rng)
        series = _within(series, arm.half)
    return _about(arm.home, t, _faded(t, series))


def _about(home: np.ndarray, t: np.ndarray, series: Series) -> Motion:
    """A motion about a posture [rad], (n,)."""
    q, dq, ddq = series
    return Motion(t, home + q, dq, ddq)


def _fast(arm: Arm, t: np.ndarray, top: np.ndarray, rng: np.random.Generator) -> Series:
    """Slow sines through the range, and fast ones on top of them."""
    slow = _within(_sines(t, (0.09, 0.5), 4, 0.6 * top, rng), 0.9 * arm.half)
    fast = _sines(t, (3.0, 7.5), 4, 0.4 * top, rng)
    return slow[0] + fast[0], slow[1] + fast[1], slow[2] + fast[2]


def _sines(
    t: np.ndarray,
    band: tuple[float, float],
    count: int,
    top: np.ndarray,
    rng: np.random.Generator,
) -> Series:
    """Sums of sines whose speed peaks at ``top`` [rad/s]; q, dq, ddq of shape (N, n)."""
    q, dq, ddq = np.empty((3, len(t), len(top)))
    for joint, peak in enumerate(top):
        w = 2 * np.pi * np.sort(rng.uniform(*band, count))
        phase = rng.uniform(0, 2 * np.pi, count)
        size = rng.uniform(0.4, 1.0, count)
        angle = np.outer(t, w) + phase
        speed = np.sin(angle) @ size
        scale = peak / np.abs(speed).max()
        q[:, joint] = scale * (-(np.cos(angle) / w) @ size)
        dq[:, joint] = scale * speed
        ddq[:, joint] = scale * ((np.cos(angle) * w) @ size)
    return q, dq, ddq


def _within(series: Series, half: np.ndarray) -> Series:
    """A motion moved to the middle and shrunk to its range [rad]."""
    q, dq, ddq = series
    middle = (q.max(axis=0) + q.min(axis=0)) / 2
    span = np.maximum(np.ptp(q, axis=0), 1e-9)
    shrink = np.minimum(1.0, 2 * half / span)
    return (q - middle) * shrink, dq * shrink, ddq * shrink


def _faded(t: np.ndarray, series: Series, ramp: float = 1.0) -> Series:
    """The motion times an envelope e that rises from 0 and falls back to it within ``ramp`` [s]; product rule."""
    q, dq, ddq = series
    rise, rise_rate, rise_curve = _quintic(t, ramp)
    fall, fall_rate, fall_curve = _quintic(t[-1] - t, ramp)
    e = (rise * fall)[:, None]
    de = (rise_rate * fall - fall_rate * rise)[:, None]
    # the flanks never overlap, so that the mixed term of the product is zero
    dde = (rise_curve * fall + fall_curve * rise)[:, None]
    return e * q, de * q + e * dq, dde * q + 2 * de * dq + e * ddq


def _quintic(
    t: np.ndarray, duration: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """10 x^3 - 15 x^4 + 6 x^5 with its derivatives by time, x = t / duration in 0..1 [biagiotti2008]."""
    x = np.clip(t / duration, 0.0, 1.0)
    value = x**3 * (10 - 15 * x + 6 * x**2)
    rate = x**2 * (30 - 60 * x + 30 * x**2) / duration
    curve = x * (60 - 180 * x + 120 * x**2) / duration**2
    return value, rate, curve


def _points(
    arm: Arm, t: np.ndarray, top: np.ndarray, rng: np.random.Generator
) -> Series:
    """From posture to posture, with short rests; starts in the home posture."""
    q, dq, ddq = np.zeros((3, len(t), arm.n))
    now, here = 0.2, np.zeros(arm.n)
    while now < t[-1]:
        goal = rng.uniform(-1, 1, arm.n) * arm.half
        way = goal - here
        # 1.875 is the peak speed of the quintic over its mean speed
        takes = max(1.2, float((1.875 * np.abs(way) / top).max()))
        rows = t >= now
        s, ds, dds = _quintic(t[rows] - now, takes)
        q[rows] = here + s[:, None] * way
        dq[rows] = ds[:, None] * way
        ddq[rows] = dds[:, None] * way
        here = goal
        now = now + takes + float(rng.uniform(0.1, 0.5))
    return q, dq, ddq
