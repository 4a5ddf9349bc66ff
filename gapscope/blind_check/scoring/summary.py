"""The figures of a blind check, from its cases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gapscope.blind_check.scoring.compare import LEVEL, Compared
from gapscope.blind_check.scoring.statistics import brier, ece, proportion, reliability


def summary(cases: Sequence[Compared]) -> dict[str, Any]:
    """All figures, as JSON data."""
    kinds: dict[str, list[Compared]] = {}
    for case in cases:
        kinds.setdefault(case.kind, []).append(case)

    def of(*names: str) -> list[Compared]:
        return [case for case in cases if case.kind in names]

    # a recovery check is no accuracy: it has a row of its own, and no part in the other figures
    counted = [case for case in cases if case.kind not in ("ladder", "recovery")]
    inside = [case for case in counted if case.truth]
    seconds = [case.seconds for case in cases if case.seconds is not None]
    return {
        "cases": len(cases),
        "failed": [case.name for case in cases if case.verdict == "failed"],
        "by_kind": {kind: scores(chosen) for kind, chosen in kinds.items()},
        "by_severity": _split(of("single", "ladder"), lambda c: c.severity),
        "by_robot": _split(inside, lambda c: c.robot),
        "by_rate": _split(inside, lambda c: f"{c.conditions['rate']} Hz"),
        "by_controller": _split(inside, _controller),
        "by_inertials": _split(inside, _inertials),
        "by_effect": _split(of("single"), lambda c: c.truth[0].effect),
        "healthy": healthy(of("healthy")),
        "unknown": unknown(cases),
        "calibration": calibration(counted),
        "confusion": confusion(of("single", "outside", "healthy")),
        "seconds": _quantiles(seconds),
    }


def _controller(case: Compared) -> str:
    return "unknown" if case.conditions["bare"] else "known"


def _inertials(case: Compared) -> str:
    return "off" if case.conditions["inertials_off"] else "true"


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
    """False alarms: a healthy arm with the verdict of an effect or of an unexplained gap."""
    return {
        "count": len(cases),
        "false_alarms": proportion(
            [c.verdict not in ("no_gap", "failed") for c in cases]
        ).plain(),
        "effects_named": proportion([bool(c.found) for c in cases]).plain(),
    }


def unknown(cases: Sequence[Compared]) -> dict[str, Any]:
    """How often the verdict is ``unexplained``, rightly and wrongly."""
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
    p = np.array([f.probability for f in findings])
    right = np.array([f.right for f in findings], dtype=float)
    mean_size = float(np.mean([f.size for f in findings])) if findings else None
    return {
        "findings": len(findings),
        "brier": brier(p, right),
        "ece": ece(p, right),
        "reliability": reliability(p, right),
        "sets": {
            "level": LEVEL,
            "coverage": proportion([f.covered for f in findings]).plain(),
            "mean_size": mean_size,
        },
    }


def confusion(cases: Sequence[Compared]) -> dict[str, dict[str, int]]:
    """Truth to answer to number of cases; the answer is the first effect named, or the verdict if none is."""
    table: dict[str, Counter[str]] = {}
    for case in cases:
        table.setdefault(_truth(case), Counter())[_answer(case)] += 1
    return {
        truth: dict(answers.most_common()) for truth, answers in sorted(table.items())
    }


def _truth(case: Compared) -> str:
    """Row of a case in the table of confusions."""
    if case.unknown:
        return "unknown"
    return case.truth[0].effect if case.truth else "healthy"


def _answer(case: Compared) -> str:
    """Column of a case in it."""
    if case.found and case.verdict != "unexplained":
        return case.found[0].effect
    return case.verdict


def _split(cases: Sequence[Compared], key: Callable[[Compared], str]) -> dict[str, Any]:
    """Scores of the cases with each value of a key."""
    groups: dict[str, list[Compared]] = {}
    for case in cases:
        groups.setdefault(key(case), []).append(case)
    return {name: scores(groups[name]) for name in sorted(groups, key=_order)}


def _order(name: str) -> tuple[float, str]:
    """Numbers by size, then names."""
    head = name.replace(" Hz", "").split("-")[0]
    is_number = head.replace(".", "").isdigit()
    return (float(head), name) if is_number else (1e9, name)


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
