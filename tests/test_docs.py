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
def test_what_a_page_names_exists_and_its_lines_are_readable(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    now = GONE.sub("", text)
    roots = (page.parent, ROOT, ROOT / "docs")
    named = {
        *((path, (ROOT,)) for path in PATH.findall(now)),
        *((link, (page.parent,)) for link in LINK.findall(text)),
        *((other, roots) for other in PAGE.findall(text)),
    }
    lost = {
        path
        for path, places in named
        if path not in NO_FILES and not any((x / path).exists() for x in places)
    }
    assert lost | set(SCRIPT.findall(now)) - set(SCRIPTS) == set()

    lines = re.sub(r"```.*?```", "", text, flags=re.DOTALL).splitlines()
    plain = [line for line in lines if not line.lstrip().startswith(("|", "#"))]
    assert max(map(len, plain)) <= LINE_LENGTH


def test_every_script_has_a_page_that_names_it() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert set(SCRIPT.findall(text)) >= set(SCRIPTS)


def test_the_table_of_scripts_is_up_to_date(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "experiments")
    table = importlib.import_module("20_pages").scripts_page()
    written = (ROOT / "experiments/README.md").read_text(encoding="utf-8")
    assert written == table, "run experiments/20_pages.py scripts"


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs/README.md").read_text(encoding="utf-8")
    listed = {(ROOT / "docs" / link).resolve() for link in LINK.findall(index)}
    pages = {page.resolve() for page in (ROOT / "docs").rglob("*.md")}
    assert pages - listed == {(ROOT / "docs/README.md").resolve()}


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    listed = re.findall(r"[\w/]+\.md", str(yaml.safe_load(site)["nav"]))
    docs = ROOT / "docs"
    pages = [page.relative_to(docs).as_posix() for page in docs.rglob("*.md")]
    assert sorted(listed) == sorted(pages)


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


def test_the_python_page_lists_the_interface_and_the_reference_describes_it() -> None:
    text = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `(\w+)\(", text, flags=re.MULTILINE))
    assert listed | {"Case"} == set(gapscope.__all__)
    text = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    described = re.findall(r"^::: gapscope\.(\w+)$", text, flags=re.MULTILINE)
    assert sorted(described) == sorted(gapscope.__all__)
