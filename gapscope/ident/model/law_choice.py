"""Form of the friction and strength of the pull to the nominal arm, chosen by validation inside the fitted samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gapscope.ident.model.friction_law import (
    PRESLIDING_DISTANCES,
    STRIBECK_SPEEDS,
    FrictionLaw,
)
from gapscope.ident.signals.samples import Samples

FOLDS = 5
"""Least number of stretches of time, each predicted from all others."""
WORTH = 0.02
"""A friction law with more parameters must lower the error on held-out stretches by this share."""
EXCEEDED = 3.0
"""Every moving drive must be faster at times than a Stribeck speed by this factor."""
PULLS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Strengths of the pull to the nominal arm that are tried [1]."""
STRONGEST = 1e4
"""If the strongest of them predicts best, tenfold ones are tried up to this [1]."""
LOOSE = 1e-8
"""Pull on parameters of which the nominal arm says nothing, in units of their columns [1]."""


@dataclass(frozen=True)
class Choice:
    """What validation inside the fitted samples chose.

    Attributes:
        law: form of the dry friction.
        pull: weight of ((x - x0) / scale)^2 beside the mean square of the weighted residual [1].
        noise: RMS residual per joint [N m], shape (n,), the weights' inverse.
        tried: law and pull in words, with the error on held-out stretches [1]: RMS of residual over ``noise``.
    """

    law: FrictionLaw
    pull: float
    noise: np.ndarray
    tried: tuple[tuple[str, float], ...]


def choose(
    samples: Samples, *, stribeck: bool = True, presliding: bool = True
) -> Choice:
    """Choose the friction law, then the pull; the simpler wherever the richer is not worth it.

    Args:
        samples: what may be fitted.
        stribeck: whether a Stribeck term may be chosen.
        presliding: whether friction that keeps its direction at rest may be chosen.
    """
    law, pull = FrictionLaw(), PULLS[1]
    noise = joint_noise(samples, law, pull)
    best = unseen_error(samples, law, pull, noise)
    tried = [(f"{law}; pull {pull:g}", best)]
    for candidates, worth in _ladder(_speeds(samples) if stribeck else [], presliding):
        errors = {}
        for change in candidates:
            candidate = replace(law, **change)
            errors[candidate] = unseen_error(samples, candidate, pull, noise)
            tried.append((f"{candidate}; pull {pull:g}", errors[candidate]))
        winner = min(errors, key=lambda c: errors[c])
        if errors[winner] < (1 - worth) * best:
            law, best = winner, errors[winner]
    noise = joint_noise(samples, law, pull)
    by_pull = _errors_by_pull(samples, law, noise)
    tried += [(f"{law}; pull {value:g}", error) for value, error in by_pull.items()]
    pull = min(by_pull, key=lambda value: by_pull[value])
    return Choice(law, pull, joint_noise(samples, law, pull), tuple(tried))


def _errors_by_pull(
    samples: Samples, law: FrictionLaw, noise: np.ndarray
) -> dict[float, float]:
    """Error on held-out stretches by strength of the pull, beyond ``PULLS`` as long as a stronger one is better."""
    errors = {value: unseen_error(samples, law, value, noise) for value in PULLS}
    while min(errors, key=lambda value: errors[value]) == max(errors) < STRONGEST:
        errors[10 * max(errors)] = unseen_error(samples, law, 10 * max(errors), noise)
    return errors


def _speeds(samples: Samples) -> list[float]:
    """Stribeck speeds that every moving drive exceeds by far: what is not seen to end would be extrapolated wildly."""
    top = np.abs(samples.velocity @ samples.columns.drives.T).max(axis=0)
    moving = top[top > STRIBECK_SPEEDS[0]]
    return [
        speed
        for speed in STRIBECK_SPEEDS
        if len(moving) and EXCEEDED * speed <= moving.min()
    ]


def _ladder(
    speeds: list[float], presliding: bool
) -> Iterator[tuple[list[dict[str, float]], float]]:
    """Changes of the law to try, and by which share they have to lower the error: 0 without further parameters."""
    if speeds:
        yield [{"stribeck_speed": speed} for speed in speeds], WORTH
    if presliding:
        yield [{"presliding": distance} for distance in PRESLIDING_DISTANCES], 0.0


def penalties(
    samples: Samples, law: FrictionLaw, matrix: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Diagonal of the pull's quadratic form for pull 1 [1/x^2], shape (p,): 1 / scale^2, a trace elsewhere."""
    scale = samples.columns.scale(law)
    size = np.sqrt(
        (np.linalg.norm(matrix, axis=0) ** 2 / noise[:, None] ** 2).sum(axis=0)
        / len(matrix)
    )
    return np.where(
        np.isfinite(scale), scale**-2.0, LOOSE * np.where(size > 0, size, 1.0) ** 2
    )


def pulled_solution(
    gram: np.ndarray, rows: int, penalty: np.ndarray, nominal: np.ndarray
) -> np.ndarray:
    """Argmin |y - W x|^2 / noise^2 + rows (x - x0)^2 penalty, from the Gram matrix of [W, y]; shape (p,)."""
    normal, right = gram[:-1, :-1], gram[:-1, -1]
    unit = 1.0 / np.sqrt(np.diag(normal) + rows * penalty)
    system = (normal + rows * np.diag(penalty)) * unit[:, None] * unit
    change = np.linalg.solve(system, unit * (right - normal @ nominal))
    return nominal + unit * change


def joint_noise(
    samples: Samples, law: FrictionLaw, pull: float, rounds: int = 3
) -> np.ndarray:
    """RMS residual per joint of the pulled weighted fit [N m], shape (n,); never zero."""
    matrix, nominal = samples.matrix(law), samples.columns.nominal(law)
    noise = np.maximum(
        samples.torque.std(axis=0), 1e-6 * np.abs(samples.torque).max(initial=1e-9)
    )
    for _ in range(rounds):
        penalty = pull * penalties(samples, law, matrix, noise)
        x = pulled_solution(
            _gram(matrix, samples.torque, noise), samples.torque.size, penalty, nominal
        )
        left = np.sqrt(((samples.torque - matrix @ x) ** 2).mean(axis=0))
        noise = np.maximum(
            left, 1e-4 * np.sqrt((samples.torque**2).mean(axis=0)) + 1e-12
        )
    return noise


def unseen_error(
    samples: Samples, law: FrictionLaw, pull: float, noise: np.ndarray
) -> float:
    """RMS of residual over noise on stretches of time predicted from all others [1]."""
    matrix, nominal = samples.matrix(law), samples.columns.nominal(law)
    penalty = pull * penalties(samples, law, matrix, noise)
    stretches = _stretches(samples.group)
    grams = np.array([_gram(matrix[s], samples.torque[s], noise) for s in stretches])
    total, rows, squares, count = (
        grams.sum(axis=0),
        sum(samples.torque[s].size for s in stretches),
        0.0,
        0,
    )
    for s, gram in zip(stretches, grams, strict=True):
        size = samples.torque[s].size
        x = pulled_solution(total - gram, rows - size, penalty, nominal)
        squares += float((((samples.torque[s] - matrix[s] @ x) / noise) ** 2).sum())
        count += size
    return float(np.sqrt(squares / count))


def _gram(matrix: np.ndarray, torque: np.ndarray, noise: np.ndarray) -> np.ndarray:
    full = np.concatenate([matrix, torque[:, :, None]], axis=2) / noise[:, None]
    flat = full.reshape(-1, full.shape[2])
    return flat.T @ flat


def _stretches(group: np.ndarray) -> list[slice]:
    """Stretches of time within segments, at least ``FOLDS`` in all, of about equal length; two samples apart."""
    edges = np.flatnonzero(np.diff(np.r_[-1, group, group[-1] + 1]))
    length = max(20, len(group) // max(FOLDS, len(edges) - 1))
    out = []
    for a, b in pairwise(edges):
        cuts = np.linspace(a, b, max(1, round((b - a) / length)) + 1).astype(int)
        out += [slice(p + 1, q - 1) for p, q in pairwise(cuts) if q - p > 4]
    return out
