"""Compare the recordings of a case: which parameters agree, which differ, and which value to trust."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType

from gapscope.arm.case import Case, load_case
from gapscope.diagnosis.agreement import Agreement, agreement, document
from gapscope.interface.result import Result
from gapscope.reports.agreement import summary, write_agreement

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class AgreementResult(Result):
    """Whether recordings agree.

    Attributes:
        agreement: verdict, values and deviations of each parameter.
    """

    agreement: Agreement

    @property
    def document(self) -> dict[str, Any]:
        """The content of ``agreement.json``."""
        return document(self.agreement)

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``agreement.html`` and, as the last, ``agreement.json``."""
        return write_agreement(self.agreement, Path(folder))

    def shown(self) -> RenderableType:
        """One line per parameter, and what the differences go with."""
        return summary(self.document)

    def to_frame(self) -> pd.DataFrame:
        """A row for each parameter and recording: verdict, value and standard deviation."""
        import pandas as pd

        content = self.document
        rows = [
            {
                "parameter": line["key"],
                "unit": line["unit"],
                "verdict": line["verdict"],
                "recording": recording,
                "value": line["values"][k],
                "std": line["std"][k],
            }
            for line in content["parameters"]
            for k, recording in enumerate(content["recordings"])
        ]
        return pd.DataFrame(rows)


def agree(
    case: Case | str | Path, *, progress: Callable[[str], None] = lambda message: None
) -> AgreementResult:
    """Compare the recordings of a case, parameter by parameter.

    Args:
        case: the case, or its folder; held-out recordings are compared too.
        progress: called with a few words at each step.

    Raises:
        InputError: the case cannot be used, or has fewer than two recordings with torque.

    Examples:
        >>> import gapscope
        >>> gapscope.agree("my_arm").to_frame()  # doctest: +SKIP
    """
    progress("reads the case")
    loaded = case if isinstance(case, Case) else load_case(case)
    return AgreementResult(agreement(loaded, progress))
