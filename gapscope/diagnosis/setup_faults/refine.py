"""Continuous values of a setup fault, from the grid on which the search began to their most probable ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gapscope.arm.reading import Reading
from gapscope.diagnosis.setup_faults.candidates import TURN
from gapscope.diagnosis.setup_faults.reading_score import ReadingScorer
from gapscope.diagnosis.thresholds import (
    DECIMAL_UNIT_ERROR,
    DECIMAL_UNITS,
    LEAST_ZERO_OFFSET,
    NARROW_NUISANCE_FACTOR,
    OWN_UNIT_FACTOR,
    REFINE_FIRST_STEP,
    REFINE_LAST_STEP,
    UNIT_LAST_STEP,
    UNIT_NUISANCE_FACTOR,
)
from gapscope.effects.setup_faults.channel_faults import (
    UnitMismatch,
    ZeroOffset,
)
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.time_stamp_fault import TimeStamps
from gapscope.effects.setup_faults.torque_faults import LateTorque, TorqueUnit

CURVED = 0.02
"""Step over which the curvature is taken."""
SHRINK = 2.5
"""Factor by which the step shrinks when no value moves."""

Build = Callable[[np.ndarray], Fault]
"""A candidate from its values, or their logarithms."""


def refined(
    scorer: ReadingScorer, before: Reading, candidate: Fault
) -> tuple[Fault, tuple[float, ...]]:
    """The candidate with its best values, and their standard deviations; itself if it has no continuous ones."""
    match candidate:
        case ZeroOffset():
            return _refined_zero(scorer, before, candidate)
        case TorqueUnit():
            unit, std = _refined_unit(scorer, before, candidate)
            return _without_right_joints(unit, std, scorer.arm.n_joints)
        case UnitMismatch(variant="motor_side"):
            return _refined_by_joint(scorer, before, candidate)
        case LateTorque() | TimeStamps():
            (name,), (start,) = candidate.values(), candidate.values().values()

            def build(x: np.ndarray) -> Fault:
                value: dict[str, Any] = {name: float(np.exp(x[0]))}
                return replace(candidate, **value)

            search = _PatternSearch(scorer, before, build)
            return search.in_logarithms(search.minimum(np.log(start)))
    return candidate, ()


def _refined_zero(
    scorer: ReadingScorer, before: Reading, candidate: ZeroOffset
) -> tuple[Fault, tuple[float, ...]]:
    """A joint's zero to within its deviation; as it began if it ends at an angle too small for a fault."""

    def build(x: np.ndarray) -> Fault:
        offset = float(np.remainder(x[0] + np.pi, TURN) - np.pi)
        return replace(candidate, offset=offset)

    search = _PatternSearch(scorer, before, build)
    x = search.minimum(np.array(candidate.values()["offset"]))
    found = build(x)
    if abs(found.values()["offset"][0]) < LEAST_ZERO_OFFSET:
        return candidate, ()
    return found, tuple(search.deviation(x).tolist())


def _refined_by_joint(
    scorer: ReadingScorer, before: Reading, candidate: UnitMismatch
) -> tuple[Fault, tuple[float, ...]]:
    """Gear ratios: one for all joints, unless their own explain decisively more."""
    start = candidate.values()["ratio"]
    joints = len(start)

    def built(x: np.ndarray) -> Fault:
        ratio = tuple(np.exp(np.broadcast_to(x, joints)).tolist())
        return replace(candidate, ratio=ratio)

    wide = _PatternSearch(scorer, before, built)
    narrow = _PatternSearch(scorer, before, built, NARROW_NUISANCE_FACTOR)
    own = narrow.minimum(wide.minimum(np.log(start)))
    common = narrow.minimum(np.array([np.median(own)]))
    # Bayesian information criterion: half the logarithm of the samples for each value more
    charge = 0.5 * (joints - 1) * np.log(narrow.independent)
    if narrow.cost(common) > narrow.cost(own) + charge:
        return narrow.in_logarithms(own)
    found, std = narrow.in_logarithms(common)
    return found, std * joints


def _refined_unit(
    scorer: ReadingScorer, before: Reading, candidate: TorqueUnit
) -> tuple[TorqueUnit, tuple[float, ...]]:
    """A torque's unit: one factor for its joints, and of their own for those that it explains decisively less."""
    joints = len(candidate.joints)
    starts = np.log(candidate.values()["factor"])

    def unit(x: np.ndarray, groups: np.ndarray) -> TorqueUnit:
        return replace(candidate, factor=tuple(np.exp(x[groups]).tolist()))

    def search(groups: np.ndarray) -> _PatternSearch:
        """Over the factor of each group of joints."""
        return _PatternSearch(
            scorer, before, lambda x: unit(x, groups), UNIT_NUISANCE_FACTOR
        )

    groups: np.ndarray = np.zeros(joints, dtype=int)
    x = search(groups).minimum(np.array([np.median(starts)]), UNIT_LAST_STEP)
    least = search(groups).cost(x)
    for j, start in enumerate(starts):
        alone = np.where(np.arange(joints) == j, len(x), groups)
        # Bayesian information criterion, as above
        cost = search(alone).cost(np.append(x, start))
        if cost + 0.5 * np.log(search(groups).independent) < least:
            groups, x, least = alone, np.append(x, start), cost
    found = search(groups)
    x = found.minimum(x, UNIT_LAST_STEP)
    _, std = found.in_logarithms(x)
    nearest = min(DECIMAL_UNITS, key=lambda decimal: abs(np.log(decimal) - x[0]))
    # how far a factor is from that of a unit is the arm's, which has a scale of its torque
    if len(x) == 1 and abs(x[0] - np.log(nearest)) < np.log(DECIMAL_UNIT_ERROR):
        return replace(candidate, factor=(nearest,) * joints), ()
    return unit(x, groups), tuple(std[group] for group in groups)


def _without_right_joints(
    candidate: TorqueUnit, std: tuple[float, ...], n: int
) -> tuple[TorqueUnit, tuple[float, ...]]:
    """A unit of those joints alone whose factor is not about one, with the deviations; the same if none or all are."""
    factor = np.array(candidate.values()["factor"])
    off = np.abs(np.log(factor)) > np.log(OWN_UNIT_FACTOR)
    if off.all() or not off.any():
        return candidate, std
    reduced = TorqueUnit.of(np.array(candidate.joints)[off] - 1, factor[off], n)
    return reduced, tuple(np.array(std)[off].tolist())


class _PatternSearch:
    """The search for the most probable values x of a candidate, which are its own or their logarithms.

    Args:
        scorer: of readings of the case.
        before: the reading on top of which the candidate comes.
        build: the candidate with values x.
        spread: factor on what the arm may ordinarily have beyond its data sheet.
    """

    def __init__(
        self,
        scorer: ReadingScorer,
        before: Reading,
        build: Build,
        spread: float = 1.0,
    ) -> None:
        self.scorer, self.before, self.build = scorer, before, build
        self.spread = spread
        self.independent = scorer.samples.weight * len(scorer.samples.q)

    def cost(self, x: np.ndarray) -> float:
        """Negative logarithm of the probability, up to a constant [nats]."""
        reading = self.before.then(self.build(x).reading(self.scorer.arm.n_joints))
        score = self.scorer.score(reading, self.spread)
        return self.independent * float(np.log(score.joint_rms).sum()) + score.penalty

    def minimum(self, x: np.ndarray, last_step: float = REFINE_LAST_STEP) -> np.ndarray:
        """Values of least cost, by a coordinate-wise pattern search from x."""
        step = REFINE_FIRST_STEP
        least = self.cost(x)
        while step > last_step:
            moved = False
            for k in range(len(x)):
                for signed_step in (step, -step):
                    trial = x.copy()
                    trial[k] += signed_step
                    cost = self.cost(trial)
                    if cost < least - 1e-9:
                        x, least, moved = trial, cost, True
                        break
            if not moved:
                step /= SHRINK
        return x

    def in_logarithms(self, x: np.ndarray) -> tuple[Fault, tuple[float, ...]]:
        """The candidate whose values have the logarithms x, and their standard deviations."""
        std = np.exp(x) * self.deviation(x)
        return self.build(x), tuple(float(s) for s in std)

    def deviation(self, x: np.ndarray) -> np.ndarray:
        """Standard deviations of x, from the curvature of the cost, of the shape of x."""
        std = np.empty(len(x))
        least = self.cost(x)
        for k in range(len(x)):
            h = CURVED * (np.arange(len(x)) == k)
            curvature = (self.cost(x + h) - 2 * least + self.cost(x - h)) / CURVED**2
            std[k] = 1.0 / np.sqrt(max(curvature, 1.0))
        return std
