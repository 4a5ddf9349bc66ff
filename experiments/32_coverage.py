"""Coverage of 95 % intervals of parameters under coloured noise, by method.

    .venv/bin/python experiments/32_coverage.py --runs 200

A linear problem like that of an arm: 2 or 3 joints on Fourier motions (0.1 Hz, five harmonics, 50 Hz sampling), columns
of acceleration, speed, tanh(speed / 0.05), a constant, and gravity that acts on all joints before its own. Noise of
each joint is AR(1), x_i = rho x_{i-1} + e_i, or white noise through a low-pass; joints differ in its size. Estimates
are weighted least squares. Methods: s^2 (W^T W)^-1; the sandwich with Student's t; the same with the critical values of
Bartlett's window at a fixed share of the samples (kiefer2005); the sandwich of scores prewhitened by AR(1)
(andrews1992); and the block jackknife, which `gapscope identify` uses.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.signal import lfilter

from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.uncertainty.intervals import (
    bartlett_sum,
    block_jackknife,
    block_length,
    plain,
    sandwich,
)
from gapscope.model.conditioning import low_pass

RATE = 50.0
"""Of the samples [Hz]."""
SIZES = ((2, 500, 1), (2, 1500, 1), (3, 1500, 3), (3, 4000, 2))
"""Joints, samples in all, recordings."""
SETTLING = 200
"""Samples of noise that are left out at its ends."""

Noise = Callable[[np.random.Generator, int, int], np.ndarray]
Ends = tuple[np.ndarray, np.ndarray]


def autoregressive(rho: float) -> Noise:
    """AR(1) noise of unit variance."""

    def draw(rng: np.random.Generator, samples: int, joints: int) -> np.ndarray:
        white = rng.standard_normal((samples + SETTLING, joints))
        series = lfilter([1.0], [1.0, -rho], white, axis=0)[SETTLING:]
        return np.asarray(series) * np.sqrt(1 - rho**2)

    return draw


def filtered(cutoff: float) -> Noise:
    """White noise through the low-pass of the signal conditioning [Hz], of unit variance."""

    def draw(rng: np.random.Generator, samples: int, joints: int) -> np.ndarray:
        white = rng.standard_normal((samples + 2 * SETTLING, joints))
        series = low_pass(white, RATE, cutoff)[SETTLING:-SETTLING]
        return series / series.std()

    return draw


NOISES: dict[str, Noise] = {
    "white": autoregressive(0.0),
    "AR(1) 0.5": autoregressive(0.5),
    "AR(1) 0.8": autoregressive(0.8),
    "AR(1) 0.95": autoregressive(0.95),
    "low-pass 5 Hz": filtered(5.0),
}


def regressor(rng: np.random.Generator, samples: int, joints: int) -> np.ndarray:
    """W of one recording, shape (samples, joints, 6 joints)."""
    speeds = 2 * np.pi * 0.1 * np.arange(1, 6)
    shares = np.arange(1, 6)[:, None]
    a, b = rng.standard_normal((2, 5, joints)) / shares
    phase = np.arange(samples)[:, None] / RATE * speeds
    sine, cosine = np.sin(phase), np.cos(phase)
    q = cosine @ a + sine @ b
    dq = (cosine * speeds) @ b - (sine * speeds) @ a
    ddq = -(cosine * speeds**2) @ a - (sine * speeds**2) @ b
    posture = np.cumsum(q, axis=1)
    out = np.zeros((samples, joints, joints, 6))
    for j in range(joints):
        own = (ddq[:, j], dq[:, j], np.tanh(dq[:, j] / 0.05), np.ones(samples))
        out[:, j, j, :4] = np.stack(own, axis=1)
        # a body's gravity is felt by its own joint and those before
        gravity = np.stack([np.cos(posture[:, j]), np.sin(posture[:, j])], axis=1)
        out[:, : j + 1, j, 4:] = gravity[:, None]
    return out.reshape(samples, joints, 6 * joints)


def drawn(
    seed: int, size: tuple[int, int, int], noise: Noise
) -> tuple[Problem, np.ndarray]:
    """A problem and its true parameters."""
    rng = np.random.default_rng(seed)
    joints, samples, recordings = size
    each = samples // recordings
    W = np.concatenate([regressor(rng, each, joints) for _ in range(recordings)])
    errors = np.concatenate([noise(rng, each, joints) for _ in range(recordings)])
    truth = rng.standard_normal(W.shape[2])
    torque = W @ truth + errors * np.linspace(1.0, 0.3, joints)
    names = tuple(f"x{k}" for k in range(len(truth)))
    group = np.repeat(np.arange(recordings), each)
    return Problem(W, torque, names, group, 1 / RATE), truth


def fixed_b(problem: Problem, beta: np.ndarray, weight: np.ndarray) -> Ends:
    """The sandwich with critical values for a window of a fixed share of the samples. Source: kiefer2005."""
    found = sandwich(problem, beta, weight)
    share = found.length / len(problem.torque)
    critical = np.polyval([-0.5324, 0.4160, 2.9694, 1.9600], share)
    half = critical * found.deviation
    return beta - half, beta + half


def prewhitened(problem: Problem, beta: np.ndarray, weight: np.ndarray) -> Ends:
    """The sandwich with each parameter's scores whitened by AR(1) and recoloured. Source: andrews1992."""
    scores = np.einsum("ijb,ij->ib", weight @ problem.matrix, problem.residual(beta))
    together = (problem.group[1:] == problem.group[:-1])[:, None]
    before, after = scores[:-1] * together, scores[1:] * together
    rho = (before * after).sum(axis=0) / (before**2).sum(axis=0)
    rho = rho.clip(-0.97, 0.97)
    white = scores.copy()
    white[1:] -= rho * before
    length = block_length(white, problem.group)
    recolour = np.outer(1 / (1 - rho), 1 / (1 - rho))
    meat = recolour * bartlett_sum(white, problem.group, length)
    gram = np.einsum("ija,jk,ikb->ab", problem.matrix, weight, problem.matrix)
    inverse = np.linalg.inv(gram)
    found = sandwich(problem, beta, weight, length)
    equations = problem.torque.size
    covariance = inverse @ meat @ inverse * equations / (equations - len(beta))
    return replace(found, covariance=covariance).interval(beta)


def ends(problem: Problem) -> dict[str, Ends]:
    """Lower and upper ends of the intervals, by method."""
    estimate = WeightedLeastSquares().estimate(problem)
    beta, weight = estimate.value, np.diag(estimate.residual**-2)
    return {
        "plain formula": plain(estimate, problem).interval(beta),
        "sandwich": sandwich(problem, beta, weight).interval(beta),
        "fixed-b": fixed_b(problem, beta, weight),
        "prewhitened": prewhitened(problem, beta, weight),
        "block jackknife": block_jackknife(problem, beta, weight).interval(beta),
    }


def coverage(size: tuple[int, int, int], noise: Noise, runs: int) -> dict[str, float]:
    """Share of parameters within their intervals, by method."""
    hits: dict[str, list[float]] = {}
    for seed in range(runs):
        problem, truth = drawn(seed, size, noise)
        for name, (lower, upper) in ends(problem).items():
            inside = (lower <= truth) & (truth <= upper)
            hits.setdefault(name, []).append(float(inside.mean()))
    return {name: float(np.mean(shares)) for name, shares in hits.items()}


def main() -> None:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    runs = parser.parse_args().runs
    cells = [(name, size) for name in NOISES for size in SIZES]
    rows = []
    console = Console(stderr=True)
    for name, size in track(cells, description="coverage", console=console):
        joints, samples, recordings = size
        shares = coverage(size, NOISES[name], runs)
        label = f"{name}, {joints} joints, {recordings} x {samples // recordings}"
        rows.append([label, *(f"{100 * share:.1f}" for share in shares.values())])
    head = ["noise, joints, samples", *shares]
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
