"""The document of the check of a case, ``check.json``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from gapscope.arm.io.json_file import plain
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.case_check.check import CaseCheck


def document(check: CaseCheck) -> dict[str, Any]:
    """The check of a case as plain data; what is not known is null."""
    case = check.case
    content = {
        "schema": 1,
        "case": None if case is None else case.name,
        "can_be_diagnosed": check.can_be_diagnosed,
        "remarks": [asdict(remark) for remark in check.remarks],
        "recordings": [],
        "joints": [],
        "excited": None if check.motions is None else check.motions.excited,
    }
    if case is not None:
        content["recordings"] = [
            {**_recording(recording), "held_out": held_out}
            for group, held_out in ((case.recordings, False), (case.judged, True))
            for recording in group
        ]
        content["joints"] = _joints(check)
    result: dict[str, Any] = plain(content, null_if_not_finite=True)
    return result


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "name": recording.name,
        "duration": recording.duration,
        "rate": recording.rate,
        "samples": len(recording.t),
        "channels": [x for x in CHANNELS if getattr(recording, x) is not None],
    }


def _joints(check: CaseCheck) -> list[dict[str, Any]]:
    """How each joint moves; only the names if that is not known."""
    assert check.case is not None
    motions = check.motions
    if motions is None:
        return [{"name": name} for name in check.case.arm.joints]
    names = ("range", "slow", "fast", "reversals", "gravity", "possible_gravity")
    return [
        {"name": joint, **{name: getattr(motions, name)[j] for name in names}}
        for j, joint in enumerate(check.case.arm.joints)
    ]
