"""The command ``gapscope blind``: cases whose effect is withheld, verdicts on them, the labels opened and scored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from gapscope.commands.options import File, Folder, NotNegative, as_command, split_names
from gapscope.terminal import console, note, say, wrote

blind = typer.Typer(
    help="The sealed check of the diagnosis.",
    no_args_is_help=True,
    add_completion=False,
)


Count = Annotated[int | None, Option(min=0, help="number of such cases")]
Jobs = Annotated[int, Option(min=1, help="cases at a time")]
CasesFolder = Annotated[Path, Argument(help="folder of the cases", metavar="DIR")]


def make(
    *,
    out: Folder,
    seed: NotNegative | None = None,
    labels: Folder | None = None,
    plan: Path | None = None,
    singles: Count = None,
    pairs: Count = None,
    triples: Count = None,
    outside: Count = None,
    healthy: Count = None,
    ladder: Count = None,
    effects: str = "",
    robots: str = "",
    jobs: Jobs = 1,
    show: bool = False,
) -> None:
    """Make cases whose effect is withheld, and publish the hash of their labels.

    Args:
        out: folder for the cases
        seed: draw the same again; default: a secret one
        labels: folder for labels and held-out recordings, outside DIR; default: DIR-labels
        plan: what to make; the options below overrule it
        effects: only these effects, with commas between
        robots: only these arms, with commas between
        show: print the truth: for work on the generator
    """
    from gapscope.arm.io.locked_section import locked
    from gapscope.blind_check.check import COUNTS, BlindPlan, read_plan
    from gapscope.blind_check.check import make as make_cases
    from gapscope.reports.blind_check import truth_lines

    counts = (singles, pairs, triples, outside, healthy, ladder)
    changes: dict[str, Any] = dict(zip(COUNTS, counts, strict=True))
    # nothing named: the plan's, or those of the package
    changes["effects"] = split_names(effects) or None
    changes["robots"] = split_names(robots) or None
    # an option that was not given leaves the plan as it is
    given = {name: value for name, value in changes.items() if value is not None}
    with locked(out):
        commitment, truth = make_cases(
            out,
            replace(read_plan(plan) if plan else BlindPlan(), **given),
            seed=seed,
            labels=labels,
            jobs=jobs,
            progress=note,
        )
    if show:
        say(*truth_lines(truth))
    wrote(commitment, truth)


def run(
    cases: CasesFolder,
    *,
    out: Folder,
    labels: File | None = None,
    jobs: Jobs = 1,
) -> None:
    """Diagnose every case with what is frozen now; refuses to start if the labels can be read.

    Args:
        out: folder for the results
        labels: file with the labels, to make sure that it cannot be read
    """
    from gapscope.arm.io.locked_section import locked
    from gapscope.blind_check.check import FROZEN
    from gapscope.blind_check.check import run as run_cases

    with locked(out):
        failed = run_cases(cases, out, labels=labels, jobs=jobs, progress=note)
    wrote(out / FROZEN)
    if failed:
        note(f"{failed} of the cases failed; run the command again to retry them")
        raise typer.Exit(1)


def score(
    cases: CasesFolder,
    *,
    results: Folder,
    labels: File,
    out: Folder,
    baselines: bool = True,
    train: Folder | None = None,
    jobs: Jobs = 1,
) -> None:
    """Open the labels, compare them with their published hash, and score the verdicts.

    Args:
        results: folder of the results
        labels: the labels, or their folder
        out: folder for the score
        baselines: run the plain methods as well
        train: other cases, their labels in DIR-labels, to train a classifier on
    """
    from gapscope.arm.io.locked_section import locked
    from gapscope.blind_check.check import labels_folder
    from gapscope.blind_check.scoring import score as score_cases
    from gapscope.reports.blind_check import brief_tables, write_score

    training = (train, labels_folder(train)) if train else None
    figures, verdicts = score_cases(
        cases,
        results,
        labels,
        baselines=baselines,
        training=training,
        jobs=jobs,
        progress=note,
    )
    for table in brief_tables(figures):
        console.print(table.on_terminal())
    with locked(out):
        paths = write_score(figures, verdicts, out)
    wrote(*paths)


for command in (make, run, score):
    blind.command()(as_command(command, own_effects=True))
