"""The command ``gapscope blind``: cases whose effect is withheld, verdicts on them, the labels opened and scored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Optional

import typer

from gapscope.terminal import console, log

blind = typer.Typer(
    help="The sealed check of the diagnosis.",
    no_args_is_help=True,
    add_completion=False,
)

Cases = Annotated[Path, typer.Argument(help="folder of the cases", metavar="DIR")]
Count = Annotated[Optional[int], typer.Option(min=0, help="number of such cases")]  # noqa: UP045


def _say(message: str) -> None:
    log.print(message, highlight=False, markup=False)


@blind.command()
def make(
    out: Annotated[Path, typer.Option(help="folder for the cases", metavar="DIR")],
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="draw the same again; default: a secret one"),
    ] = None,
    labels: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="folder for labels and held-out recordings, outside DIR; default: DIR-labels",
            metavar="DIR",
        ),
    ] = None,
    plan: Annotated[
        Path | None, typer.Option(help="what to make; the options below overrule it")
    ] = None,
    singles: Count = None,
    pairs: Count = None,
    triples: Count = None,
    outside: Count = None,
    healthy: Count = None,
    ladder: Count = None,
    effects: Annotated[
        str, typer.Option(help="only these effects, with commas between")
    ] = "",
    robots: Annotated[
        str, typer.Option(help="only these arms, with commas between")
    ] = "",
    jobs: Annotated[int, typer.Option(min=1, help="cases at a time")] = 1,
    show: Annotated[
        bool, typer.Option("--show", help="print the truth: for work on the generator")
    ] = False,
) -> None:
    """Make cases whose effect is withheld, and publish the hash of their labels."""
    from gapscope.blind_check.make import make as make_cases
    from gapscope.blind_check.plan import COUNTS, BlindPlan, read_plan
    from gapscope.reports.blind_check.truth import truth_lines

    given = dict(
        zip(COUNTS, (singles, pairs, triples, outside, healthy, ladder), strict=True)
    )
    changes: dict[str, object] = {
        key: value for key, value in given.items() if value is not None
    }
    changes |= {
        key: tuple(name.strip() for name in text.split(","))
        for key, text in (("effects", effects), ("robots", robots))
        if text
    }
    chosen = replace(read_plan(plan) if plan else BlindPlan(), **changes)  # type: ignore[arg-type]
    commitment, truth = make_cases(
        out, chosen, seed=seed, labels=labels, jobs=jobs, progress=_say
    )
    if show:
        for line in truth_lines(truth):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(f"wrote {commitment}\nwrote {truth}", highlight=False, soft_wrap=True)


@blind.command()
def run(
    cases: Cases,
    out: Annotated[Path, typer.Option(help="folder for the results", metavar="DIR")],
    labels: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="where the labels lie, to make sure that they cannot be read",
            metavar="FILE",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="cases at a time")] = 1,
) -> None:
    """Diagnose every case with what is frozen now; refuses to start where the labels can be read."""
    from gapscope.blind_check.run import FROZEN
    from gapscope.blind_check.run import run as run_cases

    failed = run_cases(cases, out, labels=labels, jobs=jobs, progress=_say)
    console.print(f"wrote {out / FROZEN}", highlight=False, soft_wrap=True)
    if failed:
        _say(
            f"{failed} of the cases failed; run the command again to try these once more"
        )
        raise typer.Exit(1)


@blind.command()
def score(
    cases: Cases,
    results: Annotated[Path, typer.Option(help="folder of the results", metavar="DIR")],
    labels: Annotated[
        Path, typer.Option(help="the labels, or their folder", metavar="FILE")
    ],
    out: Annotated[Path, typer.Option(help="folder for the score", metavar="DIR")],
    baselines: Annotated[
        bool, typer.Option(help="run the plain methods as well")
    ] = True,
    train: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help="other cases, their labels in DIR-labels, to train a classifier on",
            metavar="DIR",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="cases at a time")] = 1,
) -> None:
    """Open the labels, compare them with their published hash, and score the verdicts."""
    from gapscope.blind_check.score import score as score_cases
    from gapscope.blind_check.seal import labels_folder
    from gapscope.reports.blind_check.tables import BRIEFLY, tables
    from gapscope.reports.blind_check.write import write_score

    training = (train, labels_folder(train)) if train else None
    scored = score_cases(
        cases,
        results,
        labels,
        baselines=baselines,
        training=training,
        jobs=jobs,
        progress=_say,
    )
    for table in tables(scored.figures):
        if table.title in BRIEFLY:
            console.print(table.rich())
    for path in write_score(scored, out):
        console.print(f"wrote {path}", highlight=False, soft_wrap=True)
