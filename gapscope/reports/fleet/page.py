"""The page of a fleet: ``fleet.html``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gapscope.arm.display import percent
from gapscope.diagnosis.document.wording import VERDICTS
from gapscope.reports.fleet.sparkline import sparkline
from gapscope.reports.fleet.wording import (
    change_words,
    headline,
    place_words,
    value_words,
)
from gapscope.reports.pages import write_html

REPORT, DOCUMENT = "report.html", "diagnosis.json"
KINDS = {
    "shared": "on all units, alike",
    "shared_differing_size": "on all units, of different size",
    "some_units": "on some units",
    "one_unit": "on one unit",
}


def render_fleet(content: Mapping[str, Any], path: Path, *, reports: bool) -> None:
    """Write the page.

    Args:
        content: of ``fleet.json``.
        path: the page, in the folder of the results.
        reports: whether diagnoses were kept with their reports, which are linked then.

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    write_html(
        "fleet/fleet.html",
        path,
        fleet=content,
        headline=headline(content),
        kinds=KINDS,
        verdicts=VERDICTS,
        place=place_words,
        change_words=change_words,
        value_words=value_words,
        sparkline=sparkline,
        false_share=percent(content["false_share"]),
        linked=REPORT if reports else DOCUMENT,
    )
