"""Diagnose a fleet: many cases at any address, compared between units and over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import RenderableType

from gapscope.arm.io.json_file import write_json
from gapscope.fleets.fleet import fleet_document
from gapscope.fleets.run import ALL, FleetCounts, FleetPlan, run_fleet
from gapscope.fleets.store import FleetStore
from gapscope.interface.result import Result
from gapscope.reports.fleet import render_fleet, summary

DOCUMENT, PAGE = "fleet.json", "fleet.html"


@dataclass(frozen=True, repr=False)
class FleetOverview(Result):
    """The diagnoses of a fleet, compared.

    Attributes:
        store: all rows, as Parquet.
        document: the content of ``fleet.json``.
        counts: what this run did.
        reports: whether reports of the diagnoses were kept.
    """

    store: FleetStore
    document: dict[str, Any]
    counts: FleetCounts
    reports: bool = False

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``fleet.html`` and, as the last, ``fleet.json``.

        Links of the page lead to diagnoses only in the folder of the run.
        """
        page, document = Path(folder) / PAGE, Path(folder) / DOCUMENT
        render_fleet(self.document, page, reports=self.reports)
        write_json(self.document, document)
        return page, document

    def shown(self) -> RenderableType:
        """What changed, and the worst units."""
        return summary(self.document)

    def to_frame(self) -> pd.DataFrame:
        """A row for each case: verdict, gap, effects, seconds, error; ``store.effects`` has the numbers."""
        return self.store.cases()


def fleet(
    cases: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    progress: Callable[[str], None] = lambda message: None,
    **options: Any,
) -> FleetOverview:
    """Diagnose all cases that have not been diagnosed yet, and compare units and dates.

    Args:
        cases: addresses of cases, of folders or archives of them, or of lists; paths, or URLs that fsspec knows.
        out: folder of the results, which later runs add to.
        progress: called with a few words at each step.
        **options: ``jobs``, ``backend``, ``again``, ``keep``, ``units_by``, ``largest``, ``scratch``, ``tries`` of
            ``gapscope.fleets.run.FleetPlan``.

    Raises:
        InputError: an option or an address cannot be used.
        GapscopeError: another run writes to ``out``, or the run was stopped.

    Examples:
        >>> import gapscope
        >>> overview = gapscope.fleet("s3://robots/cases", "fleet", jobs=8)  # doctest: +SKIP
        >>> overview.document["changes"]  # doctest: +SKIP
    """
    several = [cases] if isinstance(cases, (str, Path)) else cases
    plan = FleetPlan(tuple(str(case) for case in several), Path(out), **options)
    counts = run_fleet(plan, progress)
    progress("compares units and dates")
    store = FleetStore(plan.out)
    overview = FleetOverview(
        store, fleet_document(store), counts, reports=plan.keep == ALL
    )
    overview.save(plan.out)
    return overview
