"""What the project depends on: pinned by version and hash, and under licences that are allowed."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

if sys.version_info < (3, 11):
    import tomli as tomllib
else:
    import tomllib

ROOT = Path(__file__).parents[1]
SETS = {path.stem: path for path in (ROOT / "requirements").glob("*.txt")}
WITHOUT_HASH = {"torch"}
"""Its file depends on the index; see docs/security.md."""


sys.path.append(str(ROOT / ".ci"))
LOCK, LICENCES = map(importlib.import_module, ("lock", "licences"))


def names(requirements: list[str]) -> set[str]:
    """Normalised names of requirements."""
    found = (re.match(r"[\w.-]+", text) for text in requirements)
    return {LICENCES.normalised(match[0]) for match in found if match}


def needed() -> Iterator[tuple[str, set[str]]]:
    """Each set that users install, and the packages that ``pyproject.toml`` asks of it."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    project = tomllib.loads(text)["project"]
    extras = project["optional-dependencies"]
    yield "core", names(project["dependencies"])
    yield "dev", names(extras["dev"])
    yield "docs", names(extras["docs"])
    yield "learn", names(extras["learn"]) | names(extras["cluster"])


@pytest.mark.parametrize("name", sorted(SETS))
def test_every_package_has_hashes_and_the_version_of_the_constraints(name):
    blocks = LOCK.blocks(SETS[name].read_text(encoding="utf-8").split("\n", 1)[1])
    assert blocks
    for line, hashes in blocks.items():
        assert re.fullmatch(r"(\s+--hash=sha256:[0-9a-f]{64}( \\)?\n)+", hashes), line
    assert not LOCK.unpinned(list(blocks))


@pytest.mark.parametrize(
    # the packages of a set have no order, and would name tests differently in every process
    ("name", "asked"),
    [pytest.param(name, asked, id=name) for name, asked in needed()],
)
def test_what_the_project_asks_for_is_locked(name, asked):
    files = (*LOCK.SETS[name].after, name)
    held = {
        package
        for file in files
        for package in re.findall(r"^([\w.-]+)==", SETS[file].read_text(), re.MULTILINE)
    }
    assert asked - held <= WITHOUT_HASH, "make lock"


@pytest.mark.parametrize(
    ("licence", "allowed"),
    [
        ("MIT", True),
        ("BSD-2-Clause AND Apache-2.0 WITH LLVM-exception", True),
        ("GPL-3.0-or-later OR MIT", True),
        ("MIT AND GPL-2.0-only", False),
        ("GNU Lesser General Public License v3 (LGPLv3)", False),
        ("AGPL-3.0", False),
        ("Proprietary", False),
    ],
)
def test_licences_are_told_apart(licence, allowed):
    assert LICENCES.allowed(licence) == allowed


def test_every_dependency_has_a_licence_that_is_allowed_and_is_listed():
    page = LICENCES.PAGE.read_text(encoding="utf-8")
    found = LICENCES.licences(sys.path, page)
    assert not LICENCES.problems(found)
    assert set(LICENCES.listed(page)) == set(found), "make licences"
