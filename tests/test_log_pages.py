"""The cases on the page of log formats follow the case format, and its formats are those that are read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from gapscope.arm.io.case_file import check
from gapscope.arm.io.import_section import parse_import
from gapscope.arm.io.layouts import LAYOUTS
from gapscope.arm.io.log import READERS

PAGE = Path(__file__).parents[1] / "docs" / "logs.md"
TEXT = PAGE.read_text(encoding="utf-8")
CASES = [
    yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", TEXT, re.S)
]


def joints_of(case: dict[str, Any]) -> int:
    """Number of joints n that the lists of a case stand for."""
    section = case.get("import", {})
    tau = section.get("tau") or {}
    lists = [case.get("joints"), section.get("joints")]
    lists.append(tau.get("motor_constant") if isinstance(tau, dict) else None)
    return next((len(x) for x in lists if isinstance(x, list)), 6)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_cases_of_the_page_are_valid(case: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "case.yaml"
    check(case, file)
    section = dict(case.get("import", {}))
    # the arm's own file, which is not part of the project
    section.pop("calibration", None)
    importing = parse_import(section, joints_of(case), file)
    assert importing.channels["q"] is not None


def test_every_reader_is_on_the_page() -> None:
    assert {ending for ending in READERS if f"`{ending}`" not in TEXT} == set()


def test_columns_of_the_page_are_those_of_the_known_layouts() -> None:
    known = {
        place.column
        for layout in LAYOUTS
        for places in layout.places.values()
        for place in places
    }
    patterns = set(re.findall(r'column: "([^"]+)"', TEXT))
    assert patterns <= known
