"""The command ``gapscope identify``: base parameters, bodies and friction of an arm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gapscope.arm.errors import InputError
from gapscope.commands.options import CasePath, Results
from gapscope.terminal import Progress, console, wrote

if TYPE_CHECKING:
    from gapscope.ident.identification import IdentificationSettings
    from gapscope.outputs.identification import WrittenIdentification

RECORDINGS = (".csv", ".parquet", ".npz", ".mcap", ".db3")
"""Endings of files that hold a recording and no case."""

Cutoff = Annotated[
    float | None,
    typer.Option(
        min=0.1,
        help="cut-off of both sides [Hz]; default: from the spectra of the positions",
    ),
]
Estimator = Annotated[
    str,
    typer.Option(
        help="consistent, wls, ols, irls, ridge, truncated_svd, total_least_squares, maximum_likelihood, "
        "partial_update, log_cholesky, sdp_euclidean or sdp_entropic"
    ),
]
HeldOut = Annotated[
    list[str] | None,
    typer.Option(
        "--judge",
        help="name of a recording to hold out for validation; default: the case's, or the last",
        metavar="NAME",
    ),
]
AnyTorque = Annotated[
    bool,
    typer.Option("--any-torque", help="go on if the torque seems not to be in N m"),
]


def identify(
    case: CasePath,
    out: Results,
    cutoff: Cutoff = None,
    estimator: Estimator = "consistent",
    judge: HeldOut = None,
    any_torque: AnyTorque = False,
) -> None:
    """Identify base and physical parameters and friction."""
    from gapscope.ident.identification import IdentificationSettings
    from gapscope.reports.identification.terminal_summary import summary

    settings = IdentificationSettings(cutoff, estimator, tuple(judge or ()), any_torque)
    with Progress(case.name or str(case)) as progress:
        written = identify_path(case, out, settings, progress)
    console.print(summary(written.result))
    wrote(*written.paths)


def identify_path(
    path: Path,
    out: Path,
    settings: IdentificationSettings,
    progress: Callable[[str], None] = lambda message: None,
) -> WrittenIdentification:
    """Identify the case at a path and write the results; see ``gapscope.outputs.identification``.

    Raises:
        InputError: ``path`` is a recording, or the case cannot be identified from.
        GapscopeError: no physically consistent parameters were found, or a file cannot be written.
    """
    from gapscope.arm.case import load_case
    from gapscope.commands.inputs import case_file
    from gapscope.ident.identification import identify as identify_case
    from gapscope.outputs.folder import begin_results
    from gapscope.outputs.identification import DOCUMENT, write_identification

    if path.suffix.lower() in RECORDINGS:
        raise InputError(
            "is a recording, not a case",
            "give the case.yaml that lists it, or its folder",
            file=path,
        )
    begin_results(out, DOCUMENT)
    progress("reads the case")
    result = identify_case(load_case(path), settings, progress)
    return write_identification(result, case_file(path), out, progress)
