"""Compare two folders of diagnoses, say of the sample cases before and after a change that should not change any.

    git worktree add out/before REVISION        # and diagnose the cases there, with its own environment
    gapscope diagnose CASE... --out out/after
    .venv/bin/python experiments/23_same_diagnoses.py out/before/results out/after

Prints for each case the largest relative difference of any number in ``diagnosis.json``, ``made_from`` aside, and the
fields whose text or shape differs. Exits with 1 if a number differs by more than
``TOLERANCE``, anything else at all, or a case is missing.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

TOLERANCE = 1e-6
"""Relative difference of two numbers that rounding explains."""
SMALLEST = 1e-12
"""Numbers that differ by less than this are equal."""
IGNORED = "made_from"
"""Key that names the program's version."""


def differences(
    before: Any, after: Any, field: str = ""
) -> Iterator[tuple[str, float]]:
    """Fields that differ, each with the relative difference, infinite for anything but numbers."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in (before.keys() | after.keys()) - {IGNORED}:
            yield from differences(before.get(key), after.get(key), f"{field}.{key}")
    elif (
        isinstance(before, list)
        and isinstance(after, list)
        and len(before) == len(after)
    ):
        for k, (one, other) in enumerate(zip(before, after, strict=True)):
            yield from differences(one, other, f"{field}[{k}]")
    elif {type(before), type(after)} <= {int, float}:
        if abs(before - after) > SMALLEST:
            yield field, abs(before - after) / max(abs(before), abs(after))
    elif before != after:
        yield field, float("inf")


def main(before: Path, after: Path) -> None:
    """Print a line for each case; exit with 1 if one differs."""
    worst = 0.0
    files = sorted(before.glob("*/diagnosis.json"))
    for file in files:
        other = after / file.relative_to(before)
        if not other.is_file():
            print(f"{file.parent.name}: {other} is missing")
            worst = float("inf")
            continue
        one, two = (json.loads(f.read_text("utf-8")) for f in (file, other))
        found = dict(differences(one, two))
        largest = max(found.values(), default=0.0)
        worst = max(worst, largest)
        fields = [field for field, size in found.items() if size > TOLERANCE]
        print(f"{file.parent.name}: largest relative difference {largest:.1e}", *fields)
    print(f"{len(files)} cases, largest relative difference {worst:.1e}")
    sys.exit(not files or worst > TOLERANCE)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    main(**vars(parser.parse_args()))
