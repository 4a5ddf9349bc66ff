"""Faults of the torque column alone that may be in a case: gravity left out, another unit, late.

A factor is looked for from where the nominal arm has it: with what friction and an offset explain taken out of both,
torque and nominal torque of a joint have variances whose ratio is the square of the factor.
"""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.setup_faults.candidates import FaultCandidate
from gapscope.diagnosis.setup_faults.channel_mapping import (
    ChannelMapping,
    late,
    rescaled,
    without_gravity,
)
from gapscope.diagnosis.setup_faults.nuisance import (
    COULOMB,
    OFFSET,
    VISCOUS,
    FoldEquations,
)
from gapscope.diagnosis.thresholds import (
    KNOWN_FACTOR_R2,
    OWN_UNIT_FACTOR,
    TORQUE_DELAY_STARTS,
    UNIT_FACTOR,
)

CURRENT, COMMAND_SCALE = "current", "command_scale"
"""Variants of ``torque_unit``: all joints, or some of them."""


def torque_column_candidates(
    eq: FoldEquations, mapping: ChannelMapping
) -> list[FaultCandidate]:
    """Faults of the torque column that may come on top of a mapping, given the equations under it."""
    n = len(eq.lowest_mass)
    candidates = unit_candidates(eq, mapping)
    has_weight = np.diag(eq.products.sum(axis=0))[n:].any()
    if not mapping.without_gravity and has_weight:
        candidates.append(gravity_compensated(n))
    # a delay is in recorded time, so that it is looked for only if that is right
    if mapping.torque_delay == 0.0 and mapping.time_factor == 1.0:
        candidates += [late_torque(n, delay) for delay in TORQUE_DELAY_STARTS]
    return candidates


def unit_candidates(eq: FoldEquations, mapping: ChannelMapping) -> list[FaultCandidate]:
    """Another unit of all joints if most are far from the nominal arm; else of those that are, and of each of these."""
    factors, known = factor_starts(eq, mapping)
    n, far = len(factors), known & _is_gross(factors)
    if known.any() and _is_gross(np.median(factors[known])):
        # a joint whose torque says nothing has the others' factor
        starts = np.where(known, factors, np.median(factors[known]))
        return [torque_unit(n, tuple(range(n)), tuple(starts.tolist()))]
    joints = tuple(np.flatnonzero(far).tolist())
    candidates = [torque_unit(n, (j,), (float(factors[j]),)) for j in joints]
    if len(joints) > 1:
        candidates.append(torque_unit(n, joints, tuple(factors[far].tolist())))
    return candidates


def without_right_joints(
    n: int, candidate: FaultCandidate, std: tuple[float, ...]
) -> tuple[FaultCandidate, tuple[float, ...]]:
    """A unit of those joints alone whose factor is not about one, with the deviations; the same if none or all are."""
    factors = np.array(candidate.values["factor"])
    off = np.abs(np.log(factors)) > np.log(OWN_UNIT_FACTOR)
    if off.all() or not off.any():
        return candidate, std
    joints = tuple((np.array(candidate.joints)[off] - 1).tolist())
    reduced = torque_unit(n, joints, tuple(factors[off].tolist()))
    return reduced, tuple(np.array(std)[off].tolist())


def factor_starts(
    eq: FoldEquations, mapping: ChannelMapping
) -> tuple[np.ndarray, np.ndarray]:
    """Nominal over read torque of each joint [1], (n,), and of which joints it is known, (n,)."""
    torque = eq.read(mapping)
    cross, square = torque.cross.sum(axis=0), torque.square.sum(axis=0)
    gram, n, shared = eq.gram.sum(axis=0), len(square), eq.shared
    nuisances = shared + np.array([COULOMB, VISCOUS, OFFSET])
    factors, explained = np.ones(n), np.zeros(n)
    for j in range(n):
        signals = np.empty((2, 2))
        signals[0] = square[j], cross[j, shared]
        signals[1] = cross[j, shared], gram[j, shared, shared]
        by_nuisance = np.stack([cross[j, nuisances], gram[j, nuisances, shared]])
        own = gram[j][np.ix_(nuisances, nuisances)]
        left = signals - by_nuisance @ np.linalg.pinv(own) @ by_nuisance.T
        recorded, nominal = np.maximum(np.diag(left), 0.0)
        if recorded > 0 and nominal > 0:
            factors[j] = np.sqrt(nominal / recorded)
            explained[j] = left[0, 1] ** 2 / (recorded * nominal)
    return factors, explained > KNOWN_FACTOR_R2


def is_ordinary(candidate: FaultCandidate) -> bool:
    """Whether a torque in another unit is near enough to N m for a constant that is off."""
    if candidate.name != "torque_unit":
        return False
    return not _is_gross(float(np.median(candidate.values["factor"])))


def torque_unit(
    n: int, joints: tuple[int, ...], factors: tuple[float, ...]
) -> FaultCandidate:
    """Torque of joints, from 0, in another unit, true torque over recorded value [1] of each."""
    return FaultCandidate(
        "torque_unit",
        tuple(j + 1 for j in joints),
        CURRENT if len(joints) == n else COMMAND_SCALE,
        rescaled(n, joints, factors),
        {"factor": factors},
    )


def gravity_compensated(n: int) -> FaultCandidate:
    """Gravity left out of all torques."""
    return FaultCandidate("gravity_compensated_torque", (), "", without_gravity(n))


def late_torque(n: int, delay: float) -> FaultCandidate:
    """All torques late by a delay [s]."""
    return FaultCandidate(
        "late_torque", (), "delay", late(n, delay), {"delay": (delay,)}
    )


def _is_gross(factor: np.ndarray | float) -> np.ndarray:
    return np.abs(np.log(factor)) > np.log(UNIT_FACTOR)
