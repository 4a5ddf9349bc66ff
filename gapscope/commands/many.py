"""The commands for many diagnoses: ``fleet`` and ``serve``."""

from __future__ import annotations

import time
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from gapscope.commands.options import Folder, Positive, Results
from gapscope.terminal import Progress, say, show, wrote

PACE = 1.0
"""Least time between two lines of progress [s]."""
GIGABYTE = 1e9


def fleet(
    cases: Annotated[list[str], Argument(metavar="CASES...")],
    *,
    out: Results,
    jobs: Positive | None = None,
    backend: str = "local",
    again: bool = False,
    keep: str = "json",
    units_by: str = "case",
    largest: Annotated[float, Option(metavar="GB", min=0.0)] = 2.0,
    scratch: Folder | None = None,
    tries: Positive = 3,
) -> None:
    """Diagnose many cases, compare their units, and find what changed.

    Args:
        cases: folders or archives of cases, lists of them (.txt, .csv), or URLs: s3://..., gs://..., zip://...
        jobs: cases at a time; default: 1, on a cluster all its cores
        backend: local, or ray (needs ray installed)
        again: diagnose also what is done
        keep: files kept of each diagnosis: nothing, json or report
        units_by: what names the unit of a case: case or folder
        largest: size that a case may have [GB]
        scratch: folder for cases while they are diagnosed
        tries: times that a case is begun if its workers die
    """
    from gapscope.many.fleet import DOCUMENT, PAGE, fleet

    with Progress("fleet") as progress:
        overview = fleet(
            cases,
            out,
            progress=_paced(progress),
            jobs=jobs,
            backend=backend,
            again=again,
            keep=keep,
            units_by=units_by,
            largest=int(largest * GIGABYTE),
            scratch=scratch,
            tries=tries,
        )
    say(str(overview.counts))
    show(overview)
    wrote(out / PAGE, out / DOCUMENT)
    raise typer.Exit(1 if overview.counts.failed else 0)


def _paced(progress: Progress) -> Callable[[str], None]:
    """Passes a message on unless one was passed on just now: there may be thousands a minute."""
    last = -PACE

    def show(message: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PACE:
            last = now
            progress(message)

    return show


def serve(
    folder: Annotated[Path, Argument(metavar="DIR")],
    *,
    port: Annotated[int, Option(min=0, max=65535)] = 0,
    units_by: str = "case",
    open_: bool = False,
) -> None:
    """Show many diagnoses as a table, and the effects of each unit over time; read-only, on this machine alone.

    Args:
        folder: folder with diagnoses, at any depth
        port: on 127.0.0.1; 0: any that is free
        units_by: what names a unit, without dates: case, or the folder above a diagnosis
        open_: open the browser
    """
    from gapscope.many.archive import Archive, ArchiveServer

    archive = Archive(folder, units_by)
    with ArchiveServer(archive, port) as server:
        with Progress(str(folder)) as progress:
            count = len(archive.rows(progress))
        noun = "diagnosis" if count == 1 else "diagnoses"
        say(f"{count} {noun} at {server.address} (Ctrl-C ends)")
        if open_:
            webbrowser.open(server.address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            say("stopped")
