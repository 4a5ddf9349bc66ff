"""A benchmark of the diagnosis on real arms with known truth: make, diagnose, score; prints the tables as Markdown.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/26_real_benchmark.py --out out/real [--jobs 2] [--full]

Recordings of seven real arms are carriers (``real_carriers.py``): the unchanged recording is a healthy case, and
effects of known size are put into it by laws that are not the catalogue's (``real_injections.py``); see
``docs/real_arms.md``.

Resumable: run it again for the rest; each case has a result file that is written whole. ``--step check`` shows that the
injected truth closes the gap. ``--results NAME`` keeps the results of several versions of the diagnosis side by side;
``--sketch PROGRAM`` lets an outside program answer (``common.py``).
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from functools import partial
from pathlib import Path

from common import diagnose_to_file, run_tasks, write_no_result
from real_carriers import ARMS, prepare_arm, prepare_cut
from real_check import check_table
from real_plan import (
    MODES,
    SIZES,
    Planned,
    counts,
    make_case,
    planned,
    read_truth,
    reference_of,
)
from real_scoring import Scored, score_tables, scored
from threadpoolctl import threadpool_limits

from gapscope.arm.errors import ModelWarning
from gapscope.arm.io.json_file import read_json

MAKE_LIMIT = 900.0
"""Longest time to prepare a carrier or to make a case [s]."""


class Progress:
    """Counts tasks as they end."""

    def __init__(self, what: str, total: int) -> None:
        self.what, self.total, self.done = what, total, 0
        self.started = time.monotonic()

    def __call__(self, name: str, text: str) -> None:
        """Print that a task ended."""
        self.done += 1
        passed = (time.monotonic() - self.started) / 60
        count = f"{self.done}/{self.total}"
        print(f"{self.what} {count} {passed:5.1f} min  {name}  {text}", flush=True)


def make(cases: list[Planned], seed: int, out: Path, jobs: int) -> None:
    """Prepare carriers and cuts, then make the cases."""
    arms = sorted({c.arm for c in cases})
    cuts = sorted({(c.arm, c.cut) for c in cases})
    run = partial(run_tasks, jobs=jobs, limit=MAKE_LIMIT)
    progress = Progress("identify", len(arms) + len(cuts))
    run(
        lambda arm: prepare_arm(arm, out),
        arms,
        ended=lambda arm, how, s: progress(arm, f"{how} {s:.0f} s"),
    )
    run(
        lambda c: prepare_cut(*c, seed, out),
        cuts,
        ended=lambda c, how, s: progress(f"{c[0]} cut {c[1]}", f"{how} {s:.0f} s"),
    )
    made = Progress("make", len(cases))
    run(
        lambda plan: make_case(plan, seed, out),
        cases,
        ended=lambda plan, how, s: made(plan.name, f"{how} {s:.0f} s"),
    )


def result_file(plan: Planned, results: Path) -> Path:
    """Where the result of a case is."""
    return results / f"{plan.name}.json"


def run(
    cases: list[Planned],
    out: Path,
    results: Path,
    jobs: int,
    limit: float,
    sketch: Path | None,
) -> None:
    """Diagnose all cases that have no result yet, with Gapscope or by a sketch."""
    left = [
        c
        for c in cases
        if not result_file(c, results).is_file()
        and (out / "truth" / f"{c.name}.json").is_file()
    ]
    progress = Progress("diagnose", len(left))

    def ended(plan: Planned, how: str, seconds: float) -> None:
        file = result_file(plan, results)
        if how != "ended" or not file.is_file():
            write_no_result(plan.name, how, seconds, limit, file)
        result = read_json(file, "")
        document = result.get("document") or {}
        found = [effect["effect"] for effect in document.get("effects", [])]
        verdict = document.get("verdict", result.get("error", ""))
        text = f"{seconds:.0f} s  {verdict}  {', '.join(found)}"
        progress(f"{plan.name} ({plan.kind})", text)

    def diagnosed(plan: Planned) -> None:
        reference = reference_of(plan, out) if plan.mode == "against" else None
        case, file = out / "cases" / plan.name, result_file(plan, results)
        diagnose_to_file(case, reference, file, sketch)

    run_tasks(diagnosed, left, jobs, limit, ended)


def score(cases: list[Planned], out: Path, results: Path) -> None:
    """Print the tables of all cases that have a result, and write them beside the results."""
    rows: list[Scored] = []
    for plan in cases:
        file = result_file(plan, results)
        if file.is_file():
            rows.append(scored(plan, read_truth(plan, out), read_json(file, "")))
    if not rows:
        print("no results yet: --step run")
        return
    text = "\n".join(table.markdown() for table in score_tables(rows))
    missing = len(cases) - len(rows)
    text += f"\n{missing} of {len(cases)} planned cases have no result.\n" * bool(
        missing
    )
    print(text)
    file = results.with_suffix(".md")
    file.write_text(text, encoding="utf-8")
    print(file)


def parsed() -> argparse.Namespace:
    """The arguments."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/real_benchmark"))
    parser.add_argument("--arms", default=",".join(ARMS), help="default: %(default)s")
    parser.add_argument("--modes", default=",".join(MODES), help="default: %(default)s")
    parser.add_argument("--sizes", default=",".join(f"{s:g}" for s in SIZES))
    parser.add_argument("--per-arm", type=int, help="cases per arm and mode")
    parser.add_argument("--full", action="store_true", help="36 per arm and mode")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--limit", type=float, default=600.0, help="processor time per case [s]"
    )
    parser.add_argument("--results", default="results", help="folder in OUT")
    parser.add_argument(
        "--sketch", type=Path, help="an outside program in place of Gapscope"
    )
    steps = ("make", "check", "run", "score", "all")
    parser.add_argument("--step", choices=steps, default="all")
    return parser.parse_args()


def main() -> None:
    """Do what the arguments say."""
    arguments = parsed()
    warnings.simplefilter("ignore", ModelWarning)
    arms, modes = arguments.arms.split(","), arguments.modes.split(",")
    unknown = {*arms, *modes} - {*ARMS, *MODES}
    if unknown:
        sys.exit(f"unknown: {', '.join(sorted(unknown))}")
    sizes = [float(size) for size in arguments.sizes.split(",")]
    number = counts(arguments.per_arm, arguments.full)
    cases = planned(arms, modes, sizes, number)
    out, results = arguments.out, arguments.out / arguments.results
    # a process for each task, each with one thread
    threadpool_limits(1)
    if arguments.step in ("make", "all"):
        make(cases, arguments.seed, out, arguments.jobs)
    if arguments.step == "check":
        print(check_table(cases, out, arguments.jobs).markdown())
    if arguments.step in ("run", "all"):
        limit, sketch = arguments.limit, arguments.sketch
        run(cases, out, results, arguments.jobs, limit, sketch)
    if arguments.step in ("score", "all"):
        score(cases, out, results)


if __name__ == "__main__":
    main()
