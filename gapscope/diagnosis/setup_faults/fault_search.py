"""The search for a fault of the set-up: scores of readings, and their refinement."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.reading import Reading
from gapscope.diagnosis.setup_faults.clocks import rate_error
from gapscope.diagnosis.setup_faults.found_fault import (
    TURN,
    TURNED_BASES,
    FoundFault,
    TurnedBase,
    joints_beyond_range,
    look_at,
)
from gapscope.diagnosis.thresholds import (
    DECIMAL_UNIT_ERROR,
    DECIMAL_UNITS,
    FAULT_COARSE_STEP,
    FAULT_FINALISTS,
    LATE_JOINT_LOSS,
    MIN_ZERO_OFFSET,
    OBVIOUS_FAULT_PROBABILITY,
    OWN_UNIT_FACTOR,
    REFINE_FIRST_STEP,
    REFINE_LAST_STEP,
)
from gapscope.effects.setup_faults import (
    FAULTS,
    TORQUE_DELAY_STARTS,
    Fault,
    LateTorque,
    SignFlip,
    TimeStamps,
    TorqueUnit,
    UnitMismatch,
    ZeroOffset,
)
from gapscope.model.conditioning import condition
from gapscope.model.readings import UNUSUAL, ReadingScorer, sample

# Continuous values of a setup fault, from the grid on which the search began to their most probable ones.


CURVED = 0.02
"""Step over which the curvature is taken."""

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
            unit, std = _refined_factors(scorer, before, candidate)
            return _as_unit(unit, std, scorer.arm.n_joints)
        case UnitMismatch(variant="motor_side") | LateTorque() | TimeStamps():
            return _refined_factors(scorer, before, candidate)
    return candidate, ()


def _refined_zero(
    scorer: ReadingScorer, before: Reading, candidate: ZeroOffset
) -> tuple[Fault, tuple[float, ...]]:
    """A joint's zero to within its deviation; as it began if it ends at an angle too small for a fault."""

    def build(x: np.ndarray) -> Fault:
        # within half a turn either way
        offset = float(np.remainder(x[0] + np.pi, TURN) - np.pi)
        return replace(candidate, offset=offset)

    search = _PatternSearch(scorer, before, build)
    x = search.minimum(np.array(candidate.values()["offset"]))
    found = build(x)
    if abs(found.values()["offset"][0]) < MIN_ZERO_OFFSET:
        return candidate, ()
    return found, tuple(search.deviation(x).tolist())


def _refined_factors(
    scorer: ReadingScorer, before: Reading, candidate: Fault
) -> tuple[Fault, tuple[float, ...]]:
    """One value for all joints; values of their own for those, or all, that it explains decisively less."""
    (name,), (given,) = candidate.values(), candidate.values().values()
    joints, starts = len(given), np.log(given)

    def search(groups: np.ndarray) -> _PatternSearch:
        """Over the logarithm of the value of each group of joints."""

        def build(x: np.ndarray) -> Fault:
            each: Any = tuple(np.exp(x[groups]).tolist())
            return replace(candidate, **{name: each if joints > 1 else each[0]})

        return _PatternSearch(scorer, before, build)

    one: np.ndarray = np.zeros(joints, dtype=int)
    if isinstance(candidate, TorqueUnit):
        # one factor first; a joint leaves it if its own factor pays for itself
        groups, x = one, search(one).minimum(np.array([np.median(starts)]))
        least = search(groups).cost(x)
        for j, start in enumerate(starts):
            alone = np.where(np.arange(joints) == j, len(x), groups)
            cost = search(alone).cost(np.append(x, start)) + scorer.charge
            if cost < least:
                groups, x, least = alone, np.append(x, start), cost
        x = search(groups).minimum(x)
    else:
        # positions in wrong units spoil what the others tell: each on its own first
        groups = np.arange(joints)
        x = search(groups).minimum(starts)
        common = search(one).minimum(np.array([np.median(x)]))
        # each further value owes its charge
        worth = search(groups).cost(x) + (joints - 1) * scorer.charge
        if search(one).cost(common) <= worth:
            groups, x = one, common
    found = search(groups)
    # of the value, from that of its logarithm
    std = np.exp(x) * found.deviation(x)
    return found.build(x), tuple(std[groups].tolist())


def _as_unit(
    unit: Fault, std: tuple[float, ...], n: int
) -> tuple[Fault, tuple[float, ...]]:
    """A torque's unit as one of N m if its factor is about that, of those joints alone whose factor is not about one.

    How far a factor is from that of a unit is the arm's, which has a scale of its torque.
    """
    joints, factor = np.array(unit.kind[2]), np.array(unit.values()["factor"])
    # nearest as a ratio
    nearest = min(DECIMAL_UNITS, key=lambda decimal: abs(np.log(decimal / factor[0])))
    near = abs(np.log(nearest / factor[0])) < np.log(DECIMAL_UNIT_ERROR)
    if np.ptp(factor) == 0 and near:
        return TorqueUnit(unit.kind[1], unit.kind[2], (nearest,) * len(joints)), ()
    off = np.abs(np.log(factor)) > np.log(OWN_UNIT_FACTOR)
    if off.all() or not off.any():
        return unit, std
    own = TorqueUnit.of(joints[off] - 1, factor[off], n)
    return own, tuple(np.array(std)[off].tolist())


class _PatternSearch:
    """The search for the most probable values x of a candidate, which are its own or their logarithms.

    Args:
        scorer: of readings of the case.
        before: the reading on top of which the candidate comes.
        build: the candidate with values x.
    """

    def __init__(self, scorer: ReadingScorer, before: Reading, build: Build) -> None:
        self.scorer, self.before, self.build = scorer, before, build

    def cost(self, x: np.ndarray) -> float:
        """Negative logarithm of the probability, up to a constant [nats]."""
        reading = self.build(x).reading(self.scorer.arm.n_joints)
        return -self.scorer.evidence(self.before.then(reading))

    def minimum(self, x: np.ndarray) -> np.ndarray:
        """Values of least cost, by a coordinate-wise pattern search from x."""
        step = REFINE_FIRST_STEP
        least = self.cost(x)
        while step > REFINE_LAST_STEP:
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
                step /= 2
        return x

    def deviation(self, x: np.ndarray) -> np.ndarray:
        """Standard deviations of x, from the curvature of the cost, of the shape of x."""
        std = np.empty(len(x))
        least = self.cost(x)
        for k in range(len(x)):
            h = CURVED * (np.arange(len(x)) == k)
            curvature = (self.cost(x + h) - 2 * least + self.cost(x - h)) / CURVED**2
            # where the cost is flat the deviation is one at most: a factor of e
            std[k] = 1.0 / np.sqrt(max(curvature, 1.0))
        return std


# Setup faults by the torque: candidates are screened on few samples, refined, and the best is accepted if decisive.


_Kind = tuple[str, str, int]
"""Name and variant of a candidate, and the number of its joints."""


class _Finalist(NamedTuple):
    """A refined candidate, compared on all samples with the reading without it.

    Attributes:
        candidate: with its values.
        std: standard deviations of these.
        charge: what its values and the choice of its joints owe [nats].
        gain: evidence beyond that without it, less this charge [nats].
    """

    candidate: Fault
    std: tuple[float, ...]
    charge: float
    gain: float


def faults_by_torque(case: Case) -> list[FoundFault]:
    """Faults that the torque shows, best first, of a case whose stamps are in order."""
    fine = _scorer(case)
    if fine is None:
        return []
    recordings = [r for r in case.recordings if r.tau is not None]
    rate_is_known = all(rate_error(r) is not None for r in recordings)
    thinned = fine.samples.thinned(FAULT_COARSE_STEP)
    coarse = ReadingScorer(case.arm, fine.body, thinned)

    n = case.arm.n_joints
    reading, found = Reading.identity(n), []
    # at most as many faults as joints
    for _ in range(n):
        candidates = _candidates(fine, reading, rate_is_known)
        # a pair of joints is one of many pairs: choosing it is paid for
        charges = _choice_charges(candidates)
        screened = _screened(coarse, reading, candidates, charges)
        finalists = _finalists(coarse, fine, reading, screened, charges)
        best = max(finalists, key=lambda finalist: finalist.gain, default=None)
        if best is not None and isinstance(best.candidate, TurnedBase):
            mirrored = _mirrored(fine, reading, best)
            if mirrored is not None:
                # beside a base that is turned either way the others have lost already
                best, finalists = mirrored, [mirrored]
        if best is None or best.gain < UNUSUAL:
            break
        # a turned base only steps out of the way of others: the search names it
        if not isinstance(best.candidate, TurnedBase):
            # each has one continuous value at most
            std = {name: best.std for name in best.candidate.values() if best.std}
            odds = best.gain - UNUSUAL
            probability, others = _probabilities(best, finalists)
            found.append(
                FoundFault(
                    best.candidate,
                    probability,
                    std,
                    log_odds=odds,
                    charge=best.charge,
                    others=others,
                )
            )
        reading = reading.then(best.candidate.reading(n))
    # gravity is added to a torque that is right otherwise
    return sorted(found, key=lambda fault: fault.name == "gravity_compensated_torque")


def looks_late(case: Case) -> bool:
    """Whether the torque of a reference is likelier late than not, be a fault improbable: it is no change later then.

    Args:
        case: the reference, with the arm that was identified on it as the nominal one.
    """
    scorer = _scorer(case)
    if scorer is None:
        return False
    n = case.arm.n_joints
    before = scorer.evidence(Reading.identity(n))
    read = (LateTorque("delay", delay).reading(n) for delay in TORQUE_DELAY_STARTS)
    # at any start: values need not be refined to tell
    return max(map(scorer.evidence, read)) > before


def common_factor(case: Case) -> tuple[float, float] | None:
    """Factor on all torques that explains them decisively better, and its deviation [1]; ``None`` if none does.

    Too near to one for another unit: constants of the motors, or a gear ratio. A load does not act on all joints alike.
    """
    scorer = _scorer(case)
    if scorer is None:
        return None
    n = case.arm.n_joints

    def build(x: np.ndarray) -> TorqueUnit:
        return TorqueUnit.of(np.arange(n), np.full(n, np.exp(x[0])), n)

    search = _PatternSearch(scorer, Reading.identity(n), build)
    x = search.minimum(np.zeros(1))
    gain = search.cost(np.zeros(1)) - search.cost(x) - scorer.charge
    if gain < UNUSUAL or abs(x[0]) < np.log(OWN_UNIT_FACTOR):
        return None
    factor = float(np.exp(x[0]))
    return factor, factor * float(search.deviation(x)[0])


def is_of_other_bodies(case: Case, owed: float) -> bool:
    """Whether the nominal bodies explain the torque too little for an arm that is read right by its faults.

    Args:
        case: faults of its set-up put right.
        owed: by how much its faults are less probable than another robot is, which has none [nats].
    """
    scorer = _scorer(case)
    if scorer is None:
        return False
    return scorer.support_of_bodies(Reading.identity(case.arm.n_joints)) < owed


def unit_of_nominal_arm(case: Case) -> FoundFault | None:
    """The unit in which the torques of all joints are nearest to the nominal arm's; ``None`` if it is about N m."""
    scorer = _scorer(case)
    if scorer is None:
        return None
    n, none = case.arm.n_joints, Reading.identity(case.arm.n_joints)
    equations = scorer.equations_of(none)
    assert equations is not None
    look = look_at(scorer, equations, none, rate_is_known=True)
    for start in TorqueUnit.candidates(look):
        if len(start.kind[2]) == n:
            unit, std = refined(scorer, none, start)
            return FoundFault(
                unit, OBVIOUS_FAULT_PROBABILITY, {"factor": std} if std else {}
            )
    return None


def _scorer(case: Case) -> ReadingScorer | None:
    """Scores of the recordings of a case with a torque; ``None`` if they hold too little."""
    recordings = [r for r in case.recordings if r.tau is not None]
    try:
        segments = [segment for r in recordings for segment in condition(r)]
    except GapscopeError:
        return None
    if not segments:
        return None
    return ReadingScorer(case.arm, RigidBody(case.arm), sample(segments))


def _candidates(
    scorer: ReadingScorer, reading: Reading, rate_is_known: bool
) -> list[Fault]:
    """Faults that may come on top of a reading, and turned bases, which compete with them."""
    equations = scorer.equations_of(reading)
    if equations is None:
        return []
    look = look_at(scorer, equations, reading, rate_is_known)
    every = (c for fault in FAULTS.values() for c in fault.candidates(look))
    # no joint that moves as far as it can moves farther in another unit
    candidates = [c for c in every if _stays_in_range(c, scorer, reading, look.beyond)]
    # a turned base does not turn once more, nor is it right while torques are turned as well
    if any(reading.turn):
        return candidates
    turn = scorer.gravity_turn(reading)
    shown = () if turn is None else (TurnedBase(*turn),)
    return [*candidates, *TURNED_BASES, *shown]


def _stays_in_range(
    candidate: Fault, scorer: ReadingScorer, reading: Reading, beyond: Sequence[int]
) -> bool:
    """Whether no more joints than before move farther than they can."""
    own = candidate.reading(scorer.arm.n_joints)
    if not own.differs("motion"):
        return True
    after = joints_beyond_range(scorer, reading.then(own))
    return len(after) <= len(beyond)


def _mirrored(
    scorer: ReadingScorer, reading: Reading, turned: _Finalist
) -> _Finalist | None:
    """All torques turned round, if a base turned the other way as well explains decisively more than one turned alone.

    Gravity is the same under both: neither of the two is found without the other.
    """
    n = scorer.arm.n_joints
    signs = SignFlip(tuple(range(1, n + 1)))
    flipped = reading.then(signs.reading(n))
    turn = scorer.gravity_turn(flipped)
    if turn is None:
        return None
    alone = reading.then(turned.candidate.reading(n))
    both = flipped.then(TurnedBase(*turn).reading(n))
    gain = scorer.evidence(both) - scorer.evidence(alone)
    return _Finalist(signs, (), 0.0, gain) if gain > UNUSUAL else None


def _choice_charges(candidates: list[Fault]) -> dict[_Kind, float]:
    """What candidates owe to the choice of their joints, of as many as there are of their kind [nats].

    All torques turned is one convention; two of seven joints are one of 21 pairs.
    """
    # starts of one set of joints are one choice
    kinds = {(_kind(candidate), candidate.kind[2]) for candidate in candidates}
    counts = Counter(kind for kind, _ in kinds)
    return {kind: math.log(count) for kind, count in counts.items()}


def _kind(candidate: Fault) -> _Kind:
    name, variant, joints = candidate.kind
    return name, variant, len(joints)


def _screened(
    coarse: ReadingScorer,
    reading: Reading,
    candidates: list[Fault],
    charges: dict[_Kind, float],
) -> list[Fault]:
    """The best few candidates that gain anything, one of each fault, variant and set of joints."""
    before, n = coarse.evidence(reading), coarse.arm.n_joints
    gains = [
        coarse.evidence(reading.then(c.reading(n))) - before - charges[_kind(c)]
        for c in candidates
    ]
    kept: dict[tuple[str, str, tuple[int, ...]], Fault] = {}
    for index in np.argsort(gains)[::-1][:FAULT_FINALISTS]:
        candidate = candidates[index]
        if gains[index] > 0:
            # several start values of one fault lead to the same refined one: the best is enough
            kept.setdefault(candidate.kind, candidate)
    return list(kept.values())


def _finalists(
    coarse: ReadingScorer,
    fine: ReadingScorer,
    reading: Reading,
    candidates: list[Fault],
    charges: dict[_Kind, float],
) -> list[_Finalist]:
    """The candidates refined, each with its gain."""
    before = fine.evidence(reading)
    finalists = []
    for start in candidates:
        # refined on few samples, compared on all
        candidate, std = refined(coarse, reading, start)
        # refined to what a wrong constant explains as well
        if isinstance(candidate, TorqueUnit) and candidate.is_ordinary:
            continue
        read = reading.then(candidate.reading(fine.arm.n_joints))
        # for the choice of joints, and for each value that was fitted, one or some for all of them
        fitted = {x for own in candidate.values().values() for x in own} if std else ()
        charge = charges[_kind(start)] + fine.charge * len(fitted)
        gain = fine.evidence(read) - before - charge
        if isinstance(candidate, LateTorque):
            # logs are late by more than sampling makes them, and on all joints alike: friction turns late on few
            shortest, _ = candidate.parameters[0].typical
            alike = fine.late_by_joint(read).min() > -LATE_JOINT_LOSS * gain
            if candidate.delay + std[0] < shortest or not alike:
                continue
        finalists.append(_Finalist(candidate, std, charge, gain))
    return finalists


def _probabilities(
    best: _Finalist, finalists: Sequence[_Finalist]
) -> tuple[float, tuple[tuple[Fault, float], ...]]:
    """Probability of the best finalist, against no fault as well, and of the others, the most probable first."""
    # no fault at all has a gain of zero, and its prior
    total = np.logaddexp.reduce([UNUSUAL, *(f.gain for f in finalists)])
    others = sorted(finalists, key=lambda f: -f.gain)
    return float(np.exp(best.gain - total)), tuple(
        (f.candidate, float(np.exp(f.gain - total))) for f in others if f is not best
    )
