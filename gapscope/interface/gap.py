"""Measure the gap alone: per recording and joint, of torque and of replay."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType

from gapscope.arm.case import Case, load_case
from gapscope.arm.io.atomic_write import make_folder
from gapscope.arm.io.json_file import write_json
from gapscope.interface.models import Model, corrected_arm
from gapscope.interface.result import Result
from gapscope.reports.gap import gap_document, gap_tables

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class GapResult(Result):
    """The gap of an arm on the recordings of a case.

    Attributes:
        document: per recording ``torque_nrmse`` [1], ``torque_rmse`` [N m] and ``replay_rmse`` [rad], per joint.
    """

    document: dict[str, Any]

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``gap.json``."""
        make_folder(Path(folder))
        file = Path(folder) / "gap.json"
        write_json(self.document, file)
        return (file,)

    def shown(self) -> RenderableType:
        """Both gaps as tables."""
        return gap_tables(self.document)

    def to_frame(self) -> pd.DataFrame:
        """A row for each recording and joint."""
        import pandas as pd

        rows = []
        for recording in self.document["recordings"]:
            for joint, name in enumerate(self.document["joints"]):
                row = {"recording": recording["recording"], "joint": name}
                for key in ("torque_nrmse", "torque_rmse", "replay_rmse"):
                    row[key] = None if recording[key] is None else recording[key][joint]
                rows.append(row)
        return pd.DataFrame(rows)


def gap(case: Case | str | Path, model: Model = None) -> GapResult:
    """Measure the torque gap and the replay gap of a nominal or corrected arm on every recording of a case.

    Recordings are taken as they are, even if they look as if they were in another unit; the document's ``warnings``
    say so.

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
    loaded = case if isinstance(case, Case) else load_case(case, any_unit=True)
    return GapResult(gap_document(loaded, corrected_arm(loaded.arm, model)))
