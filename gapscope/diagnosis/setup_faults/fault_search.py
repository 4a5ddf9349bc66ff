"""Setup faults by the torque: candidates are screened on few samples, refined, and the best is accepted if decisive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.candidates import (
    TURNED_BASE,
    FaultCandidate,
    arm_candidates,
    joints_beyond_range,
    motion_candidates,
    torque_candidates,
    turned_base,
    turned_bases,
    unit_candidates,
)
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.fault_samples import sample
from gapscope.diagnosis.setup_faults.found_fault import FaultParameter, FoundFault
from gapscope.diagnosis.setup_faults.mapping_score import MappingScore, MappingScorer
from gapscope.diagnosis.setup_faults.refine import refined
from gapscope.diagnosis.setup_faults.time_stamps import rate_error
from gapscope.diagnosis.setup_faults.torque_column import (
    is_ordinary,
    late_torque,
    torque_column_candidates,
)
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
    TORQUE_DELAY_STARTS,
)
from gapscope.effects.setup_faults.fault_catalogue import FAULTS
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    condition,
    position_cutoff,
)

_Kind = tuple[str, str, int]
"""Name and variant of a candidate, and the number of its joints."""


@dataclass(frozen=True)
class _Finalist:
    """A refined candidate, compared on all samples with the mapping without it."""

    candidate: FaultCandidate
    std: tuple[float, ...]
    score: MappingScore
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
    coarse = MappingScorer(case.arm, fine.body, thinned)

    mapping, found = ChannelMapping.identity(case.arm.n_joints), []
    for _ in range(case.arm.n_joints):
        candidates = _candidates(fine, mapping, rate_is_known)
        charges = _choice_charges(candidates)
        screened = _screened(coarse, mapping, candidates, charges)
        finalists = _finalists(coarse, fine, mapping, screened, charges)
        best = max(finalists, key=lambda finalist: finalist.gain, default=None)
        if best is None or not _is_accepted(best, fine, mapping, strictness):
            break
        probability = _probability(best, finalists)
        if best.candidate.name != TURNED_BASE:
            fault = found_fault(best.candidate, best.std, probability)
            turned = _turned_base(best, fine, mapping, probability)
            found.append(replace(fault, turned_base=turned))
        mapping = mapping.then(best.candidate.mapping)
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
    before = scorer.score(ChannelMapping.identity(n))
    read = (late_torque(n, delay).mapping for delay in TORQUE_DELAY_STARTS)
    gain = max(scorer.score(mapping).gain(before) for mapping in read)
    return gain > LATE_REFERENCE_SHARE * FAULT_GAIN


def _scorer(arm: NominalArm, recordings: tuple[Recording, ...]) -> MappingScorer | None:
    """Scores of recordings with a torque; ``None`` if they hold too little."""
    if not recordings:
        return None
    try:
        cutoff = min(position_cutoff(recordings), TORQUE_CUTOFF)
        segments = [condition(r, cutoff) for r in recordings]
    except GapscopeError:
        return None
    return MappingScorer(arm, RigidBody(arm), sample(segments))


def _candidates(
    scorer: MappingScorer, mapping: ChannelMapping, rate_is_known: bool
) -> list[FaultCandidate]:
    """Faults that may come on top of a mapping, and turned bases, which compete with them."""
    n = scorer.arm.n_joints
    candidates = [
        *torque_candidates(n),
        *motion_candidates(n),
        *arm_candidates(n),
        *unit_candidates(scorer.arm, scorer.samples, mapping),
    ]
    equations = scorer.equations_of(mapping)
    if equations is not None:
        candidates += torque_column_candidates(equations, mapping)
    # Recorded velocities, or a time scale that was corrected already, settle the rate.
    if rate_is_known or mapping.time_factor != 1.0:
        candidates = [c for c in candidates if c.name != "time_stamps"]
    # a turned base does not turn once more, nor is it right while torques are turned as well
    if any(mapping.turn):
        return [c for c in candidates if c.name != TURNED_BASE]
    turn = scorer.gravity_turn(mapping)
    return candidates if turn is None else [*candidates, turned_base(n, *turn)]


def _choice_charges(candidates: list[FaultCandidate]) -> dict[_Kind, float]:
    """Gain that candidates owe to the choice of their joints, of as many as there are of their kind [1].

    All torques turned is one convention; two of seven joints are one of 21 pairs.
    """
    joints: dict[_Kind, set[tuple[int, ...]]] = {}
    for candidate in candidates:
        joints.setdefault(_kind(candidate), set()).add(candidate.joints)
    return {
        kind: float(np.log(len(sets))) / FAULT_SHARPNESS
        for kind, sets in joints.items()
    }


def _kind(candidate: FaultCandidate) -> _Kind:
    return candidate.name, candidate.variant, len(candidate.joints)


def _screened(
    coarse: MappingScorer,
    mapping: ChannelMapping,
    candidates: list[FaultCandidate],
    charges: dict[_Kind, float],
) -> list[FaultCandidate]:
    """The best few candidates that gain anything, one of each fault, variant and set of joints.

    Most would gain nothing even if no fold were held out: these are not compared on held-out folds.
    """
    before = coarse.score(mapping)
    gains = []
    for candidate in candidates:
        read, charge = mapping.then(candidate.mapping), charges[_kind(candidate)]
        gain = coarse.best_score(read).gain(before) - charge
        if gain > 0:
            gain = coarse.score(read).gain(before) - charge
        gains.append(gain)
    kept: dict[tuple[str, str, tuple[int, ...]], FaultCandidate] = {}
    for index in np.argsort(gains)[::-1][:FAULT_FINALISTS]:
        candidate = candidates[index]
        if gains[index] > 0:
            # Several start values of one fault lead to the same refined one: the best is enough.
            kind = (candidate.name, candidate.variant, candidate.joints)
            kept.setdefault(kind, candidate)
    return list(kept.values())


def _finalists(
    coarse: MappingScorer,
    fine: MappingScorer,
    mapping: ChannelMapping,
    candidates: list[FaultCandidate],
    charges: dict[_Kind, float],
) -> list[_Finalist]:
    """The candidates refined, each with its gain less what its values and the choice of its joints owe."""
    before = fine.score(mapping)
    finalists = []
    for start in candidates:
        # refined on few samples, compared on all
        candidate, std = refined(coarse, mapping, start)
        if is_ordinary(candidate):
            continue
        score = fine.score(mapping.then(candidate.mapping))
        if not _is_of_all_joints(candidate, fine, mapping, before, score):
            continue
        fitted = bool(std)
        charge = charges[_kind(start)] + (FAULT_VALUE_CHARGE if fitted else 0.0)
        gain = score.gain(before) - charge
        finalists.append(_Finalist(candidate, std, score, gain))
    return finalists


def _is_of_all_joints(
    candidate: FaultCandidate,
    scorer: MappingScorer,
    mapping: ChannelMapping,
    before: MappingScore,
    after: MappingScore,
) -> bool:
    """Whether a late torque is late by the same time on all joints, as by a log; true of other faults.

    Friction that turns round late, in a joint or two, looks late as well, each by a time of its own. Then some joint
    loses, or joints gain much more by half or by one and a half of the delay.
    """
    if candidate.name != "late_torque":
        return True
    (delay,), n = candidate.values["delay"], scorer.arm.n_joints
    own = after.joint_gain(before)
    if -own.min() > max(FAULT_FOLD_LOSS, LATE_JOINT_LOSS * own.sum()):
        return False
    gains = [own]
    for share in OTHER_DELAYS:
        other = mapping.then(late_torque(n, share * delay).mapping)
        gains.append(scorer.score(other).joint_gain(before))
    lost = np.max(gains, axis=0) - own
    return bool(lost.sum() < COMMON_DELAY_LOSS * own.sum())


def _is_accepted(
    best: _Finalist, fine: MappingScorer, mapping: ChannelMapping, strictness: float
) -> bool:
    """Whether a finalist is decisive; less is needed of a unit with which its joints could not have moved so far."""
    beyond = joints_beyond_range(fine.arm, fine.samples, mapping)
    named = [j - 1 for j in best.candidate.joints]
    if best.candidate.name == "unit_mismatch" and set(named) <= set(beyond):
        strictness *= FAULT_FAR_FACTOR
    # columns that were exchanged explain both joints, or they were not
    exchanged = named if best.candidate.name == "joint_swap" else ()
    return decisive(fine.score(mapping), best.score, strictness, exchanged)


def decisive(
    before: MappingScore,
    after: MappingScore,
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
    best: _Finalist, fine: MappingScorer, mapping: ChannelMapping, probability: float
) -> float | None:
    """Probability of a turned base in the place of all torques turned; ``None`` for other faults."""
    n, candidate = fine.arm.n_joints, best.candidate
    if candidate.variant != "torque" or len(candidate.joints) < n:
        return None
    before = fine.score(mapping)
    gains = [
        fine.score(mapping.then(base.mapping)).gain(before) for base in turned_bases(n)
    ]
    odds = np.exp(FAULT_SHARPNESS * min(max(gains) - best.gain, 0.0))
    return probability * float(odds)


def found_fault(
    candidate: FaultCandidate, std: tuple[float, ...], probability: float
) -> FoundFault:
    """A candidate that was accepted, with the standard deviations of its values."""
    parameters = {
        name: FaultParameter(_unit(candidate.name, name), values, std or None)
        for name, values in candidate.values.items()
    }
    return FoundFault(
        candidate.name,
        candidate.joints,
        candidate.variant,
        parameters,
        probability,
        mapping=candidate.mapping,
    )


def _unit(fault: str, parameter: str) -> str:
    """Unit of a parameter of a fault, as the catalogue has it."""
    units = {p.name: p.unit for p in FAULTS[fault].parameters}
    return units[parameter]
