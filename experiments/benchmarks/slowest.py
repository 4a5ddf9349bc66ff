"""The slowest functions or stages of a diagnosis, by name of a point of the diagnosis part, or of any case.

    python -m experiments.benchmarks.slowest CASE... [--reference CASE] [--against CHECKOUT] [--top 12] [--stages]

CASE is a folder or case file, or a part of the name of a point: ``real ur10 against``, ``60 s at 500 Hz, 2``. Prints a
Markdown table per case and checkout: time of the function's own, and with what it calls [s of the processor], under the
profiler; or the time of each stage without it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from experiments.benchmarks.child import ROOT, run_child
from experiments.benchmarks.diagnosis import named_cases, sizes
from experiments.benchmarks.measured_cases import Measured

HEAD = "| function | calls | own [s] | with what it calls [s] |\n|---|---|---|---|"


def cases(
    words: Sequence[str], reference: Path | None, out: Path
) -> Iterator[Measured]:
    """The cases that words name.

    Raises:
        SystemExit: a word names no point, or several; lists them.
    """
    planned = [*named_cases(), *sizes()]
    for word in words:
        if Path(word).exists():
            yield Measured(Path(word).name, Path(word), reference)
            continue
        found = [each for each in planned if word == each.name]
        found = found or [each for each in planned if word in each.name]
        if len(found) != 1:
            names = "\n  ".join(each.name for each in found or planned)
            raise SystemExit(f"{word!r} names {len(found)} points\n  {names}")
        yield found[0].place(out / "cases")


def functions(found: dict[str, Any]) -> str:
    """A profile as a table."""
    lines = [
        f"| `{row['function']}` | {row['calls']} | {row['own']:.2f} | {row['with_called']:.2f} |"
        for row in found["slowest"]
    ]
    return "\n".join([HEAD, *lines])


def stages(found: dict[str, Any]) -> str:
    """The stages as a table."""
    lines = [f"| {name} | {spent:.2f} |" for name, spent in found["stages"].items()]
    return "\n".join(["| stage | processor [s] |\n|---|---|", *lines])


def main() -> None:
    """Profile and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("cases", nargs="+", metavar="CASE")
    parser.add_argument("--reference", type=Path, help="of a case given as a path")
    parser.add_argument("--against", type=Path, help="another checkout, profiled first")
    parser.add_argument("--top", type=int, default=12, help="functions in a table")
    parser.add_argument("--stages", action="store_true", help="no profile, but stages")
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/diagnosis"))
    options = parser.parse_args()
    checkouts = {"before": options.against.resolve()} if options.against else {}
    checkouts["now"] = ROOT
    for case in cases(options.cases, options.reference, options.out):
        reference = ["--reference", case.reference] if case.reference else []
        words = [case.case, *reference]
        if not options.stages:
            words += ["--slowest", options.top]
        for when, checkout in checkouts.items():
            found = run_child("diagnose_case.py", *words, checkout=checkout)
            text = stages(found) if options.stages else functions(found)
            print(
                f"\n### {case.name}, {when}: {found['cpu']:.1f} s\n\n{text}", flush=True
            )


if __name__ == "__main__":
    main()
