"""The summary of several cases: one row each, with a link to its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from gapscope.arm.display import effect_name
from gapscope.diagnosis.document.wording import VERDICTS, acts_on
from gapscope.reports.diagnosis import fleet_section as units_words
from gapscope.reports.pages import write_html

_COUNTED = {
    "effects_found": "with effects found",
    "no_gap": "without a gap",
    "unexplained": "with an unexplained gap",
    "failed": "failed",
}


@dataclass(frozen=True)
class SummaryRow:
    """One case in the summary.

    Attributes:
        name: name of the case.
        folder: folder of its report, relative to the summary.
        document: its diagnosis, or ``None`` if it failed.
        failure: why it failed.
    """

    name: str
    folder: str
    document: Mapping[str, Any] | None = None
    failure: str = ""

    @property
    def label(self) -> str:
        """Name of the case, with its folder if that has another name."""
        return self.name if self.folder == self.name else f"{self.name} ({self.folder})"

    @property
    def link(self) -> str:
        """Relative address of the report."""
        return f"./{quote(self.folder)}/report.html"

    @property
    def verdict(self) -> str:
        """Verdict as a label."""
        return "Failed" if self.document is None else VERDICTS[self.document["verdict"]]

    @property
    def kind(self) -> str:
        """Verdict as a key: one of the three, or ``failed``."""
        return "failed" if self.document is None else self.document["verdict"]

    @property
    def effects(self) -> list[tuple[str, str]]:
        """Effects found, each with what it acts on."""
        found = [] if self.document is None else self.document["effects"]
        return [(effect_name(entry["effect"]), acts_on(entry)) for entry in found]

    @property
    def possible(self) -> list[tuple[str, str]]:
        """Effects that are possible and not confirmed, each with what it acts on."""
        found = [] if self.document is None else self.document["possible"]
        return [(effect_name(entry["effect"]), acts_on(entry)) for entry in found]

    @property
    def closed(self) -> float | None:
        """Share of the gap above the floor that is closed [1]; ``None`` if there is no gap."""
        if self.document is None or self.document["verdict"] == "no_gap":
            return None
        return self.document["closed"]

    def mean_gap(self, stage: str) -> float | None:
        """Torque NRMSE ``before`` or ``after``, mean over the joints [1]."""
        values = (
            [] if self.document is None else self.document["gap"][stage]["torque_nrmse"]
        )
        known = [value for value in values if value is not None]
        return sum(known) / len(known) if known else None


def render_summary(
    rows: Sequence[SummaryRow], path: Path | str, units: Mapping[str, Any] | None = None
) -> None:
    """Write the summary of several cases, in the order given.

    Args:
        rows: one per case.
        path: file to write.
        units: content of ``units.json``, the comparison of the cases as units of one type of arm.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    counts = {
        label: sum(row.kind == kind for row in rows) for kind, label in _COUNTED.items()
    }
    compared = units["groups"] if units is not None else []
    write_html(
        "diagnosis/summary.html",
        path,
        rows=rows,
        counts=counts,
        groups=compared,
        words=units_words,
    )
