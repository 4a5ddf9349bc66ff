"""Measurements behind the troubleshooting table, each one number per joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import welch

from gapscope.arm.recording import Recording
from gapscope.ident.checks.fit_evidence import FitEvidence
from gapscope.ident.signals.conditioning import uniform
from gapscope.ident.signals.effective_samples import variance_inflation

SLOW = 0.1
"""A joint hardly moves below this share of its speed [1]."""
FLAT = 3
"""Equal samples in a row at a joint's largest torque that count as clipped."""


def time_offset(evidence: FitEvidence) -> tuple[np.ndarray, np.ndarray]:
    """How far the recorded torque lags behind the motion, and its standard deviation [s], each (n,).

    tau(t - T) = tau - T d tau / dt: the derivative of the fitted torque of each joint is a further column. If a
    joint hardly moves its friction jumps, or is held back as at rest, which looks like an offset: these samples do not
    count.
    """
    samples, base = evidence.samples, evidence.base
    speed = np.abs(samples.velocity)
    weight = (speed > SLOW * np.quantile(speed, 0.95, axis=0)) / evidence.choice.noise
    fitted = evidence.fitted
    rate = np.zeros_like(fitted)
    for g in np.unique(samples.group):
        rows = samples.group == g
        rate[rows] = np.gradient(fitted[rows], samples.interval, axis=0)
    n = fitted.shape[1]
    late = -rate[:, :, None] * np.eye(n)
    full = (
        np.concatenate([evidence.matrix[:, :, base.kept], late], axis=2)
        * weight[:, :, None]
    )
    flat, left = full.reshape(-1, full.shape[2]), ((samples.torque - fitted) * weight)
    size = np.linalg.norm(flat, axis=0)
    size = np.where(size > 0, size, 1.0)
    triangle = np.asarray(
        np.linalg.qr(np.column_stack([flat / size, left.ravel()]), mode="r")
    )
    inverse: np.ndarray = np.linalg.pinv(triangle[:-1, :-1], rcond=1e-9)
    solution, spread = inverse @ triangle[:-1, -1], np.sqrt((inverse**2).sum(axis=1))
    used = np.maximum((weight > 0).mean(axis=0), 1e-9)
    scale = np.sqrt(
        (left**2).mean(axis=0) / used * variance_inflation(left, samples.group)
    )
    return solution[-n:] / size[-n:], spread[-n:] / size[-n:] * scale


def acceleration_noise(recordings: Sequence[Recording], cutoff: float) -> np.ndarray:
    """RMS of the noise in ddq over the RMS of ddq, both below the cut-off [Hz]; shape (n,).

    The noise density of q is the median one in the upper half of the band; differentiating twice multiplies it by
    (2 pi f)^4.
    """
    return _spectral(recordings, cutoff)[0]


def speed_lost(recordings: Sequence[Recording], cutoff: float) -> np.ndarray:
    """Share of the power of dq that stands above its noise beyond the cut-off [1]; shape (n,)."""
    return _spectral(recordings, cutoff)[1]


def _spectral(
    recordings: Sequence[Recording], cutoff: float
) -> tuple[np.ndarray, np.ndarray]:
    noise, inside, outside, whole = (np.zeros(recordings[0].n_joints) for _ in range(4))
    for r in recordings:
        _, q = uniform(r.t, r.q, r.rate)
        slope = np.linspace(0, 1, len(q))[:, None] * (q[-1] - q[0])
        f, density = welch(
            q - slope,
            r.rate,
            nperseg=min(len(q), int(4 * r.rate)),
            axis=0,
            detrend="linear",
        )
        floor = np.median(density[f > r.rate / 4], axis=0)
        square, low = (2 * np.pi * f[:, None]) ** 2 * (f[1] - f[0]), f <= cutoff
        above = np.where(density > 10 * floor, density - floor, 0.0)
        noise += (square**2 * floor)[low].sum(axis=0)
        inside += (square**2 * density)[low].sum(axis=0)
        outside += (square * above)[~low].sum(axis=0)
        whole += (square * density)[low].sum(axis=0)
    return np.sqrt(noise / np.maximum(inside, 1e-300)), outside / np.maximum(
        whole + outside, 1e-300
    )


def clipped(recordings: Sequence[Recording], limit: np.ndarray | None) -> np.ndarray:
    """Share of the samples at which a joint's torque is at its limit [1], shape (n,).

    At 99 % of the limit [N m] if the data sheet has one; and in any case if the torque stays exactly at its
    largest or smallest value for several samples.
    """
    tau = [np.asarray(r.tau) for r in recordings if r.tau is not None]
    total = sum(len(x) for x in tau)
    out = np.zeros(tau[0].shape[1])
    for j in range(len(out)):
        high, low = max(x[:, j].max() for x in tau), min(x[:, j].min() for x in tau)
        for x in tau:
            at = np.isclose(x[:, j], high, rtol=1e-6) | np.isclose(
                x[:, j], low, rtol=1e-6
            )
            held = _in_runs(at)
            if limit is not None:
                held |= np.abs(x[:, j]) >= 0.99 * limit[j]
            out[j] += held.sum() / total
    return out


def _in_runs(at: np.ndarray) -> np.ndarray:
    """Samples that are part of at least ``FLAT`` in a row."""
    edges = np.flatnonzero(np.diff(np.r_[False, at, False].astype(int)))
    out = np.zeros(len(at), dtype=bool)
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        out[a:b] = b - a >= FLAT
    return out


def exchanged(explained: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """What is won when torques are given to other joints' motions, per joint that changes, and those joints from 1.

    Args:
        explained: share of the variance of the torque of joint j explained by the motion of joint i, rows i.
    """
    rows, columns = linear_sum_assignment(-explained)
    moved = np.flatnonzero(rows != columns)
    if not len(moved):
        return 0.0, ()
    won = float(
        (explained[rows, columns] - np.diag(explained)[columns])[moved].sum()
    ) / len(moved)
    return won, tuple(int(j) + 1 for j in moved)


def near_rest(evidence: FitEvidence) -> float:
    """Share by which a Stribeck term lowers the error on held-out stretches [1]."""
    plain: list[float] = []
    with_it: list[float] = []
    for law, error in evidence.choice.tried:
        if "direction kept" not in law:
            (with_it if "Stribeck" in law else plain).append(error)
    return 1 - min(with_it) / plain[0] if with_it else 0.0


def condition(evidence: FitEvidence) -> float:
    """Condition number of the base columns, scaled to unit norm [1]."""
    columns = evidence.matrix[:, :, evidence.base.kept].reshape(-1, evidence.base.count)
    return float(
        np.linalg.cond(
            np.linalg.qr(columns / np.linalg.norm(columns, axis=0), mode="r")
        )
    )
