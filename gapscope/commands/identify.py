"""The command ``gapscope identify``: base parameters, bodies and friction of an arm."""

from __future__ import annotations

from typing import Annotated

import typer

from gapscope.commands.options import CasePath, Results, split_names
from gapscope.terminal import Progress, show

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
        help="consistent, wls, ols, irls, ridge, l_curve, truncated_svd, total_least_squares, maximum_likelihood, "
        "kalman, partial_update, log_cholesky, sdp_euclidean or sdp_entropic; or, by simulation of the closed loop, "
        "instrumental_variables, didim or output_error"
    ),
]
Filter = Annotated[
    str,
    typer.Option(
        "--filter",
        help="recursive, over base parameters; or unscented: states and friction together as well, from encoders and "
        "torque without differentiating (about a second for each second of the first recording)",
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
    typer.Option(
        "--any-torque",
        help="go on if the torque shows that the case reads its log wrongly, or says another gravity",
    ),
]

RidgeStrength = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        help="strength of the pull to the nominal arm, with columns of unit norm; default: by held-out motions",
    ),
]
SingularValues = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="directions that truncated_svd keeps; default: by held-out motions",
    ),
]
Keep = Annotated[
    str,
    typer.Option(
        help="parameters that stay at the nominal arm's, with commas: m5, I3, or link5 for all of a link",
        metavar="NAMES",
    ),
]


def identify(
    case: CasePath,
    out: Results,
    cutoff: Cutoff = None,
    estimator: Estimator = "consistent",
    judge: HeldOut = None,
    any_torque: AnyTorque = False,
    filter_: Filter = "recursive",
    ridge: RidgeStrength = None,
    singular_values: SingularValues = None,
    keep: Keep = "",
) -> None:
    """Identify base and physical parameters and friction."""
    from gapscope.arm.io.atomic_write import begin_results
    from gapscope.arm.io.locked_section import locked
    from gapscope.ident.identification import IdentificationSettings
    from gapscope.interface.identify import identify as identify_case
    from gapscope.reports.identification import DOCUMENT

    if estimator == "consistent" and ridge is not None:
        estimator = "ridge"
    if estimator == "consistent" and singular_values is not None:
        estimator = "truncated_svd"
    settings = IdentificationSettings(
        cutoff,
        estimator,
        tuple(judge or ()),
        any_torque,
        filter=filter_,
        ridge=ridge,
        singular_values=singular_values,
        keep=split_names(keep) if keep else (),
    )
    with Progress(case.name or str(case)) as progress, locked(out):
        begin_results(out, DOCUMENT)
        result = identify_case(case, settings, progress=progress)
        progress("writes the report")
        paths = result.save(out)
    show(result, *paths)
