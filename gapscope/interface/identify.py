"""Identify an arm: base and physical parameters, friction and joint zeros, with intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import begin_results
from gapscope.diagnosis.set_up import look_at_set_up
from gapscope.diagnosis.told_controller import with_told_controller
from gapscope.ident.identification import Identification, IdentificationSettings
from gapscope.ident.identification import identify as identify_case
from gapscope.interface.models import case_file, case_of
from gapscope.interface.result import Result
from gapscope.reports.identification import DOCUMENT, summary, write_identification

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class IdentificationResult(Result):
    """What was identified.

    Attributes:
        identification: parameters, intervals, validation, warnings.
    """

    identification: Identification

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write report, identified arm, base parameters and, as the last, ``identification.json``."""
        out = Path(folder)
        begin_results(out, DOCUMENT)
        source = case_file(self.identification.case, out)
        return write_identification(self.identification, source, out)

    def shown(self) -> RenderableType:
        """Errors per joint, what was fitted and found, and what is doubtful."""
        return summary(self.identification)

    def to_frame(self) -> pd.DataFrame:
        """A row for each base parameter: value and standard deviation."""
        import pandas as pd

        result = self.identification
        # of base parameters: those of single bodies have none
        deviation = np.sqrt(np.diag(result.uncertainty.covariance))
        columns = {"value": result.estimate.value, "std": deviation}
        names = pd.Index(result.base.expressions(), name="parameter")
        return pd.DataFrame(columns, index=names)


def identify(
    case: Case | str | Path,
    settings: IdentificationSettings | None = None,
    *,
    progress: Callable[[str], None] = lambda message: None,
) -> IdentificationResult:
    """Identify the arm of a case from its recordings.

    Args:
        case: the case, or its folder.
        settings: cut-off, estimator, recordings that are held out.
        progress: called with a few words at each step.

    Raises:
        InputError: the case cannot be identified from.
        GapscopeError: no physically consistent parameters were found.

    Examples:
        >>> import gapscope
        >>> gapscope.identify("my_arm").save("out")  # doctest: +SKIP
    """
    progress("reads the case")
    chosen = settings or IdentificationSettings()
    read, told = with_told_controller(case_of(case))
    if told is not None:
        read = replace(read, warnings=(*read.warnings, *told.sentences()))
    progress("tests the set-up")
    # a diagnosis puts faults of the set-up right, an identification only names them
    read = _as_recorded(read, any_torque=chosen.any_torque)
    return IdentificationResult(identify_case(read, chosen, progress))


def _as_recorded(case: Case, *, any_torque: bool) -> Case:
    """The case with warnings of what its torque shows of the set-up.

    Raises:
        InputError: it reads its log wrongly, or says another gravity, and not ``any_torque``.
    """
    set_up = look_at_set_up(case)
    doubts = [remark for remark in set_up.remarks() if remark.level != "ok"]
    # bodies fitted to a log that is misread are those of no arm
    if set_up.misreads and not any_torque:
        raise InputError(
            "the case does not say what its log shows: "
            + "; ".join(doubt.text for doubt in doubts),
            "; ".join(
                [*(doubt.remedy for doubt in doubts), "or go on with --any-torque"]
            ),
            file=case.name,
        )
    # what else is doubtful does not stop it: it is said with the result
    said = (f"{doubt.text}; {doubt.remedy}" for doubt in doubts)
    return replace(case, warnings=(*case.warnings, *said))
