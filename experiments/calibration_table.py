"""How well probabilities of findings hold, as a table; see ``51_interval_coverage.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gapscope.blind_check.scoring.classes import named, same
from gapscope.blind_check.scoring.statistics import brier, ece, wilson
from gapscope.reports.blind_check.tables import Table

LIKELY = 0.8
"""Findings at least as probable as this are counted apart [1]."""


class Stated(NamedTuple):
    """A finding: what it is of, its probability, and whether it is in the label."""

    group: str
    probability: float
    right: bool


def stated(group: str, truth: dict[str, Any], document: dict[str, Any]) -> list[Stated]:
    """All findings of a diagnosis, named or possible, beside the label."""
    true = [named(entry) for entry in truth["effects"]]
    motions = truth.get("motions", [])[:-1]
    entries = [*document.get("effects", []), *document.get("possible", [])]
    return [
        Stated(
            group,
            float(entry["probability"] or 0.0),
            any(same(one, named(entry), len(truth["gap"]), motions) for one in true),
        )
        for entry in entries
    ]


def calibration_table(title: str, found: Sequence[Stated]) -> Table:
    """A row for each group, and one for all."""
    groups = sorted({one.group for one in found})
    rows = [_row(name, [one for one in found if one.group == name]) for name in groups]
    head = (
        "",
        "findings",
        "stated",
        "right",
        "Brier",
        "calibration error",
        f"{LIKELY:.1f} and more: findings, stated, right",
    )
    return Table(title, head, (*rows, _row("all", found)))


def _row(name: str, found: Sequence[Stated]) -> tuple[str, ...]:
    p = np.array([one.probability for one in found])
    right = np.array([one.right for one in found], dtype=float)
    likely = p >= LIKELY
    score, error = brier(p, right), ece(p, right)
    assert score is not None and error is not None
    figures = "–"
    if likely.any():
        hits, count = int(right[likely].sum()), int(likely.sum())
        low, high = wilson(hits, count)
        share = f"{hits / count:.2f} ({low:.2f} to {high:.2f})"
        figures = f"{count}, {p[likely].mean():.2f}, {share}"
    return (
        name,
        str(len(found)),
        f"{p.mean():.2f}",
        f"{right.mean():.2f}",
        f"{score:.2f}",
        f"{error:.2f}",
        figures,
    )
