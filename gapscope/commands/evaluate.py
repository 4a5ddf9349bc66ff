"""Models evaluated by tracking: files in, files out."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gapscope.agents.evaluation import (
    Evaluation,
    EvaluationPlan,
    TrackingBench,
    evaluate,
)
from gapscope.agents.model_files import read_models
from gapscope.agents.summary import SummaryLine, relation, summarise
from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import write_json
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.commands.diagnose import make_folder
from gapscope.commands.evaluation_cells import Cells
from gapscope.effects.corrected_file import error_context, read_corrected
from gapscope.envs.arguments import described
from gapscope.reports.evaluation.page import write_page

DOCUMENT, PAGE, TABLE = "evaluation.json", "evaluation.html", "evaluation.csv"


def evaluate_files(
    models: list[str],
    robot: str | NominalArm,
    effects: Path | None,
    plan: EvaluationPlan,
    out: Path,
    progress: Callable[[str], None] = lambda message: None,
    *,
    again: bool = False,
) -> tuple[dict[str, Any], list[SummaryLine], list[Path]]:
    """Evaluate models and write the page, the episodes as CSV and, as the last, ``evaluation.json``.

    What is finished is kept in a folder in ``out`` until then, so that the same call goes on after an interruption.

    Args:
        models: see ``gapscope.agents.model_files.read_models``.
        robot: a nominal arm; a name or URDF; or a case, whose nominal arm is taken.
        effects: file of the form of ``corrected.yaml`` with what the arm that is tracked has beyond the nominal one.
        plan: how to evaluate.
        out: folder for the results.
        progress: called with a few words at each step.
        again: do not go on from what an earlier call has kept.

    Returns:
        The document, its lines, and the files.

    Raises:
        InputError: an argument or a file is at fault.
        GapscopeError: a file cannot be written.
    """
    arm = robot if isinstance(robot, NominalArm) else chosen_arm(robot)
    hidden = () if effects is None else read_corrected(effects)
    tried = read_models(models, arm)
    with error_context(effects, hidden):
        bench = TrackingBench(arm, hidden, plan)
    make_folder(out)
    try:
        (out / DOCUMENT).unlink(missing_ok=True)
    except OSError as error:
        raise GapscopeError(
            f"{out / DOCUMENT}: cannot be replaced ({error.strerror})", "remove it"
        ) from None
    with error_context(effects, hidden):
        cells = Cells(out, bench, again)
        evaluation = evaluate(tried, bench, progress, cells)
    if cells.reused:
        progress(f"{cells.reused} parts were taken from a run that was interrupted")
    lines = summarise(evaluation)
    content = document(bench, evaluation, lines)
    progress("writes the page")
    write_page(content, lines, out / PAGE)
    rows = [episode.row() for episode in evaluation.episodes]
    with (
        atomic_write(out / TABLE) as aside,
        aside.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    write_json(content, out / DOCUMENT)
    cells.clear()
    return content, lines, [out / name for name in (PAGE, DOCUMENT, TABLE)]


def document(
    bench: TrackingBench, evaluation: Evaluation, lines: list[SummaryLine]
) -> dict[str, Any]:
    """An evaluation as plain data; numbers that are not finite are ``None``."""
    plan = bench.plan
    return {
        "schema": 1,
        "arm": {"robot": bench.arm.name, "joints": list(bench.arm.joints)},
        "effects": [described(applied) for applied in bench.effects],
        "plan": {
            "motions": list(plan.motions),
            "disturbances": list(plan.disturbances),
            "seeds": list(plan.seeds),
            "engines": list(plan.engines),
            "duration": plan.duration,
            "law": plan.law,
            "bandwidth": plan.tuning.bandwidth,
            "damping": plan.tuning.damping,
        },
        "models": [line.plain() for line in lines],
        "rank_correlation_of_torque_and_joint_error": relation(lines),
        "episodes": [episode.row() for episode in evaluation.episodes],
    }


def chosen_arm(robot: str) -> NominalArm:
    """The nominal arm of a name, a URDF, or a case."""
    path = Path(robot)
    if path.suffix in (".yaml", ".yml") or path.is_dir():
        return load_case(path, read_recordings=False).arm
    return load_nominal_arm(robot)
