"""The worked example of ``docs/own_effect.md``: the effect of a user that the tests read from there."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "own_effect.md"


def blocks(language: str) -> list[str]:
    """The blocks of code of the page in a language, in order."""
    text = PAGE.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def write_example(folder: Path) -> Path:
    """Write the file of the example into a folder."""
    file = folder / "cable_drag.py"
    file.write_text(blocks("python")[0], encoding="utf-8")
    return file
