"""The pages of ``docs/effects`` hold the catalogue as it is."""

import importlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "experiments"))
catalogue = importlib.import_module("20_pages")


@pytest.mark.parametrize(
    "effect", catalogue.CATALOGUE.values(), ids=catalogue.CATALOGUE
)
def test_each_effect_stands_on_the_page_of_its_family(effect: object) -> None:
    page = (ROOT / "docs" / "effects" / f"{effect.family}.md").read_text(
        encoding="utf-8"
    )
    assert all(row in page for row in catalogue.effect_rows(effect)), (
        "run experiments/20_pages.py catalogue and take its table over"
    )


@pytest.mark.parametrize("fault", catalogue.FAULTS.values(), ids=catalogue.FAULTS)
def test_each_fault_stands_on_the_page_of_faults(fault: type) -> None:
    page = (ROOT / "docs" / "effects" / "faults.md").read_text(encoding="utf-8")
    assert all(row in page for row in catalogue.fault_rows(fault))
    assert f"- `{fault.name}`:" in page
