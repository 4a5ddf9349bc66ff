"""The reference pages of case files: generated from the schema, which describes every key."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from gapscope.arm.io.case_file import check

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "experiments"))
SCRIPT = import_module("20_pages")
SCHEMA = json.loads(SCRIPT.SCHEMA.read_text(encoding="utf-8"))


def keys(value: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """All keys of the schema that a file may hold, with what the schema says of them."""
    if isinstance(value, dict):
        for key, given in value.get("properties", {}).items():
            referred = SCHEMA["$defs"].get(given.get("$ref", "").rpartition("/")[2], {})
            yield f"{path}.{key}", referred | given
            yield from keys(given, f"{path}.{key}")
        for key in ("items", "additionalProperties"):
            yield from keys(value.get(key), f"{path}[]")


EVERY = list(keys(SCHEMA))
for name, part in SCHEMA["$defs"].items():
    EVERY += keys(part, name)


@pytest.mark.parametrize("name", ["case.md", "controller.md", "import.md"])
def test_pages_are_up_to_date(name: str) -> None:
    written = (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8")
    assert written == SCRIPT.pages(SCHEMA)[name], "run 20_pages.py reference"


def test_every_key_has_a_description() -> None:
    assert len(EVERY) > 80
    assert [path for path, given in EVERY if not given.get("description")] == []


def test_every_number_of_the_data_sheet_and_controller_has_a_unit() -> None:
    sections = [SCHEMA["properties"][name] for name in ("nominal", "controller")]
    unitless = {"rate", "kind", "kp", "kd", "ki"}  # their units go with kind
    for path, given in (found for section in sections for found in keys(section)):
        kind = given.get("type"), given.get("items", {}).get("type")
        if kind[0] == "number" or kind[1] == "number":
            assert "[" in given["description"] or path[1:] in unitless, path


def test_examples_are_valid() -> None:
    content: dict[str, Any] = {"name": "a", "robot": "r.urdf", "recordings": ["a.csv"]}
    for key, given in SCHEMA["properties"].items():
        for example in given.get("examples", ()):
            check({**content, key: example}, Path("case.yaml"))
    for section in ("nominal", "import"):
        for key, given in SCHEMA["properties"][section]["properties"].items():
            for example in given.get("examples", ()):
                check({**content, section: {key: example}}, Path("case.yaml"))
