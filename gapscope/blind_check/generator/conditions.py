"""Under what conditions a case is recorded, and how they are dealt over a set of cases."""

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
        kind: ``single``, ``pair``, ``triple``, ``outside``, ``healthy`` or ``ladder``.
        laws: names of the laws at work.
        severity: class that each effect's own gap over the floor is drawn from, or ``None``.
        conditions: its conditions.
    """

    kind: str
    laws: tuple[str, ...]
    severity: tuple[float, float] | None
    conditions: Conditions


def deal(
    rng: np.random.Generator, count: int, options: Sequence[T], shares: Sequence[float]
) -> list[T]:
    """``count`` draws whose numbers follow the shares (largest remainder), shuffled."""
    exact = np.array(shares) / sum(shares) * count
    numbers = np.floor(exact).astype(int)
    rest = np.argsort(numbers - exact + 1e-6 * rng.random(len(exact)))[
        : count - numbers.sum()
    ]
    numbers[rest] += 1
    return [
        options[k] for k in rng.permutation(np.repeat(np.arange(len(options)), numbers))
    ]


def deal_conditions(
    rng: np.random.Generator, count: int, options: dict[str, Any]
) -> list[Conditions]:
    """Conditions of ``count`` cases; see ``BlindPlan`` for the options."""
    robots = list(options["robots"])
    columns = zip(
        deal(rng, count, robots, [1.0] * len(robots)),
        deal(
            rng,
            count,
            [True, False],
            [options["inertials_off"], 1 - options["inertials_off"]],
        ),
        deal(rng, count, [3.0, 1.0], [options["noisy"], 1 - options["noisy"]]),
        deal(rng, count, [True, False], [options["bare"], 1 - options["bare"]]),
        deal(rng, count, [1000, 500], [0.7, 0.3]),
        deal(rng, count, [100, 250, 500, 1000], [0.15, 0.35, 0.3, 0.2]),
        deal(rng, count, [3, 4], [0.6, 0.4]),
        rng.uniform(0.01, 0.1, count),
        strict=True,
    )
    return [
        Conditions(
            robot,
            float(width) if off else 0.0,
            noise,
            bare,
            loop_rate,
            min(rate, loop_rate),
            recordings,
            tuple(options["duration"]),
        )
        for robot, off, noise, bare, loop_rate, rate, recordings, width in columns
    ]
