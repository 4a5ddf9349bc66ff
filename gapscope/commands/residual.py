"""The command ``gapscope residual``: a network for what the effects leave, judged on recordings set aside."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated

import typer

from gapscope.commands.options import CasePath, Model, Results
from gapscope.terminal import Progress, console, say, wrote

Form = Annotated[
    str,
    typer.Option(
        help="best (chosen per joint on held-out recordings), additive, mlp or tcn"
    ),
]
Apart = Annotated[
    str,
    typer.Option(
        help="what the network must not explain: effects; all (inertial parameters, friction, rotors, offsets too); or "
        "best (effects alone if that closes more of held-out recordings)"
    ),
]
HeldOut = Annotated[
    list[str] | None,
    typer.Option(
        "--judge",
        help="name of a recording to set aside; default: the case's, or the last",
        metavar="NAME",
    ),
]
Onnx = Annotated[bool, typer.Option("--onnx", help="write residual.onnx as well")]
Seed = Annotated[int, typer.Option(min=0, help="of weights and batches")]


def residual(
    case: CasePath,
    out: Results,
    model: Model = None,
    form: Form = "best",
    apart: Apart = "best",
    judge: HeldOut = None,
    onnx: Onnx = False,
    seed: Seed = 0,
) -> None:
    """Train a network on what the effects leave, and judge it on recordings set aside (extra: learn)."""
    from gapscope.arm.case import load_case
    from gapscope.arm.errors import GapscopeError
    from gapscope.arm.io.atomic_write import begin_results
    from gapscope.arm.io.locked_section import locked
    from gapscope.ident.residual.fit import ResidualSettings, learn_residual
    from gapscope.interface.models import corrected_arm
    from gapscope.reports.residual import (
        DOCUMENT,
        facts,
        joint_table,
        physics_sentence,
        write_learnt,
    )

    needed = ("torch", "sklearn", *(("onnx",) if onnx else ()))
    if missing := [name for name in needed if find_spec(name) is None]:
        raise GapscopeError(
            f"training a residual network needs {', '.join(missing)}",
            "pip install 'gapscope[learn]'",
        )
    settings = ResidualSettings(form=form, apart=apart, seed=seed)
    with Progress(case.name or str(case)) as progress, locked(out):
        begin_results(out, DOCUMENT)
        progress("reads")
        loaded = load_case(case)
        corrected = corrected_arm(loaded.arm, model)
        found = learn_residual(loaded, corrected, settings, judge or (), progress)
        content, paths = write_learnt(found, out, onnx=onnx, progress=progress)
    say(facts(content))
    console.print(joint_table(content))
    say(physics_sentence(content))
    wrote(*paths)
