"""Measure the gap alone: per recording and joint, of torque and of replay."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gapscope.arm.case import Case
from gapscope.interface.models import Model, case_of, corrected_arm
from gapscope.interface.result import Document, DocumentResult
from gapscope.reports.gap import gap_document, gap_tables


def gap(case: Case | str | Path, model: Model = None) -> DocumentResult:
    """Measure the torque gap and the replay gap of a nominal or corrected arm on every recording of a case.

    Recordings are taken as they are, even if they look as if they were in another unit; the document's ``warnings``
    say so. Of each it has ``torque_nrmse`` [1], ``torque_rmse`` [N m] and ``replay_rmse`` [rad], per joint.

    Args:
        case: the case, or its folder.
        model: what corrects the nominal arm; see ``Model``.

    Raises:
        InputError: the case or the model cannot be used.
        GapscopeError: no recording carries a torque.

    Examples:
        >>> import gapscope
        >>> gapscope.gap("my_arm", "out/corrected.yaml").to_frame()  # doctest: +SKIP
    """
    loaded = case_of(case, any_unit=True)
    content = gap_document(loaded, corrected_arm(loaded.arm, model))
    return DocumentResult("gap", content, gap_tables, _rows)


def _rows(content: Document) -> Iterator[dict[str, Any]]:
    """A row for each recording and joint."""
    for recording in content["recordings"]:
        for joint, name in enumerate(content["joints"]):
            row = {"recording": recording["recording"], "joint": name}
            for key in ("torque_nrmse", "torque_rmse", "replay_rmse"):
                row[key] = None if recording[key] is None else recording[key][joint]
            yield row
