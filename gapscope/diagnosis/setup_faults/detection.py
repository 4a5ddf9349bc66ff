"""Setup faults of a case: tested before any physics, since they look like large physics.

Time stamps are read from the recordings themselves. For everything else the torque decides: a fault is named where an
ordinary arm, with unknown load, inertials, friction, torque scales and springs, explains unseen torque decisively
better once the recordings are read as the fault would have it. Faults are put right one after the other, best first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.plausibility import PLAUSIBLE_RATES
from gapscope.diagnosis.gap.torque_gap import torque_gap
from gapscope.diagnosis.setup_faults.candidates import (
    Candidate,
    of_arm,
    of_inertials,
    of_motion,
    of_torque,
    of_units,
    too_far,
)
from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.fault_samples import sample
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, Quantity, repaired
from gapscope.diagnosis.setup_faults.mapping_score import MappingScorer, Score
from gapscope.diagnosis.setup_faults.merge import merged
from gapscope.diagnosis.setup_faults.refine import refined
from gapscope.diagnosis.setup_faults.time_stamps import find_stamps, rate_error
from gapscope.diagnosis.thresholds import (
    FAULT_COARSE_STEP,
    FAULT_FALL,
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
    FAULT_VISIBLE,
    NOMINAL_RIGHT_NRMSE,
    NOMINAL_RIGHT_RATIO,
    SHIFTED_INERTIALS_FALL,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    condition,
    position_cutoff,
)


@dataclass(frozen=True)
class _Accepted:
    """A fault that was accepted, with the deviations of its values and its probability."""

    candidate: Candidate
    std: tuple[float, ...]
    probability: float


def find_setup_faults(case: Case) -> tuple[FoundFault, ...]:
    """Setup faults of a case, in the order in which they have to be put right.

    Args:
        case: the case as it was read.
    """
    if not case.recordings:
        return ()
    stamps = find_stamps((*case.recordings, *case.judged))
    cleaned = repaired(case, stamps)
    alone = sum(r.tau is not None for r in case.recordings) == 1
    for told in (_by_torque(cleaned), _shifted_inertials(cleaned)):
        found = _with_gaps(case, merged((*stamps, *told)))
        kept = tuple(f for f in found if not _useless(f, alone))
        if len(kept) > len(stamps):
            break
    return kept if len(kept) == len(found) else _with_gaps(case, kept)


def _shifted_inertials(case: Case) -> list[FoundFault]:
    """Inertials on the wrong links, where moving them makes the nominal arm right without any fitted value.

    A load and wrong inertials can stand in for the shift, so that unseen torque may not tell; but they leave a gap.
    """
    before = _nrmse(case)
    if before is None or before.max() < NOMINAL_RIGHT_RATIO * NOMINAL_RIGHT_NRMSE:
        return []
    for candidate in of_inertials(case.arm.n_joints):
        fault = _fault(_Accepted(candidate, (), 0.99))
        try:
            after = _nrmse(repaired(case, (fault,)))
        except GapscopeError:
            continue
        if (
            after is not None
            and after.max() < NOMINAL_RIGHT_NRMSE
            and after.max() * NOMINAL_RIGHT_RATIO < before.max()
        ):
            return [fault]
    return []


def _by_torque(case: Case) -> list[FoundFault]:
    """Faults that the torque tells, of a case whose stamps are in order."""
    recordings = tuple(r for r in case.recordings if r.tau is not None)
    try:
        cutoff = min(position_cutoff(recordings), TORQUE_CUTOFF) if recordings else 0.0
        segments = [condition(r, cutoff) for r in recordings]
    except GapscopeError:
        return []
    if not segments:
        return []
    samples = sample(segments)
    body = RigidBody(case.arm)
    benches = (
        MappingScorer(case.arm, body, samples.thinned(FAULT_COARSE_STEP)),
        MappingScorer(case.arm, body, samples),
    )
    timed = all(rate_error(r) is not None for r in recordings)
    reading, found = ChannelMapping.plain(case.arm.n_joints), []
    for _ in range(case.arm.n_joints):
        accepted = _next(
            *benches,
            reading,
            timed,
            FAULT_SINGLE_RECORDING_FACTOR if len(segments) == 1 else 1.0,
        )
        if accepted is None:
            break
        reading = reading.then(accepted.candidate.reading)
        found.append(_fault(accepted))
    return found


def _next(
    coarse: MappingScorer,
    fine: MappingScorer,
    reading: ChannelMapping,
    timed: bool,
    strictness: float,
) -> _Accepted | None:
    """The best fault on top of a reading, if it is decisive; ``timed``: recorded velocities vouch for the rate."""
    n = fine.arm.n_joints
    candidates = [
        *of_torque(n),
        *of_motion(n),
        *of_arm(n),
        *of_units(fine.arm, fine.samples, reading),
    ]
    if timed or reading.time_factor != 1.0:
        candidates = [c for c in candidates if c.name != "time_stamps"]
    before = coarse.score(reading)
    gains = np.array(
        [coarse.score(reading.then(c.reading)).gain(before) for c in candidates]
    )
    tried: list[tuple[float, _Accepted, Score]] = []
    before = fine.score(reading)
    seen: set[tuple[str, str, tuple[int, ...]]] = set()
    for i in np.argsort(gains)[::-1][:FAULT_FINALISTS]:
        kind = (candidates[i].name, candidates[i].variant, candidates[i].joints)
        if gains[i] > 0 and kind not in seen:
            seen.add(kind)
            candidate, std = refined(coarse, reading, candidates[i])
            score = fine.score(reading.then(candidate.reading))
            gain = score.gain(before) - (
                FAULT_VALUE_CHARGE if candidate.values and candidate.variant else 0.0
            )
            tried.append((gain, _Accepted(candidate, std, 0.0), score))
    if not tried:
        return None
    most, accepted, score = max(tried, key=lambda t: t[0])
    unit = accepted.candidate.name == "unit_mismatch"
    impossible = unit and {j - 1 for j in accepted.candidate.joints} <= set(
        too_far(fine.arm, fine.samples, reading)
    )
    if not decisive(
        before, score, strictness * (FAULT_FAR_FACTOR if impossible else 1.0)
    ):
        return None
    rivals = sum(np.exp(FAULT_SHARPNESS * (g - most)) for g, _, _ in tried)
    return replace(
        accepted,
        probability=float(
            1.0 / (rivals + np.exp(-FAULT_SHARPNESS * most) / FAULT_PRIOR_ODDS)
        ),
    )


def decisive(before: Score, after: Score, share: float = 1.0) -> bool:
    """Whether a fault put right gains, on all folds, at least a share of what only a fault does."""
    joints, values = after.joints(before), after.values(before)
    folds = after.folds(before) + max(values, 0.0)
    enough = (folds > share * FAULT_FOLD_GAIN).sum() >= max(
        min(2, len(folds)), len(folds) / 2
    )
    large = (
        joints.max() > share * FAULT_JOINT_GAIN or values > share * FAULT_VALUES_GAIN
    )
    gained = joints.sum() + values > share * FAULT_GAIN and joints.sum() > -FAULT_LOSS
    return bool(gained and large and enough and folds.min() > -FAULT_FOLD_LOSS)


def _fault(accepted: _Accepted) -> FoundFault:
    candidate = accepted.candidate
    parameters = {
        name: Quantity("1", values, accepted.std or None)
        for name, values in candidate.values.items()
    }
    return FoundFault(
        candidate.name,
        candidate.joints,
        candidate.variant,
        parameters,
        accepted.probability,
        (),
        candidate.reading,
    )


def _useless(fault: FoundFault, alone: bool) -> bool:
    """Whether a fault told by the torque, put right, leaves the nominal arm's own gap about as it was.

    Args:
        fault: the fault.
        alone: whether one recording tells it.
    """
    if (
        fault.reading is None
        or fault.recordings
        or fault.gap_without_this is None
        or fault.gap_after is None
    ):
        return False
    without, after = fault.gap_without_this, fault.gap_after
    fallen = 1.0 - (after**2).sum() / max((without**2).sum(), 1e-12)
    least = (
        SHIFTED_INERTIALS_FALL
        if fault.name == "shifted_inertials"
        else FAULT_FALL
        if alone
        else -np.inf
    )
    return bool((without - after).max() < FAULT_VISIBLE or fallen < least)


def _with_gaps(case: Case, faults: tuple[FoundFault, ...]) -> tuple[FoundFault, ...]:
    """The faults with the torque gap of the nominal arm with and without each."""
    if not faults:
        return ()
    none, full = _nrmse(case), _nrmse(repaired(case, faults))
    out = []
    for k, fault in enumerate(faults):
        only, without = full, none
        if len(faults) > 1:
            only = _nrmse(repaired(case, (fault,)))
            without = _nrmse(repaired(case, faults[:k] + faults[k + 1 :]))
        out.append(
            replace(
                fault,
                gap_before=none,
                gap_after=full,
                gap_with_only_this=only,
                gap_without_this=without,
            )
        )
    return tuple(out)


def _nrmse(case: Case) -> np.ndarray | None:
    """Torque NRMSE of the nominal arm over all recordings with a torque, (n,); ``None`` where it makes no sense."""
    recordings = tuple(r for r in (*case.recordings, *case.judged) if r.tau is not None)
    if not recordings or min(r.rate for r in recordings) < PLAUSIBLE_RATES[0]:
        return None
    try:
        cutoff = position_cutoff(recordings)
        segments = [s for r in recordings for s in condition(r, cutoff)]
        gap = torque_gap(CorrectedArm(case.arm), RigidBody(case.arm), segments).nrmse
    except (GapscopeError, ValueError):
        return None
    return gap if np.isfinite(gap).all() else None
