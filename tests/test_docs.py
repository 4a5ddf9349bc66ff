"""The pages of the documentation name files that exist, and stay readable."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest
import yaml

import gapscope

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
)
PATH = re.compile(r"`((?:gapscope|docs|experiments|tests)/[\w./-]+)`")
SCRIPT = re.compile(r"(?:experiments/|`)(\d\d_\w+\.py)")
GONE = re.compile(
    r"`(?:experiments/)?\w+\.py[^`]*`,?\s\(?(?:at\s)?commit\s[0-9a-f]{7}\b"
)
"""A script that is gone, named with the commit that holds it."""
SCRIPTS = sorted(path.name for path in (ROOT / "experiments").glob("[0-9]*.py"))
LINK = re.compile(r"\]\(([^)#:]+)\)")
PAGE = re.compile(r"`([\w/]+\.md)`")
NO_FILES = {"gapscope/ArmTracking-v0", "score.md"}
"""Look like paths: the name of the environment in Gymnasium, and a file that a command writes."""
README_LINES = 120
"""Most lines of the README."""
WORDS = 50_000
"""Most words of README and pages together: what a reader can find his way in."""
LINE_LENGTH = 120
"""Most characters in a line outside tables and code."""


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_named_files_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = set(PATH.findall(GONE.sub("", text))) - NO_FILES
    assert {path for path in named if not (ROOT / path).exists()} == set()


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_named_scripts_exist_or_have_a_commit(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert set(SCRIPT.findall(GONE.sub("", text))) <= set(SCRIPTS)


def test_every_script_has_a_page_that_names_it() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert set(SCRIPT.findall(text)) >= set(SCRIPTS)


def test_the_table_of_scripts_is_up_to_date(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "experiments")
    table = importlib.import_module("20_pages").scripts_page()
    written = (ROOT / "experiments/README.md").read_text(encoding="utf-8")
    assert written == table, "run experiments/20_pages.py scripts"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_and_page_names_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = [link for link in LINK.findall(text) if not (page.parent / link).exists()]
    roots = (page.parent, ROOT, ROOT / "docs")
    pages = [
        other
        for other in set(PAGE.findall(text)) - NO_FILES
        if not any((root / other).exists() for root in roots)
    ]
    assert links + pages == []


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs/README.md").read_text(encoding="utf-8")
    listed = {(ROOT / "docs" / link).resolve() for link in LINK.findall(index)}
    pages = set((ROOT / "docs").rglob("*.md")) - {ROOT / "docs/README.md"}
    assert {page.resolve() for page in pages} <= listed


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    listed = re.findall(r"[\w/]+\.md", str(yaml.safe_load(site)["nav"]))
    pages = [
        page.relative_to(ROOT / "docs").as_posix()
        for page in (ROOT / "docs").rglob("*.md")
    ]
    assert sorted(listed) == sorted(pages)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_lines_of_text_are_of_readable_length(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = [
        line for line in text.splitlines() if not line.lstrip().startswith(("|", "#"))
    ]
    assert max(map(len, lines)) <= LINE_LENGTH


def test_readme_is_short() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= README_LINES


def test_the_documentation_is_no_longer_than_a_reader_bears() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    assert sum(len(p.read_text(encoding="utf-8").split()) for p in pages) <= WORDS


def test_the_python_page_makes_a_case_without_files() -> None:
    text = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    example = text.split("```python\n")[2].split("```")[0]
    names: dict[str, object] = {}
    exec(compile(example, "docs/python.md", "exec"), names)
    assert names["case"].arm.n_joints == 7


def test_the_python_page_lists_the_interface() -> None:
    text = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `(\w+)\(", text, flags=re.MULTILINE))
    assert listed | {"Case"} == set(gapscope.__all__)


def test_the_python_reference_describes_the_interface() -> None:
    text = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    described = re.findall(r"^::: gapscope\.(\w+)$", text, flags=re.MULTILINE)
    assert sorted(described) == sorted(gapscope.__all__)
