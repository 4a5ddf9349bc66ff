"""The command ``gapscope identify``: base parameters, bodies and friction of an arm."""

from __future__ import annotations

from typing import Annotated

from typer import Option

from gapscope.commands.options import CasePath, NotNegative, Results, split_names
from gapscope.terminal import Progress, show


def identify(
    case: CasePath,
    *,
    out: Results,
    cutoff: Annotated[float | None, Option(min=0.1)] = None,
    estimator: str = "consistent",
    judge: Annotated[list[str] | None, Option(metavar="NAME")] = None,
    any_torque: bool = False,
    filter_: str = "recursive",
    ridge: Annotated[float | None, Option(min=0.0)] = None,
    singular_values: NotNegative | None = None,
    keep: Annotated[str, Option(metavar="NAMES")] = "",
) -> None:
    """Identify base and physical parameters and friction.

    Args:
        cutoff: cut-off of both sides [Hz]; default: from the spectra of the positions
        estimator: consistent, wls, ols, irls, ridge, l_curve, truncated_svd, total_least_squares, maximum_likelihood,
            kalman, partial_update, log_cholesky, sdp_euclidean or sdp_entropic; or, by simulation of the closed loop,
            instrumental_variables, didim or output_error
        judge: name of a recording to hold out for validation; default: the case's, or the last
        any_torque: go on if the torque shows that the case reads its log wrongly, or says another gravity
        filter_: recursive, over base parameters; or unscented: states and friction together as well, from encoders and
            torque without differentiating (about a second for each second of the first recording)
        ridge: strength of the pull to the nominal arm, with columns of unit norm; default: by held-out motions
        singular_values: directions that truncated_svd keeps; default: by held-out motions
        keep: parameters that stay at the nominal arm's, with commas: m5, I3, or link5 for all of a link
    """
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
