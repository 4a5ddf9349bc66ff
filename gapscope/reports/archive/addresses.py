"""Addresses of the pages and files of an archive, as its server takes them."""

from __future__ import annotations

import os
from urllib.parse import quote

from gapscope.archive.entry import Entry

FILES, UNITS = "files", "unit"
"""First parts of an address: below them are the files of results, and a page for each unit."""


def file_address(entry: Entry, name: str) -> str:
    """Address of a file beside a diagnosis."""
    folder = "" if entry.folder == "." else f"{_quoted(entry.folder, '/')}/"
    return f"/{FILES}/{folder}{name}"


def unit_address(unit: str) -> str:
    """Address of the page of a unit."""
    return f"/{UNITS}/{_quoted(unit)}"


def _quoted(name: str, safe: str = "") -> str:
    # as bytes: a name on disk need not be valid text
    return quote(os.fsencode(name), safe=safe)
