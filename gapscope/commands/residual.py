"""The command ``gapscope residual``: a network for what the effects leave, judged on recordings set aside."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated

from typer import Option

from gapscope.commands.options import CasePath, Model, NotNegative, Results
from gapscope.terminal import Progress, console, say, wrote


def residual(
    case: CasePath,
    *,
    out: Results,
    model: Model = None,
    form: str = "best",
    apart: str = "best",
    judge: Annotated[list[str] | None, Option(metavar="NAME")] = None,
    onnx: bool = False,
    seed: NotNegative = 0,
) -> None:
    """Train a network on what the effects leave, and judge it on recordings set aside (extra: learn).

    Args:
        form: best (chosen per joint on held-out recordings), additive, mlp or tcn
        apart: what the network must not explain: effects; all (inertial parameters, friction, rotors, offsets too); or
            best (effects alone if that closes more of held-out recordings)
        judge: name of a recording to set aside; default: the case's, or the last
        onnx: write residual.onnx as well
        seed: of weights and batches
    """
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
