"""Continuous values of a setup fault, from the grid on which the search began to their most probable ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gapscope.diagnosis.setup_faults.candidates import (
    TURN,
    FaultCandidate,
    motor_side,
    wrong_rate,
    zero_offset,
)
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.mapping_score import MappingScorer
from gapscope.diagnosis.setup_faults.torque_column import (
    late_torque,
    torque_unit,
    without_right_joints,
)
from gapscope.diagnosis.thresholds import (
    DECIMAL_UNIT_ERROR,
    DECIMAL_UNITS,
    LEAST_ZERO_OFFSET,
    NARROW_NUISANCE_FACTOR,
    REFINE_FIRST_STEP,
    REFINE_LAST_STEP,
    UNIT_LAST_STEP,
    UNIT_NUISANCE_FACTOR,
)

CURVED = 0.02
"""Step over which the curvature is taken."""
SHRINK = 2.5
"""Factor by which the step shrinks when no value moves."""

Build = Callable[[np.ndarray], FaultCandidate]
"""A candidate from its values, or their logarithms."""


def refined(
    scorer: MappingScorer, before: ChannelMapping, candidate: FaultCandidate
) -> tuple[FaultCandidate, tuple[float, ...]]:
    """The candidate with its best values, and their standard deviations; itself if it has no continuous ones."""
    n = scorer.arm.n_joints
    joints = tuple(j - 1 for j in candidate.joints)
    if candidate.name == "late_torque":
        return _refined_one(
            scorer, before, candidate, lambda value: late_torque(n, value)
        )
    if candidate.variant == "wrong_rate":
        return _refined_one(
            scorer, before, candidate, lambda value: wrong_rate(n, value)
        )
    if candidate.name == "zero_offset":
        return _refined_zero(scorer, before, candidate)
    if candidate.name == "torque_unit":
        return without_right_joints(n, *_refined_unit(scorer, before, candidate))
    if candidate.variant == "motor_side":
        return _refined_by_joint(
            scorer, before, candidate, lambda values: motor_side(n, joints, values)
        )
    return candidate, ()


def _refined_one(
    scorer: MappingScorer,
    before: ChannelMapping,
    candidate: FaultCandidate,
    build: Callable[[float], FaultCandidate],
) -> tuple[FaultCandidate, tuple[float, ...]]:
    """A candidate with one value for the arm."""
    (start,) = candidate.values.values()
    search = _PatternSearch(scorer, before, lambda x: build(float(np.exp(x[0]))))
    return search.in_logarithms(search.minimum(np.log(start)))


def _refined_zero(
    scorer: MappingScorer, before: ChannelMapping, candidate: FaultCandidate
) -> tuple[FaultCandidate, tuple[float, ...]]:
    """A joint's zero to within its deviation; as it began if it ends at an angle too small for a fault."""
    n, joint = scorer.arm.n_joints, candidate.joints[0] - 1

    def build(x: np.ndarray) -> FaultCandidate:
        return zero_offset(n, joint, float(np.remainder(x[0] + np.pi, TURN) - np.pi))

    search = _PatternSearch(scorer, before, build)
    x = search.minimum(np.array(candidate.values["offset"]))
    found = build(x)
    if abs(found.values["offset"][0]) < LEAST_ZERO_OFFSET:
        return candidate, ()
    return found, tuple(search.deviation(x).tolist())


def _refined_by_joint(
    scorer: MappingScorer,
    before: ChannelMapping,
    candidate: FaultCandidate,
    build: Callable[[tuple[float, ...]], FaultCandidate],
) -> tuple[FaultCandidate, tuple[float, ...]]:
    """A candidate with a value for each of its joints: one for all, unless their own explain decisively more."""
    joints = len(candidate.joints)
    (start,) = candidate.values.values()

    def built(x: np.ndarray) -> FaultCandidate:
        return build(tuple(np.exp(np.broadcast_to(x, joints)).tolist()))

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
    scorer: MappingScorer, before: ChannelMapping, candidate: FaultCandidate
) -> tuple[FaultCandidate, tuple[float, ...]]:
    """A torque's unit: one factor for its joints, and of their own for those that it explains decisively less."""
    n = scorer.arm.n_joints
    joints = tuple(j - 1 for j in candidate.joints)
    starts = np.log(candidate.values["factor"])

    def search(groups: np.ndarray) -> _PatternSearch:
        """Over the factor of each group of joints."""

        def built(x: np.ndarray) -> FaultCandidate:
            return torque_unit(n, joints, tuple(np.exp(x[groups]).tolist()))

        return _PatternSearch(scorer, before, built, UNIT_NUISANCE_FACTOR)

    groups: np.ndarray = np.zeros(len(joints), dtype=int)
    x = search(groups).minimum(np.array([np.median(starts)]), UNIT_LAST_STEP)
    least = search(groups).cost(x)
    for j, start in enumerate(starts):
        alone = np.where(np.arange(len(joints)) == j, len(x), groups)
        # Bayesian information criterion, as above
        cost = search(alone).cost(np.append(x, start))
        if cost + 0.5 * np.log(search(groups).independent) < least:
            groups, x, least = alone, np.append(x, start), cost
    found = search(groups)
    x = found.minimum(x, UNIT_LAST_STEP)
    unit, std = found.in_logarithms(x)
    nearest = min(DECIMAL_UNITS, key=lambda decimal: abs(np.log(decimal) - x[0]))
    # how far a factor is from that of a unit is the arm's, which has a scale of its torque
    if len(x) == 1 and abs(x[0] - np.log(nearest)) < np.log(DECIMAL_UNIT_ERROR):
        return torque_unit(n, joints, (nearest,) * len(joints)), ()
    return unit, tuple(std[group] for group in groups)


class _PatternSearch:
    """The search for the most probable values x of a candidate, which are its own or their logarithms.

    Args:
        scorer: of mappings of the case.
        before: the mapping on top of which the candidate comes.
        build: the candidate with values x.
        spread: factor on what the arm may ordinarily have beyond its data sheet.
    """

    def __init__(
        self,
        scorer: MappingScorer,
        before: ChannelMapping,
        build: Build,
        spread: float = 1.0,
    ) -> None:
        self.scorer, self.before, self.build = scorer, before, build
        self.spread = spread
        self.independent = scorer.samples.weight * len(scorer.samples.q)

    def cost(self, x: np.ndarray) -> float:
        """Negative logarithm of the probability, up to a constant [nats]."""
        mapping = self.before.then(self.build(x).mapping)
        score = self.scorer.score(mapping, self.spread)
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

    def in_logarithms(self, x: np.ndarray) -> tuple[FaultCandidate, tuple[float, ...]]:
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
