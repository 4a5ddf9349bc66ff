"""The command ``gapscope blind``: cases whose effect is withheld, verdicts on them, the labels opened and scored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from gapscope.commands.options import split_names, with_own_effects
from gapscope.terminal import console, note, say, wrote

if TYPE_CHECKING:
    from gapscope.blind_check.check import BlindPlan

blind = typer.Typer(
    help="The sealed check of the diagnosis.",
    no_args_is_help=True,
    add_completion=False,
)

Cases = Annotated[Path, Argument(help="folder of the cases", metavar="DIR")]
Count = Annotated[int | None, Option(min=0, help="number of such cases")]
Jobs = Annotated[int, Option(min=1, help="cases at a time")]


@blind.command()
@with_own_effects
def make(
    out: Annotated[Path, Option(help="folder for the cases", metavar="DIR")],
    seed: Annotated[
        int | None, Option(min=0, help="draw the same again; default: a secret one")
    ] = None,
    labels: Annotated[
        Path | None,
        Option(
            help="folder for labels and held-out recordings, outside DIR; default: DIR-labels",
            metavar="DIR",
        ),
    ] = None,
    plan: Annotated[
        Path | None, Option(help="what to make; the options below overrule it")
    ] = None,
    singles: Count = None,
    pairs: Count = None,
    triples: Count = None,
    outside: Count = None,
    healthy: Count = None,
    ladder: Count = None,
    effects: Annotated[
        str, Option(help="only these effects, with commas between")
    ] = "",
    robots: Annotated[str, Option(help="only these arms, with commas between")] = "",
    jobs: Jobs = 1,
    show: Annotated[
        bool, Option("--show", help="print the truth: for work on the generator")
    ] = False,
) -> None:
    """Make cases whose effect is withheld, and publish the hash of their labels."""
    from gapscope.arm.io.locked_section import locked
    from gapscope.blind_check.check import COUNTS
    from gapscope.blind_check.check import make as make_cases
    from gapscope.reports.blind_check import truth_lines

    counts = (singles, pairs, triples, outside, healthy, ladder)
    changes: dict[str, Any] = dict(zip(COUNTS, counts, strict=True))
    changes["effects"] = split_names(effects) or None
    changes["robots"] = split_names(robots) or None
    with locked(out):
        commitment, truth = make_cases(
            out,
            _changed_plan(plan, changes),
            seed=seed,
            labels=labels,
            jobs=jobs,
            progress=note,
        )
    if show:
        say(*truth_lines(truth))
    wrote(commitment, truth)


def _changed_plan(path: Path | None, changes: dict[str, Any]) -> BlindPlan:
    """The plan of a file, or the default one, with the options that were given."""
    from gapscope.blind_check.check import BlindPlan, read_plan

    plan = read_plan(path) if path else BlindPlan()
    given = {name: value for name, value in changes.items() if value is not None}
    return replace(plan, **given)


@blind.command()
@with_own_effects
def run(
    cases: Cases,
    out: Annotated[Path, Option(help="folder for the results", metavar="DIR")],
    labels: Annotated[
        Path | None,
        Option(
            help="file with the labels, to make sure that it cannot be read",
            metavar="FILE",
        ),
    ] = None,
    jobs: Jobs = 1,
) -> None:
    """Diagnose every case with what is frozen now; refuses to start if the labels can be read."""
    from gapscope.arm.io.locked_section import locked
    from gapscope.blind_check.check import FROZEN
    from gapscope.blind_check.check import run as run_cases

    with locked(out):
        failed = run_cases(cases, out, labels=labels, jobs=jobs, progress=note)
    wrote(out / FROZEN)
    if failed:
        note(f"{failed} of the cases failed; run the command again to retry them")
        raise typer.Exit(1)


@blind.command()
@with_own_effects
def score(
    cases: Cases,
    results: Annotated[Path, Option(help="folder of the results", metavar="DIR")],
    labels: Annotated[Path, Option(help="the labels, or their folder", metavar="FILE")],
    out: Annotated[Path, Option(help="folder for the score", metavar="DIR")],
    baselines: Annotated[bool, Option(help="run the plain methods as well")] = True,
    train: Annotated[
        Path | None,
        Option(
            help="other cases, their labels in DIR-labels, to train a classifier on",
            metavar="DIR",
        ),
    ] = None,
    jobs: Jobs = 1,
) -> None:
    """Open the labels, compare them with their published hash, and score the verdicts."""
    from gapscope.arm.io.locked_section import locked
    from gapscope.blind_check.check import labels_folder
    from gapscope.blind_check.scoring import score as score_cases
    from gapscope.reports.blind_check import brief_tables, write_score

    training = (train, labels_folder(train)) if train else None
    scored = score_cases(
        cases,
        results,
        labels,
        baselines=baselines,
        training=training,
        jobs=jobs,
        progress=note,
    )
    for table in brief_tables(scored.figures):
        console.print(table.on_terminal())
    with locked(out):
        paths = write_score(scored, out)
    wrote(*paths)
