"""All checks of a case."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.case_check.motion import JointMotions, check_motion, joint_motions
from gapscope.case_check.nominal import check_controller, check_nominal, check_ranges
from gapscope.case_check.recordings import check_recordings
from gapscope.case_check.remark import Remark
from gapscope.case_check.thresholds import RATE, SECONDS
from gapscope.case_check.torque import check_set_up
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.study import with_torque
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.model.conditioning import (
    Segment,
    condition,
    position_cutoff,
    thinned,
)


@dataclass(frozen=True)
class CaseCheck:
    """What the check of a case found.

    Attributes:
        case: the case; ``None`` if it cannot be read.
        remarks: in the order of the checks.
        motions: how the joints move; ``None`` if that cannot be told.
    """

    case: Case | None
    remarks: tuple[Remark, ...]
    motions: JointMotions | None = None

    @property
    def can_be_diagnosed(self) -> bool:
        """Whether no remark is an error."""
        return all(remark.level != "error" for remark in self.remarks)


def check_case(
    path: Path, progress: Callable[[str], None] = lambda message: None
) -> CaseCheck:
    """Check a case; nothing is raised for a case that cannot be read, it is an error among the remarks.

    Args:
        path: folder of the case, or its case file.
        progress: called with a few words at each step.
    """
    progress("reads the case")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ModelWarning)
        case, remarks = _read(path)
    remarks += [
        Remark("warn", "model", "", str(warning.message))
        for warning in caught
        if issubclass(warning.category, ModelWarning)
    ]
    if case is None:
        return CaseCheck(None, tuple(remarks))
    remarks += check_recordings(case)
    try:
        case, references = with_torque(case)
        progress("looks at the motion and the torque")
        motions = _of_signals(case, references, remarks)
    except GapscopeError as error:
        remarks.append(_as_remark(error, "torque"))
        motions = None
    return CaseCheck(case, tuple(remarks), motions)


def _of_signals(
    case: Case, references: Sequence[FoundFault], remarks: list[Remark]
) -> JointMotions:
    """Add remarks on the motion, the torque and the nominal arm of a case with torque; how the joints move."""
    columns = ModelColumns(case.arm)
    cutoff = position_cutoff(case.recordings)
    segments = list(_segments(case, cutoff))
    motions = joint_motions(columns, segments)
    remarks += check_ranges(case, columns.body)
    remarks += check_set_up(case, references)
    remarks += check_motion(motions, case.arm.per_radian)
    remarks += check_nominal(case, columns.body)
    remarks += check_controller(case)
    return motions


def _read(path: Path) -> tuple[Case | None, list[Remark]]:
    """The case, as far as a diagnosis reads it, and why it is refused otherwise."""
    try:
        return load_case(path), [
            Remark("ok", "case", "", "case file, robot and recordings can be read")
        ]
    except InputError as error:
        strict = error
    try:
        case = load_case(path, any_unit=True)
    except InputError as error:
        return None, [_as_remark(error, "case")]
    remark = _as_remark(strict, "case")
    said = f"{remark.said}; the diagnosis tests for this fault, all other commands refuse the case"
    return case, [replace(remark, level="warn", said=said)]


def _as_remark(error: GapscopeError, topic: str) -> Remark:
    said = str(error).split("\n  remedy: ")[0]
    return Remark("error", topic, "", said, error.remedy)


def _segments(case: Case, cutoff: float) -> Iterator[Segment]:
    """The first seconds of each recording that is fitted, thinned.

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """
    for recording in case.recordings:
        first = recording.part(recording.t <= recording.t[0] + SECONDS)
        for segment in condition(first):
            yield thinned(segment, max(RATE, 3 * cutoff))
