"""Conditions under which a case is recorded, and their allocation over a set of cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

STRONG = ((3.0, 5.0), (5.0, 10.0), (10.0, 20.0))
"""Severity classes of the cases that count: ratio of the effect's own gap to the healthy twin's floor."""
WEAK = ((0.5, 1.0), (1.0, 2.0), (2.0, 3.0))
"""Severity classes of the ladder, for information."""


@dataclass(frozen=True)
class Conditions:
    """Conditions of one case.

    Attributes:
        robot: name of the arm.
        inertials_off: relative width of the errors of the nominal inertials [1].
        noise: factor on the encoders' noise [1].
        bare: whether the controller and its references stay unknown.
        loop_rate, rate: of the controller and of the recordings [Hz].
        recordings: how many may be used.
        duration: shortest and longest recording [s].
    """

    robot: str
    inertials_off: float = 0.0
    noise: float = 1.0
    bare: bool = False
    loop_rate: int = 1000
    rate: int = 500
    recordings: int = 3
    duration: tuple[float, float] = (8.0, 14.0)


@dataclass(frozen=True)
class CaseSpec:
    """What one case is to be.

    Attributes:
        kind: ``single``, ``pair``, ``triple``, ``outside``, ``healthy`` or ``ladder``, or ``recovery``.
        laws: names of the laws at work.
        severity: class that each effect's own gap over the floor is drawn from, or ``None``.
        conditions: its conditions.
    """

    kind: str
    laws: tuple[str, ...]
    severity: tuple[float, float] | None
    conditions: Conditions


def allocate(
    rng: np.random.Generator, count: int, options: Sequence[T], shares: Sequence[float]
) -> list[T]:
    """``count`` draws whose numbers follow the shares (largest remainder), shuffled."""
    exact = np.array(shares) / sum(shares) * count
    numbers = np.floor(exact).astype(int)
    # the largest remainders get one more; equal ones in an order that is drawn
    tie_break = 1e-6 * rng.random(len(exact))
    by_remainder = np.argsort(numbers - exact + tie_break)
    numbers[by_remainder[: count - numbers.sum()]] += 1
    order = rng.permutation(np.repeat(np.arange(len(options)), numbers))
    return [options[k] for k in order]


def draw_conditions(
    rng: np.random.Generator, count: int, options: dict[str, Any]
) -> list[Conditions]:
    """Conditions of ``count`` cases; see ``BlindPlan`` for the options."""
    robots = list(options["robots"])
    off, noisy, bare = (options[key] for key in ("inertials_off", "noisy", "bare"))
    # allocated in this order, so that a seed gives the same set
    robot = allocate(rng, count, robots, [1.0] * len(robots))
    is_off = allocate(rng, count, [True, False], [off, 1 - off])
    noise = allocate(rng, count, [3.0, 1.0], [noisy, 1 - noisy])
    is_bare = allocate(rng, count, [True, False], [bare, 1 - bare])
    loop_rate = allocate(rng, count, [1000, 500], [0.7, 0.3])
    rate = allocate(rng, count, [100, 250, 500, 1000], [0.15, 0.35, 0.3, 0.2])
    recordings = allocate(rng, count, [3, 4], [0.6, 0.4])
    width = rng.uniform(0.01, 0.1, count)
    return [
        Conditions(
            robot=robot[k],
            inertials_off=float(width[k]) if is_off[k] else 0.0,
            noise=noise[k],
            bare=is_bare[k],
            loop_rate=loop_rate[k],
            rate=min(rate[k], loop_rate[k]),
            recordings=recordings[k],
            duration=tuple(options["duration"]),
        )
        for k in range(count)
    ]
