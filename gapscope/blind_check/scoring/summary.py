"""The figures of a blind check, from its cases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gapscope.blind_check.scoring.compare import LEVEL, Compared
from gapscope.blind_check.scoring.statistics import brier, ece, proportion, reliability


def summary(cases: Sequence[Compared]) -> dict[str, Any]:
    """All figures, as JSON knows them."""
    kinds = {
        kind: [c for c in cases if c.kind == kind]
        for kind in dict.fromkeys(c.kind for c in cases)
    }
    inside = [c for c in cases if c.truth and c.kind != "ladder"]
    return {
        "cases": len(cases),
        "failed": [c.name for c in cases if c.verdict == "failed"],
        "by_kind": {kind: scores(chosen) for kind, chosen in kinds.items()},
        "by_severity": _split(
            [c for c in cases if c.kind in ("single", "ladder")], lambda c: c.severity
        ),
        "by_robot": _split(inside, lambda c: c.robot),
        "by_rate": _split(inside, lambda c: f"{c.conditions['rate']} Hz"),
        "by_controller": _split(
            inside, lambda c: "unknown" if c.conditions["bare"] else "known"
        ),
        "by_inertials": _split(
            inside, lambda c: "off" if c.conditions["inertials_off"] else "true"
        ),
        "by_effect": _split(
            [c for c in cases if c.kind == "single"], lambda c: c.truth[0].effect
        ),
        "healthy": healthy(kinds.get("healthy", [])),
        "unknown": unknown(cases),
        "calibration": calibration([c for c in cases if c.kind != "ladder"]),
        "confusion": confusion(
            [c for c in cases if c.kind in ("single", "outside", "healthy")]
        ),
        "seconds": _quantiles([c.seconds for c in cases if c.seconds is not None]),
    }


def scores(cases: Sequence[Compared]) -> dict[str, Any]:
    """Names, joints, parameters and gap closed of some cases."""
    errors = [e for c in cases for e in c.errors]
    closed = [c.closure for c in cases if c.closure is not None]
    return {
        "count": len(cases),
        "top": proportion([c.top for c in cases]).plain(),
        "exact": proportion([c.exact for c in cases]).plain(),
        "exact_strict": proportion([c.exact_strict for c in cases]).plain(),
        "jaccard": float(np.mean([c.jaccard for c in cases])) if cases else None,
        "joints": proportion([right for c in cases for right in c.joints]).plain(),
        "called_unexplained": proportion(
            [c.verdict == "unexplained" for c in cases]
        ).plain(),
        "called_no_gap": proportion([c.verdict == "no_gap" for c in cases]).plain(),
        "parameter_error": _quantiles(errors),
        "gap_closed": _quantiles([x["mean"] for x in closed]),
        "gap_closed_worst_joint": _quantiles([x["worst"] for x in closed]),
    }


def healthy(cases: Sequence[Compared]) -> dict[str, Any]:
    """False alarms: a healthy arm that is said to have an effect, or a gap that nothing explains."""
    return {
        "count": len(cases),
        "false_alarms": proportion(
            [c.verdict not in ("no_gap", "failed") for c in cases]
        ).plain(),
        "effects_named": proportion([bool(c.found) for c in cases]).plain(),
    }


def unknown(cases: Sequence[Compared]) -> dict[str, Any]:
    """How often ``unexplained`` is said where it is right, and where it is wrong."""
    outside = [c for c in cases if c.unknown]
    inside = [c for c in cases if c.truth and c.kind in ("single", "pair", "triple")]
    return {
        "recall": proportion([c.verdict == "unexplained" for c in outside]).plain(),
        "false_unknown": proportion(
            [c.verdict == "unexplained" for c in inside]
        ).plain(),
    }


def calibration(cases: Sequence[Compared]) -> dict[str, Any]:
    """Brier score, ECE and reliability of the probabilities; coverage and size of the sets at ``LEVEL``."""
    findings = [finding for c in cases for finding in c.findings]
    p, right = (
        np.array([f.probability for f in findings]),
        np.array([f.right for f in findings], dtype=float),
    )
    return {
        "findings": len(findings),
        "brier": brier(p, right),
        "ece": ece(p, right),
        "reliability": reliability(p, right),
        "sets": {
            "level": LEVEL,
            "coverage": proportion([f.covered for f in findings]).plain(),
            "mean_size": float(np.mean([f.size for f in findings]))
            if findings
            else None,
        },
    }


def confusion(cases: Sequence[Compared]) -> dict[str, dict[str, int]]:
    """Truth to answer to number of cases; the answer is the first effect named, or the verdict where none is."""
    table: dict[str, Counter[str]] = {}
    for case in cases:
        truth = (
            "unknown"
            if case.unknown
            else case.truth[0].effect
            if case.truth
            else "healthy"
        )
        answer = (
            case.found[0].effect
            if case.found and case.verdict != "unexplained"
            else case.verdict
        )
        table.setdefault(truth, Counter())[answer] += 1
    return {
        truth: dict(answers.most_common()) for truth, answers in sorted(table.items())
    }


def _split(cases: Sequence[Compared], key: Callable[[Compared], str]) -> dict[str, Any]:
    return {
        name: scores([c for c in cases if key(c) == name])
        for name in sorted({key(c) for c in cases}, key=_order)
    }


def _order(name: str) -> tuple[float, str]:
    head = name.replace(" Hz", "").split("-")[0]
    return (float(head), name) if head.replace(".", "").isdigit() else (1e9, name)


def _quantiles(values: Sequence[float]) -> dict[str, float] | None:
    """How many, median and quartiles; ``None`` without values."""
    if not values:
        return None
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return {
        "count": len(values),
        "median": float(middle),
        "lower": float(low),
        "upper": float(high),
    }
