"""What is wrong with the set-up by the torque, as a diagnosis finds it, and samples at the torque's limit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import yaml

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name
from gapscope.case_check.remark import Remark, numbers
from gapscope.case_check.thresholds import AT_LIMIT
from gapscope.diagnosis.document.wording import capital, listing
from gapscope.diagnosis.setup_faults.detection import (
    find_setup_faults,
    nominal_gap,
    upright,
)
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.effects.setup_faults.time_stamp_fault import TimeStamps

NO_TORQUE = 1.0
"""Gap over the torque's deviation beyond which no torque at all would be a better prediction [1]. (definition)"""


def check_set_up(case: Case, seen: Sequence[FoundFault]) -> Iterator[Remark]:
    """Faults of the set-up that a diagnosis of the case finds, or that its torque fits the nominal arm as it is read.

    Args:
        case: the case, with references put right.
        seen: faults of references.
    """
    found = find_setup_faults(case)
    for fault in (*seen, *found):
        yield _remark(fault, case)
    case = repaired(case, found)
    gap, gravity = nominal_gap(case), upright(case).arm.gravity
    if gap is None:
        return
    size = float(np.sqrt((gap**2).mean()))
    if gravity is not case.arm.gravity:
        shown, said = (
            [round(float(x), 2) + 0.0 for x in g] for g in (gravity, case.arm.gravity)
        )
        yield Remark(
            "warn",
            "torque",
            "",
            f"shows gravity {shown} m/s^2 in the frame of the base, the case says {said}: the base is mounted turned",
            f"gravity: {shown}",
        )
    elif size > NO_TORQUE:
        yield Remark(
            "warn",
            "torque",
            "",
            f"the nominal arm's torque is off by {size:.0%} of the recorded one, more than no torque would be: "
            "probably another robot, or a load that is not in the case",
            "check robot: and payloads:",
        )
    elif not found:
        yield Remark(
            "ok",
            "torque",
            "",
            "no other unit, sign, order or clock of the columns explains the torque better; the nominal arm is off by "
            f"{size:.0%} of it",
        )
    yield from _limits(case)


def _topic(fault: FoundFault) -> str:
    """What of a case a fault is of."""
    if fault.name == TimeStamps.name:
        return "time"
    reading = fault.fault.reading(max(fault.joints, default=1))
    topics = {
        "positions": ("motion",),
        "controller": ("kp_factor", "kd_factor", "law", "lead", "pace"),
        "model": ("link_shift",),
    }
    return next((t for t, what in topics.items() if reading.differs(*what)), "torque")


def _remark(fault: FoundFault, case: Case) -> Remark:
    """A fault in words, by how much the gap falls if it is put right, and the line that does that."""
    variant = f" ({fault.variant.replace('_', ' ')})" * bool(fault.variant)
    said = f"{capital(effect_name(fault.name))}{variant}, probability {fault.probability:.0%}"
    before, after = fault.gap_without_this, fault.gap_after
    if before is not None and after is not None:
        read, right = (float(np.sqrt((gap**2).mean())) for gap in (before, after))
        much = f"{read:.0%}" if read < 10 else f"{read:.0f} times"
        said += f": the nominal arm is off by {much} of the torque as it is read, by {right:.0%} if that is put right"
    mend = _rounded(fault.reading(case.arm.n_joints).to_mend())
    line = yaml.safe_dump(mend, default_flow_style=True, width=1000).strip()
    remedy = (
        f"import: {{mend: {line}}} puts it right; gapscope diagnose writes mended_case.yaml"
        if mend
        else "gapscope diagnose puts it right and says what to correct"
    )
    places = [*fault.recordings, *([numbers(list(fault.joints))] * bool(fault.joints))]
    return Remark("warn", _topic(fault), listing(places), said, remedy)


def _rounded(entry: Any) -> Any:
    """An entry of a case file with as many digits of its numbers as a person copies."""
    if isinstance(entry, dict):
        return {key: _rounded(value) for key, value in entry.items()}
    if isinstance(entry, (list, tuple)):
        return [_rounded(value) for value in entry]
    return float(f"{entry:.5g}") if isinstance(entry, float) else entry


def _limits(case: Case) -> Iterator[Remark]:
    """Samples at the torque limit of the data sheet, or beyond."""
    limit = case.arm.torque_limit
    torque = [r.tau for r in case.recordings if r.tau is not None]
    if limit is None or not torque:
        return
    size = np.abs(np.vstack(torque))
    at_limit = (size > 0.99 * limit).mean(axis=0)
    if (at_limit > AT_LIMIT).any():
        joints = (np.flatnonzero(at_limit > AT_LIMIT) + 1).tolist()
        yield Remark(
            "warn",
            "torque",
            numbers(joints),
            f"at the torque limit in up to {at_limit.max():.0%} of the samples",
            "what is clipped says little of the arm: record a slower motion; if the drive allows more, correct "
            "nominal: {torque_limit: ...}",
        )
