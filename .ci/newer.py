"""Print the installed packages that are newer than the pinned ones.

python .ci/newer.py constraints.txt
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def main(file: str) -> None:
    """Print a line for each package that differs."""
    text = Path(file).read_text(encoding="utf-8")
    pins: dict[str, list[str]] = {}
    for name, pin in re.findall(r"^([\w.-]+)==([^\s;]+)", text, re.MULTILINE):
        pins.setdefault(name, []).append(pin)
    for name, known in pins.items():
        try:
            installed = version(name)
        except PackageNotFoundError:
            continue
        if installed not in known:
            print(f"{name}: {installed}, pinned: {', '.join(known)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
