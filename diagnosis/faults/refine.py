"""Continuous values of a setup fault, from the grid on which the search began to their most probable ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from diagnosis.faults.candidates import Candidate, motor_side, wrong_rate
from diagnosis.faults.compare import Bench
from diagnosis.faults.readings import Reading

FIRST = 0.1
"""First step of the logarithm of a value."""
LAST = 0.003
"""Step at which refining ends."""
CURVED = 0.02
"""Step over which the curvature is taken."""

Build = Callable[[np.ndarray], Candidate]
"""A candidate from the logarithms of its values."""


def refined(bench: Bench, before: Reading, candidate: Candidate) -> tuple[Candidate, tuple[float, ...]]:
    """The candidate with its best values, and their standard deviations; itself where it has no continuous ones."""
    n = bench.arm.n_joints
    if candidate.variant == "motor_side":
        joints = tuple(j - 1 for j in candidate.joints)
        return _climb(
            bench, before, candidate.values["ratio"], lambda x: motor_side(n, joints, tuple(map(float, np.exp(x))))
        )
    if candidate.variant == "wrong_rate":
        return _climb(bench, before, candidate.values["amount"], lambda x: wrong_rate(n, float(np.exp(x[0]))))
    return candidate, ()


def _climb(
    bench: Bench, before: Reading, start: tuple[float, ...], build: Build
) -> tuple[Candidate, tuple[float, ...]]:
    """Coordinate-wise pattern search for the least cost in the logarithms of the values."""
    n_independent = bench.samples.weight * len(bench.samples.q)

    def cost(x: np.ndarray) -> float:
        score = bench.score(before.then(build(x).reading))
        return n_independent * float(np.log(np.sqrt((score.residual**2).mean(axis=0))).sum()) + score.surprise

    x, step = np.log(np.array(start)), FIRST
    least = cost(x)
    while step > LAST:
        moved = False
        for k in range(len(x)):
            for sign in (1.0, -1.0):
                trial = x + sign * step * (np.arange(len(x)) == k)
                value = cost(trial)
                if value < least - 1e-9:
                    x, least, moved = trial, value, True
                    break
        if not moved:
            step /= 2.5
    return build(x), tuple(float(s) for s in np.exp(x) * _deviations(cost, x, least))


def _deviations(cost: Callable[[np.ndarray], float], x: np.ndarray, least: float) -> np.ndarray:
    """Standard deviations of the logarithms from the curvature of the cost, shape of x."""
    out = np.empty(len(x))
    for k in range(len(x)):
        h = CURVED * (np.arange(len(x)) == k)
        curvature = (cost(x + h) - 2 * least + cost(x - h)) / CURVED**2
        out[k] = 1.0 / np.sqrt(max(curvature, 1.0))
    return out
