"""How often the 95 % intervals and the probabilities in ``diagnosis.json`` hold; prints the tables as Markdown.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/51_interval_coverage.py --out out/coverage [--jobs 2]

Simulated cases are made by the blind check's generator, whose laws are not the catalogue's, with nominal inertials up
to 3, 6 and 10 % off (``coverage_simulated.py``); real ones carry effects of known size on recordings of six arms, with
nominal inertials as far off (``coverage_carriers.py``); the sample cases come from a third simulator. Intervals are
counted of effects that were named rightly, on joints that have them; probabilities of all findings.

Resumable: each case has a result file that is written whole. ``--results NAME`` keeps the results of several versions
of the diagnosis side by side. Needs the extra ``blind``.
"""

from __future__ import annotations

import argparse
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import coverage_carriers
import coverage_samples
import coverage_simulated
from calibration_table import Stated, calibration_table, stated
from common import run_tasks
from coverage_carriers import Carried
from coverage_samples import Sample
from coverage_simulated import Simulated
from coverage_table import Value, coverage_table, values
from threadpoolctl import threadpool_limits

import gapscope
from gapscope.arm.case import load_case
from gapscope.arm.errors import ModelWarning
from gapscope.arm.io.json_file import plain, read_json, write_json
from gapscope.reports.blind_check.tables import Table

LIMIT = 600.0
"""Longest processor time to make or to diagnose a case [s]."""
Plan = Simulated | Carried | Sample
KINDS = {"Simulated": Simulated, "Real": Carried, "Sample cases": Sample}
GROUPS = {"Simulated": "nominal errors", "Real": "arm", "Sample cases": "arm"}


def make(plan: Plan, seed: int, out: Path) -> None:
    """Write one case and its truth."""
    if isinstance(plan, Simulated):
        coverage_simulated.make(plan, seed, out)
    elif isinstance(plan, Carried):
        coverage_carriers.make(plan, seed, out)


def diagnose(plan: Plan, out: Path, results: Path) -> None:
    """Diagnose one case; of its document only the effects are kept."""
    folder = plan.folder if isinstance(plan, Sample) else out / "cases" / plan.name
    case = load_case(folder, any_unit=True)
    document: Any = gapscope.diagnose(case).document
    kept = {key: document[key] for key in ("verdict", "effects", "possible")}
    content = plain(kept, null_if_not_finite=True)
    write_json(content, results / f"{plan.name}.json")


def ended(what: str, plan: Plan, how: str, seconds: float) -> None:
    """Print that a task ended."""
    print(f"{what} {plan.name} {how} {seconds:.0f} s", flush=True)


def truth_of(plan: Plan, out: Path) -> dict[str, Any]:
    """The label of a case."""
    if isinstance(plan, Sample):
        return plan.truth
    return dict(read_json(out / "truth" / f"{plan.name}.json", "--step make"))


def group_of(plan: Plan) -> str:
    """What a case is counted with: its nominal errors if it is simulated, its arm otherwise."""
    if isinstance(plan, Simulated):
        # a figure space, so that rows are in order
        return f"{100 * plan.width:.0f} %".rjust(4, "\u2007")
    return plan.arm if isinstance(plan, Carried) else plan.robot


def tables(name: str, plans: list[Plan], out: Path, results: Path) -> list[Table]:
    """The tables of the cases of one kind that have a result."""
    found: list[Value] = []
    said: list[Stated] = []
    for plan in plans:
        file = results / f"{plan.name}.json"
        if file.is_file():
            document, truth = read_json(file, "--step run"), truth_of(plan, out)
            found += values(plan.name, group_of(plan), truth, document)
            said += stated(group_of(plan), truth, document)
    if not found:
        return []
    by_group = f"{name}, by {GROUPS[name]}"
    return [
        coverage_table(f"{name}, by parameter", found, lambda v: v.parameter),
        coverage_table(by_group, found, lambda v: v.group),
        calibration_table(f"{name}, probabilities", said),
    ]


def report(plans: list[Plan], out: Path, results: Path) -> None:
    """Print the tables, and write them beside the results."""
    shown = []
    for name, kind in KINDS.items():
        chosen = [plan for plan in plans if isinstance(plan, kind)]
        shown += tables(name, chosen, out, results)
    text = "\n".join(table.markdown() for table in shown)
    print(text)
    results.with_suffix(".md").write_text(text, encoding="utf-8")


def parsed() -> argparse.Namespace:
    """The arguments."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/coverage"))
    parser.add_argument("--rounds", type=int, default=1, help="of simulated cases")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", default="results", help="folder in OUT")
    parser.add_argument(
        "--step", choices=("make", "run", "score", "all"), default="all"
    )
    return parser.parse_args()


def main() -> None:
    """Make, diagnose, score."""
    arguments = parsed()
    warnings.simplefilter("ignore", ModelWarning)
    out, seed, jobs = arguments.out, arguments.seed, arguments.jobs
    results = out / arguments.results
    results.mkdir(parents=True, exist_ok=True)
    simulated = coverage_simulated.planned(arguments.rounds)
    samples = coverage_samples.planned()
    plans: list[Plan] = [*simulated, *coverage_carriers.planned(), *samples]
    with threadpool_limits(1):
        if arguments.step in ("make", "all"):
            making = partial(make, seed=seed, out=out)
            # one after the other: the cases of a carrier share its identification
            run_tasks(making, plans, 1, LIMIT, partial(ended, "make"))
        if arguments.step in ("run", "all"):
            left = [p for p in plans if not (results / f"{p.name}.json").is_file()]
            diagnosing = partial(diagnose, out=out, results=results)
            run_tasks(diagnosing, left, jobs, LIMIT, partial(ended, "diagnose"))
    if arguments.step in ("score", "all"):
        report(plans, out, results)


if __name__ == "__main__":
    main()
