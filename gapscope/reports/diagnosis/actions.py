"""What to do after a diagnosis: a sentence each, with the command if there is one."""

from __future__ import annotations

from typing import NamedTuple

from gapscope.diagnosis.document.wording import joint_names
from gapscope.diagnosis.result import Diagnosis

OF_COLUMNS = (
    "motion",
    "torque",
    "time_factor",
    "torque_delay",
    "gravity",
    "link_shift",
)
"""What a reading changes of a log's columns, or of the robot that goes with them."""


class Action(NamedTuple):
    """One thing to do, and the command for it; empty if there is none."""

    text: str
    command: str = ""


def actions(diagnosis: Diagnosis) -> list[Action]:
    """What a reader would do next, the most pressing first."""
    document = diagnosis.document
    found = []
    n = len(joint_names(document))
    if any(fault.reading(n).differs(*OF_COLUMNS) for fault in diagnosis.faults):
        found.append(
            Action(
                "Read the logs as they are meant: mended_case.yaml, beside this page, does",
                "gapscope diagnose mended_case.yaml --out mended",
            )
        )
    if diagnosis.effects:
        found.append(
            Action(
                "Give the effects found to your simulator",
                "gapscope export corrected.yaml --case CASE --format mjcf --out arm.xml",
            )
        )
    if document["next_recording"]:
        found.append(
            Action(
                f"Record next: {document['next_recording']}",
                "gapscope advise CASE --out next.csv",
            )
        )
    if document["unexplained"]["above_floor"]:
        found.append(
            Action("Look at what stays unexplained: it says where and how the gap acts")
        )
    if not found:
        found.append(
            Action(
                "Nothing: the arm is as its model says, within what a healthy arm leaves"
            )
        )
    return found
