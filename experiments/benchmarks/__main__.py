"""Measure the parts of the benchmarks and write them as JSON and as a Markdown table.

    python -m experiments.benchmarks [PART...] [--quick] [--only TEXT] [--against CHECKOUT] [--into PAGE]

Each point is stored as soon as it is measured, and not measured again unless ``--again`` says so: a run that was
stopped goes on where it was. Ratios are between loops that took turns in one run. Times are of the processor unless a
row says otherwise. A point that fails is reported at the end, and the others are measured.

A part is a module of this folder with ``points(settings)``: what it measures, each a ``Point``.
"""

from __future__ import annotations

import argparse
import sys
import traceback
from collections.abc import Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from types import ModuleType

from gapscope.arm.io.json_file import write_json

from .cases import Measured
from .measure import (
    Point,
    Row,
    Settings,
    machine,
    measured,
    point_file,
    put_into,
    stored,
    table,
)

PARTS = {
    "startup": "Start-up",
    "regressor": "Regressor and base parameters",
    "joint": "Friction and inertia of one joint",
    "diagnosis": "Diagnosis",
    "watch": "Watching a recording that grows",
    "environment": "Environment and agents",
}
"""Title of each part in the table; its module has the part's name."""


def _module(part: str) -> ModuleType:
    return import_module(f"experiments.benchmarks.{part}")


def points_of(part: str, settings: Settings) -> list[Point]:
    """What a part measures; its module is imported for it."""
    return list(_module(part).points(settings))


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.benchmarks", description=__doc__.split("\n")[0]
    )
    add = parser.add_argument
    add("parts", nargs="*", choices=[*PARTS, []], metavar="PART", help=", ".join(PARTS))
    add("--out", type=Path, default=Path("out/benchmarks"), help="folder for all files")
    add("--rounds", type=int, default=5, help="turns of loops that are compared")
    add("--quick", action="store_true", help="small sizes, to see that all works")
    add(
        "--only",
        action="append",
        metavar="TEXT",
        help="points whose names contain it; repeatable",
    )
    add("--again", action="store_true", help="measure also what is stored")
    add(
        "--tables", action="store_true", help="measure nothing, tabulate what is stored"
    )
    add("--list", action="store_true", help="print the points and end")
    add("--against", type=Path, help="another checkout, measured in turns with this")
    add(
        "--case",
        action="append",
        default=[],
        type=_case,
        metavar="CASE[,REFERENCE]",
        help="a case of your own that is diagnosed as well; repeatable",
    )
    add("--into", type=Path, help="page whose tables are replaced, docs/benchmarks.md")
    return parser.parse_args(words)


def _case(text: str) -> Measured:
    """A case, and a reference after a comma."""
    case, _, reference = text.partition(",")
    path = Path(case).resolve()
    name = path.parent.name if path.suffix else path.name
    return Measured(name, path, Path(reference).resolve() if reference else None)


class Run:
    """Measures what the command line asks for, and remembers which points failed."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        # what is stored of one kind of run must not stand for another
        kinds = ("quick",) * options.quick + ("against",) * bool(options.against)
        self.out = options.out.joinpath(*kinds).resolve()
        self.failed: list[str] = []

    def part(self, part: str) -> list[Row]:
        """Rows of a part."""
        options = self.options
        against = options.against.resolve() if options.against else None
        # cases and foreign tools are the same for all kinds of runs
        settings = Settings(
            options.out.resolve() / part,
            options.rounds,
            options.quick,
            against,
            tuple(options.case),
        )
        points = points_of(part, settings)
        return [row for point in points for row in self.point(part, point)]

    def point(self, part: str, point: Point) -> list[Row]:
        """Rows of a point: those stored, or measured now if it is wanted."""
        path = point_file(self.out, part, point.name)
        found = stored(path)
        if self.options.list:
            print(f"{part}: {point.name}{'' if found is None else ' (stored)'}")
        if not self._wanted(point, found) or self.options.list:
            return found or []
        print(f"{part}: measures {point.name}", file=sys.stderr, flush=True)
        try:
            return measured(path, part, point)
        except Exception:  # reported at the end; the other points count as well
            traceback.print_exc()
            self.failed.append(f"{part}: {point.name}")
            return []

    def _wanted(self, point: Point, found: list[Row] | None) -> bool:
        named = any(text in point.name for text in self.options.only or [""])
        new = found is None or self.options.again
        return named and new and not self.options.tables


def main(words: Sequence[str] | None = None) -> int:
    """Measure, write, print; returns 1 if a point failed."""
    options = arguments(words)
    run = Run(options)
    written = {}
    for part in options.parts or PARTS:
        rows = run.part(part)
        if options.list or not rows:
            continue
        written[part] = [asdict(row) for row in rows]
        text = table(rows)
        print(f"\n## {PARTS[part]}\n\n{text}", flush=True)
        if options.into:
            put_into(options.into, part, PARTS[part], text)
    if written:
        content = {"machine": machine(), "parts": written}
        write_json(content, run.out / "benchmarks.json")
    for name in run.failed:
        print(f"failed: {name}", file=sys.stderr)
    return 1 if run.failed else 0


if __name__ == "__main__":
    sys.exit(main())
