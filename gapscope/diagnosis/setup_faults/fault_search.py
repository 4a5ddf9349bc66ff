"""Setup faults by the torque: candidates are screened on few samples, refined, and the best is accepted if decisive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.candidates import (
    TURNED_BASES,
    TurnedBase,
    joints_beyond_range,
    look_at,
)
from gapscope.diagnosis.setup_faults.fault_samples import sample
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.setup_faults.reading_score import ReadingScore, ReadingScorer
from gapscope.diagnosis.setup_faults.refine import refined
from gapscope.diagnosis.setup_faults.time_stamps import rate_error
from gapscope.diagnosis.thresholds import (
    COMMON_DELAY_LOSS,
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
    OTHER_DELAYS,
)
from gapscope.effects.setup_faults.channel_faults import JointSwap, UnitMismatch
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.fault_catalogue import FAULTS
from gapscope.effects.setup_faults.torque_faults import (
    TORQUE_DELAY_STARTS,
    LateTorque,
    TorqueUnit,
)
from gapscope.model.conditioning import condition

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
