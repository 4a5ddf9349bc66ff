"""An evaluation as files: page, episodes as CSV, and ``evaluation.json``."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gapscope.agents.evaluation import Evaluation, TrackingBench
from gapscope.agents.summary import SummaryLine, relation
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import write_json
from gapscope.envs.divergence import described
from gapscope.reports.evaluation.page import write_page

DOCUMENT, PAGE, TABLE = "evaluation.json", "evaluation.html", "evaluation.csv"


def write_evaluation(
    content: Mapping[str, Any], lines: Sequence[SummaryLine], folder: Path
) -> list[Path]:
    """Write the page, the episodes as CSV and, as the last, ``evaluation.json``.

    Args:
        content: what ``evaluation_document`` made.
        lines: the summary, a line per disturbance, engine and model.
        folder: of the results.

    Raises:
        GapscopeError: a file cannot be written.
    """
    write_page(content, lines, folder / PAGE)
    _write_table(content["episodes"], folder / TABLE)
    write_json(content, folder / DOCUMENT)
    return [folder / name for name in (PAGE, DOCUMENT, TABLE)]


def _write_table(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    with (
        atomic_write(path) as aside,
        aside.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def evaluation_document(
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
