"""The search for a fault of the set-up: scores of readings, and their refinement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.clocks import rate_error
from gapscope.diagnosis.setup_faults.found_fault import (
    TURN,
    TURNED_BASES,
    FoundFault,
    TurnedBase,
    joints_beyond_range,
    look_at,
)
from gapscope.diagnosis.setup_faults.nuisance import ReadingScore, ReadingScorer, sample
from gapscope.diagnosis.thresholds import (
    COMMON_DELAY_LOSS,
    DECIMAL_UNIT_ERROR,
    DECIMAL_UNITS,
    FAULT_COARSE_STEP,
    FAULT_FAR_FACTOR,
    FAULT_FINALISTS,
    FAULT_FOLD_GAIN,
    FAULT_FOLD_LOSS,
    FAULT_GAIN,
    FAULT_JOINT_GAIN,
    FAULT_LOSS,
    FAULT_PRIOR_ODDS,
    FAULT_SHARPNESS,
    FAULT_SINGLE_RECORDING_FACTOR,
    FAULT_VALUE_CHARGE,
    FAULT_VALUES_GAIN,
    LATE_JOINT_LOSS,
    LATE_REFERENCE_SHARE,
    MIN_ZERO_OFFSET,
    NARROW_NUISANCE_FACTOR,
    OBVIOUS_FAULT_PROBABILITY,
    OTHER_DELAYS,
    OWN_UNIT_FACTOR,
    REFINE_FIRST_STEP,
    REFINE_LAST_STEP,
    UNIT_LAST_STEP,
    UNIT_NUISANCE_FACTOR,
)
from gapscope.effects.setup_faults import (
    FAULTS,
    TORQUE_DELAY_STARTS,
    Fault,
    JointSwap,
    LateTorque,
    TimeStamps,
    TorqueUnit,
    UnitMismatch,
    ZeroOffset,
)
from gapscope.model.conditioning import condition

# Continuous values of a setup fault, from the grid on which the search began to their most probable ones.


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
    if abs(found.values()["offset"][0]) < MIN_ZERO_OFFSET:
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


# Setup faults by the torque: candidates are screened on few samples, refined, and the best is accepted if decisive.


_Kind = tuple[str, str, int]
"""Name and variant of a candidate, and the number of its joints."""


@dataclass(frozen=True)
class _Finalist:
    """A refined candidate, compared on all samples with the reading without it."""

    candidate: Fault
    std: tuple[float, ...]
    score: ReadingScore
    gain: float


def faults_by_torque(case: Case) -> list[FoundFault]:
    """Faults that the torque shows, best first, of a case whose stamps are in order."""
    recordings = tuple(r for r in case.recordings if r.tau is not None)
    fine = _scorer(case.arm, recordings)
    if fine is None:
        return []
    rate_is_known = all(rate_error(r) is not None for r in recordings)
    strictness = FAULT_SINGLE_RECORDING_FACTOR if len(recordings) == 1 else 1.0
    thinned = fine.samples.thinned(FAULT_COARSE_STEP)
    coarse = ReadingScorer(case.arm, fine.body, thinned)

    n = case.arm.n_joints
    reading, found = Reading.identity(n), []
    for _ in range(n):
        candidates = _candidates(fine, reading, rate_is_known)
        charges = _choice_charges(candidates)
        screened = _screened(coarse, reading, candidates, charges)
        finalists = _finalists(coarse, fine, reading, screened, charges)
        best = max(finalists, key=lambda finalist: finalist.gain, default=None)
        if best is None or not _is_accepted(best, fine, reading, strictness):
            break
        probability = _probability(best, finalists)
        if not isinstance(best.candidate, TurnedBase):
            turned = _turned_base(best, fine, reading, probability)
            # each has one continuous value at most
            std = {name: best.std for name in best.candidate.values() if best.std}
            fault = FoundFault(best.candidate, probability, std, turned_base=turned)
            found.append(fault)
        reading = reading.then(best.candidate.reading(n))
    # gravity is added to a torque that is right otherwise
    return sorted(found, key=lambda fault: fault.name == "gravity_compensated_torque")


def looks_late(case: Case) -> bool:
    """Whether the torque of a reference may be late, on less evidence than names a fault: then it is no change later.

    Args:
        case: the reference, with the arm that was identified on it as the nominal one.
    """
    recordings = tuple(r for r in case.recordings if r.tau is not None)
    scorer = _scorer(case.arm, recordings)
    if scorer is None:
        return False
    n = case.arm.n_joints
    before = scorer.score(Reading.identity(n))
    read = (LateTorque("delay", delay).reading(n) for delay in TORQUE_DELAY_STARTS)
    gain = max(scorer.score(reading).gain(before) for reading in read)
    return gain > LATE_REFERENCE_SHARE * FAULT_GAIN


def common_factor(case: Case) -> tuple[float, float] | None:
    """Factor on all torques that explains them decisively better, and its deviation [1]; ``None`` if none does.

    Too near to one for another unit: constants of the motors, or a gear ratio. A load does not act on all joints alike.
    """
    scorer = _scorer(case.arm, tuple(r for r in case.recordings if r.tau is not None))
    if scorer is None:
        return None
    n = case.arm.n_joints

    def build(x: np.ndarray) -> TorqueUnit:
        return TorqueUnit.of(np.arange(n), np.full(n, np.exp(x[0])), n)

    found = []
    # friction that the data sheet lacks looks like a factor to an arm that may have little of it, a load to one that
    # may have much: both have to say so
    for spread in (1.0, UNIT_NUISANCE_FACTOR):
        search = _PatternSearch(scorer, Reading.identity(n), build, spread)
        x = search.minimum(np.zeros(1))
        if search.cost(np.zeros(1)) - search.cost(x) < -np.log(FAULT_PRIOR_ODDS):
            return None
        found.append((float(np.exp(x[0])), float(search.deviation(x)[0])))
    (factor, share), (other, _) = found
    if (
        min(factor, other) < OWN_UNIT_FACTOR
        and 1 / max(factor, other) < OWN_UNIT_FACTOR
    ):
        return None
    return factor, factor * share


def is_extraordinary(case: Case, *, far_off: bool) -> bool:
    """Whether no arm with ordinary errors of the nominal one made the torque; ``far_off`` as in ``ReadingScorer``."""
    scorer = _scorer(case.arm, tuple(r for r in case.recordings if r.tau is not None))
    if scorer is None:
        return False
    return scorer.is_of_another_arm(
        Reading.identity(case.arm.n_joints), far_off=far_off
    )


def unit_of_nominal_arm(case: Case) -> FoundFault | None:
    """The unit in which the torques of all joints are nearest to the nominal arm's; ``None`` if it is about N m."""
    scorer = _scorer(case.arm, tuple(r for r in case.recordings if r.tau is not None))
    if scorer is None:
        return None
    n, none = case.arm.n_joints, Reading.identity(case.arm.n_joints)
    equations = scorer.equations_of(none)
    assert equations is not None
    look = look_at(scorer.arm, scorer.samples, equations, none, rate_is_known=True)
    for start in TorqueUnit.candidates(look):
        if len(start.kind[2]) == n:
            unit, std = refined(scorer, none, start)
            return FoundFault(
                unit, OBVIOUS_FAULT_PROBABILITY, {"factor": std} if std else {}
            )
    return None


def _scorer(arm: NominalArm, recordings: tuple[Recording, ...]) -> ReadingScorer | None:
    """Scores of recordings with a torque; ``None`` if they hold too little."""
    if not recordings:
        return None
    try:
        segments = [condition(r) for r in recordings]
    except GapscopeError:
        return None
    return ReadingScorer(arm, RigidBody(arm), sample(segments))


def _candidates(
    scorer: ReadingScorer, reading: Reading, rate_is_known: bool
) -> list[Fault]:
    """Faults that may come on top of a reading, and turned bases, which compete with them."""
    equations = scorer.equations_of(reading)
    if equations is None:
        return []
    look = look_at(scorer.arm, scorer.samples, equations, reading, rate_is_known)
    candidates = [c for fault in FAULTS.values() for c in fault.candidates(look)]
    # a turned base does not turn once more, nor is it right while torques are turned as well
    if any(reading.turn):
        return candidates
    turn = scorer.gravity_turn(reading)
    shown = () if turn is None else (TurnedBase(*turn),)
    return [*candidates, *TURNED_BASES, *shown]


def _choice_charges(candidates: list[Fault]) -> dict[_Kind, float]:
    """Gain that candidates owe to the choice of their joints, of as many as there are of their kind [1].

    All torques turned is one convention; two of seven joints are one of 21 pairs.
    """
    joints: dict[_Kind, set[tuple[int, ...]]] = {}
    for candidate in candidates:
        joints.setdefault(_kind(candidate), set()).add(candidate.kind[2])
    return {
        kind: float(np.log(len(sets))) / FAULT_SHARPNESS
        for kind, sets in joints.items()
    }


def _kind(candidate: Fault) -> _Kind:
    name, variant, joints = candidate.kind
    return name, variant, len(joints)


def _screened(
    coarse: ReadingScorer,
    reading: Reading,
    candidates: list[Fault],
    charges: dict[_Kind, float],
) -> list[Fault]:
    """The best few candidates that gain anything, one of each fault, variant and set of joints.

    Most would gain nothing even if no fold were held out: these are not compared on held-out folds.
    """
    before, n = coarse.score(reading), coarse.arm.n_joints
    gains = []
    for candidate in candidates:
        read, charge = reading.then(candidate.reading(n)), charges[_kind(candidate)]
        gain = coarse.best_score(read).gain(before) - charge
        if gain > 0:
            gain = coarse.score(read).gain(before) - charge
        gains.append(gain)
    kept: dict[tuple[str, str, tuple[int, ...]], Fault] = {}
    for index in np.argsort(gains)[::-1][:FAULT_FINALISTS]:
        candidate = candidates[index]
        if gains[index] > 0:
            # Several start values of one fault lead to the same refined one: the best is enough.
            kept.setdefault(candidate.kind, candidate)
    return list(kept.values())


def _finalists(
    coarse: ReadingScorer,
    fine: ReadingScorer,
    reading: Reading,
    candidates: list[Fault],
    charges: dict[_Kind, float],
) -> list[_Finalist]:
    """The candidates refined, each with its gain less what its values and the choice of its joints owe."""
    before = fine.score(reading)
    finalists = []
    for start in candidates:
        # refined on few samples, compared on all
        candidate, std = refined(coarse, reading, start)
        if isinstance(candidate, TorqueUnit) and candidate.is_ordinary:
            continue
        score = fine.score(reading.then(candidate.reading(fine.arm.n_joints)))
        if not _is_of_all_joints(candidate, fine, reading, before, score):
            continue
        fitted = bool(std)
        charge = charges[_kind(start)] + (FAULT_VALUE_CHARGE if fitted else 0.0)
        gain = score.gain(before) - charge
        finalists.append(_Finalist(candidate, std, score, gain))
    return finalists


def _is_of_all_joints(
    candidate: Fault,
    scorer: ReadingScorer,
    reading: Reading,
    before: ReadingScore,
    after: ReadingScore,
) -> bool:
    """Whether a late torque is late by the same time on all joints, as by a log; true of other faults.

    Friction that turns round late, in a joint or two, looks late as well, each by a time of its own. Then some joint
    loses, or joints gain much more by half or by one and a half of the delay.
    """
    if not isinstance(candidate, LateTorque):
        return True
    own = after.joint_gain(before)
    if -own.min() > max(FAULT_FOLD_LOSS, LATE_JOINT_LOSS * own.sum()):
        return False
    gains = [own]
    for share in OTHER_DELAYS:
        late = replace(candidate, delay=share * candidate.delay)
        other = reading.then(late.reading(scorer.arm.n_joints))
        gains.append(scorer.score(other).joint_gain(before))
    lost = np.max(gains, axis=0) - own
    return bool(lost.sum() < COMMON_DELAY_LOSS * own.sum())


def _is_accepted(
    best: _Finalist, fine: ReadingScorer, reading: Reading, strictness: float
) -> bool:
    """Whether a finalist is decisive; less is needed of a unit with which its joints could not have moved so far."""
    beyond = joints_beyond_range(fine.arm, fine.samples, reading)
    named = [j - 1 for j in best.candidate.kind[2]]
    if isinstance(best.candidate, UnitMismatch) and set(named) <= set(beyond):
        strictness *= FAULT_FAR_FACTOR
    # columns that were exchanged explain both joints, or they were not
    exchanged = named if isinstance(best.candidate, JointSwap) else ()
    return decisive(fine.score(reading), best.score, strictness, exchanged)


def decisive(
    before: ReadingScore,
    after: ReadingScore,
    share: float = 1.0,
    exchanged: Sequence[int] = (),
) -> bool:
    """Whether a fault corrected gains, on all folds, at least a share of what only a fault does.

    ``exchanged`` are joints, from 0, none of which it may leave worse.
    """
    joints, values = after.joint_gain(before), after.penalty_gain(before)
    # a smaller penalty counts on every fold: the values are fitted to all of them
    folds = after.fold_gain(before) + max(values, 0.0)
    needed = max(min(2, len(folds)), len(folds) / 2)
    gained = joints.sum() + values > share * FAULT_GAIN and joints.sum() > -FAULT_LOSS
    is_large = (
        joints.max() > share * FAULT_JOINT_GAIN or values > share * FAULT_VALUES_GAIN
    )
    on_enough_folds = (folds > share * FAULT_FOLD_GAIN).sum() >= needed
    least = min(folds.min(), joints[list(exchanged)].min(initial=0.0))
    lost_on_none = least > -FAULT_FOLD_LOSS
    return bool(gained and is_large and on_enough_folds and lost_on_none)


def _probability(best: _Finalist, finalists: Sequence[_Finalist]) -> float:
    """Probability of the best finalist against the others and against no fault."""
    others = sum(np.exp(FAULT_SHARPNESS * (f.gain - best.gain)) for f in finalists)
    no_fault = np.exp(-FAULT_SHARPNESS * best.gain) / FAULT_PRIOR_ODDS
    return float(1.0 / (others + no_fault))


def _turned_base(
    best: _Finalist, fine: ReadingScorer, reading: Reading, probability: float
) -> float | None:
    """Probability of a turned base in the place of all torques turned; ``None`` for other faults."""
    n = fine.arm.n_joints
    _, variant, joints = best.candidate.kind
    if variant != "torque" or len(joints) < n:
        return None
    before = fine.score(reading)
    gains = [
        fine.score(reading.then(base.reading(n))).gain(before) for base in TURNED_BASES
    ]
    odds = np.exp(FAULT_SHARPNESS * min(max(gains) - best.gain, 0.0))
    return probability * float(odds)
