"""Diagnose a fleet: many cases at any address, compared between units and over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import pandas as pd

from gapscope.diagnosis.prepare import Progress, silent
from gapscope.fleets.fleet import fleet_document
from gapscope.fleets.run import ALL, FleetCounts, FleetPlan, run_fleet
from gapscope.fleets.store import FleetStore
from gapscope.interface.result import DocumentResult
from gapscope.reports.fleet import render_fleet, summary

DOCUMENT, PAGE = "fleet.json", "fleet.html"


@dataclass(frozen=True, repr=False, kw_only=True)
class FleetOverview(DocumentResult):
    """The diagnoses of a fleet, compared; links of the page lead to diagnoses only in the folder of the run.

    Attributes:
        store: all rows, as Parquet.
        counts: what this run did.
    """

    store: FleetStore
    counts: FleetCounts

    def to_frame(self) -> pd.DataFrame:
        """A row for each case: verdict, gap, effects, seconds, error; ``store.effects`` has the numbers."""
        return self.store.cases()


def fleet(
    cases: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    progress: Progress = silent,
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
        name="fleet",
        document=fleet_document(store),
        text=summary,
        rows=itemgetter("worst"),
        page=partial(render_fleet, reports=plan.keep == ALL),
        store=store,
        counts=counts,
    )
    overview.save(plan.out)
    return overview
