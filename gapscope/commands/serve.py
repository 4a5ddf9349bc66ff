"""The command ``gapscope serve``: many diagnoses in a browser on this machine."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from gapscope.terminal import Progress, say


def serve(
    folder: Annotated[
        Path,
        Argument(help="folder with diagnoses, at any depth", metavar="DIR"),
    ],
    port: Annotated[
        int, Option(min=0, max=65535, help="on 127.0.0.1; 0: any that is free")
    ] = 0,
    units_by: Annotated[
        str,
        Option(
            help="what names a unit, without dates: case, or the folder above a diagnosis"
        ),
    ] = "case",
    show: Annotated[bool, Option("--open", help="open the browser")] = False,
) -> None:
    """Show many diagnoses as a table, and the effects of each unit over time; read-only, on this machine alone."""
    from gapscope.archive import Archive
    from gapscope.serving import ArchiveServer

    archive = Archive(folder, units_by)
    with ArchiveServer(archive, port) as server:
        with Progress(str(folder)) as progress:
            count = len(archive.entries(progress))
        noun = "diagnosis" if count == 1 else "diagnoses"
        say(f"{count} {noun} at {server.address} (Ctrl-C ends)")
        if show:
            webbrowser.open(server.address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            say("stopped")
