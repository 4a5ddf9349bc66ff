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


def run_point(
    options: argparse.Namespace, path: Path, part: str, point: Point, failed: list[str]
) -> list[Row]:
    """Rows of a point: those stored, or measured now if it is wanted."""
    found = stored(path)
    if options.list:
        print(f"{part}: {point.name}{'' if found is None else ' (stored)'}")
    named = any(text in point.name for text in options.only or [""])
    new = found is None or options.again
    if options.list or options.tables or not (named and new):
        return found or []
    print(f"{part}: measures {point.name}", file=sys.stderr, flush=True)
    try:
        return measured(path, part, point)
    except Exception:  # reported at the end; the other points count as well
        traceback.print_exc()
        failed.append(f"{part}: {point.name}")
        return []


def main(words: Sequence[str] | None = None) -> int:
    """Measure, write, print; returns 1 if a point failed."""
    options = arguments(words)
    # what is stored of one kind of run must not stand for another
    kinds = ("quick",) * options.quick + ("against",) * bool(options.against)
    out = options.out.joinpath(*kinds).resolve()
    against = options.against.resolve() if options.against else None
    written, failed = {}, list[str]()
    for part in options.parts or PARTS:
        # cases and foreign tools are the same for all kinds of runs
        settings = Settings(
            options.out.resolve() / part,
            options.rounds,
            options.quick,
            against,
            tuple(options.case),
        )
        rows = []
        for point in import_module(f"experiments.benchmarks.{part}").points(settings):
            path = point_file(out, part, point.name)
            rows += run_point(options, path, part, point, failed)
        if options.list or not rows:
            continue
        written[part] = [asdict(row) for row in rows]
        text = table(rows)
        print(f"\n## {PARTS[part]}\n\n{text}", flush=True)
        if options.into:
            put_into(options.into, part, PARTS[part], text)
    if written:
        content = {"machine": machine(), "parts": written}
        write_json(content, out / "benchmarks.json")
    for name in failed:
        print(f"failed: {name}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
