"""Continuous values of a setup fault, from the grid on which the search began to their most probable ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gapscope.diagnosis.setup_faults.candidates import Candidate, motor_side, wrong_rate
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.mapping_score import MappingScorer
from gapscope.diagnosis.thresholds import (
    GEAR_RATIO_NUISANCE_FACTOR,
    REFINE_FIRST_STEP,
    REFINE_LAST_STEP,
)

CURVED = 0.02
"""Step over which the curvature is taken."""


Build = Callable[[np.ndarray], Candidate]
"""A candidate from the logarithms of its values."""


def refined(
    bench: MappingScorer, before: ChannelMapping, candidate: Candidate
) -> tuple[Candidate, tuple[float, ...]]:
    """The candidate with its best values, and their standard deviations; itself where it has no continuous ones."""
    n = bench.arm.n_joints
    if candidate.variant == "motor_side":
        return _ratios(bench, before, candidate)
    if candidate.variant == "wrong_rate":
        climb = _Climb(bench, before, lambda x: wrong_rate(n, float(np.exp(x[0]))))
        return climb.candidate(climb.least(np.log(candidate.values["amount"])))
    return candidate, ()


def _ratios(
    bench: MappingScorer, before: ChannelMapping, candidate: Candidate
) -> tuple[Candidate, tuple[float, ...]]:
    """Gear ratios of joints on their motor's side: one for all of them, unless their own explain decisively more."""
    n, joints = bench.arm.n_joints, tuple(j - 1 for j in candidate.joints)

    def build(x: np.ndarray) -> Candidate:
        return motor_side(
            n,
            joints,
            tuple(float(np.exp(value)) for value in np.broadcast_to(x, len(joints))),
        )

    wide, narrow = (
        _Climb(bench, before, build),
        _Climb(bench, before, build, GEAR_RATIO_NUISANCE_FACTOR),
    )
    own = narrow.least(wide.least(np.log(candidate.values["ratio"])))
    common = narrow.least(np.array([np.median(own)]))
    charge = 0.5 * (len(joints) - 1) * np.log(narrow.independent)
    if narrow.cost(common) > narrow.cost(own) + charge:
        return narrow.candidate(own)
    found, std = narrow.candidate(common)
    return found, std * len(joints)


class _Climb:
    """The search for the most probable values of a candidate, by the logarithms of its values.

    Args:
        bench: where it is judged.
        before: the reading on top of which it comes.
        build: the candidate with values.
        spread: factor on what the arm may ordinarily have beyond its data sheet.
    """

    def __init__(
        self,
        bench: MappingScorer,
        before: ChannelMapping,
        build: Build,
        spread: float = 1.0,
    ) -> None:
        self.bench, self.before, self.build, self.spread = bench, before, build, spread
        self.independent = bench.samples.weight * len(bench.samples.q)

    def cost(self, x: np.ndarray) -> float:
        """Negative logarithm of the probability, up to a constant [nats]."""
        score = self.bench.score(self.before.then(self.build(x).reading), self.spread)
        return (
            self.independent
            * float(np.log(np.sqrt((score.residual**2).mean(axis=0))).sum())
            + score.surprise
        )

    def least(self, x: np.ndarray) -> np.ndarray:
        """Where the cost is least, by a coordinate-wise pattern search."""
        step, least = REFINE_FIRST_STEP, self.cost(x)
        while step > REFINE_LAST_STEP:
            moved = False
            for k in range(len(x)):
                for sign in (1.0, -1.0):
                    trial = x + sign * step * (np.arange(len(x)) == k)
                    value = self.cost(trial)
                    if value < least - 1e-9:
                        x, least, moved = trial, value, True
                        break
            if not moved:
                step /= 2.5
        return x

    def candidate(self, x: np.ndarray) -> tuple[Candidate, tuple[float, ...]]:
        """The candidate with these values, and their standard deviations from the curvature of the cost."""
        out, least = np.empty(len(x)), self.cost(x)
        for k in range(len(x)):
            h = CURVED * (np.arange(len(x)) == k)
            curvature = (self.cost(x + h) - 2 * least + self.cost(x - h)) / CURVED**2
            out[k] = 1.0 / np.sqrt(max(curvature, 1.0))
        return self.build(x), tuple(float(s) for s in np.exp(x) * out)
