"""Hook of the site: the pages are written for readers of the repository, and differ on the site in two things.

A page that is named in text, `diagnosis.md` say, becomes a link to it. In tables, code loses the backslash before a
vertical bar, which GitHub needs and Python-Markdown shows.
"""

from __future__ import annotations

import os
import re
from pathlib import PurePosixPath
from typing import Any

NAMED = re.compile(r"(?<!\[)`([\w/]+\.md)`")
"""Name of a page as code that is not the text of a link already."""
ROW = re.compile(r"^\|.*$", re.MULTILINE)
CODE = re.compile(r"`[^`]+`")


def on_page_markdown(text: str, page: Any, config: Any, files: Any) -> str:
    """Text of a page as the site shows it."""
    folder = PurePosixPath(page.file.src_uri).parent
    return ROW.sub(_plain_bars, _linked(text, folder, files))


def _linked(text: str, folder: PurePosixPath, files: Any) -> str:
    """Text with links to the pages that it names, relative to its folder or to that of the documentation."""

    def link(match: re.Match[str]) -> str:
        named = match[1].removeprefix("docs/")
        for place in (folder / named, PurePosixPath(named)):
            if files.get_file_from_path(str(place)) is not None:
                return f"[{match[0]}]({os.path.relpath(place, folder)})"
        return match[0]

    return NAMED.sub(link, text)


def _plain_bars(row: re.Match[str]) -> str:
    """Row of a table with plain vertical bars in its code."""
    return CODE.sub(lambda code: code[0].replace("\\|", "|"), row[0])
