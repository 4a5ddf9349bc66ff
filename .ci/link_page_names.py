"""Hook of the site: a page that is named in text, `diagnosis.md` say, becomes a link to it."""

from __future__ import annotations

import os
import re
from pathlib import PurePosixPath
from typing import Any

NAMED = re.compile(r"(?<!\[)`([\w/]+\.md)`")
"""Name of a page as code that is not the text of a link already."""


def on_page_markdown(text: str, page: Any, config: Any, files: Any) -> str:
    """Text of a page with links in it; names are relative to the page or to the folder of the documentation."""
    folder = PurePosixPath(page.file.src_uri).parent

    def linked(match: re.Match[str]) -> str:
        named = match[1].removeprefix("docs/")
        for place in (folder / named, PurePosixPath(named)):
            if files.get_file_from_path(str(place)) is not None:
                return f"[{match[0]}]({os.path.relpath(place, folder)})"
        return match[0]

    return NAMED.sub(linked, text)
