"""One verdict beside its truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gapscope.blind_check.scoring.classes import Named, matched, named, same, strict
from gapscope.blind_check.scoring.statistics import smallest_set

LEVEL = 0.9
"""Probability that a conformal set is to cover."""
VECTORS = {
    "base_tilt": ("roll", "pitch"),
    "external_force": ("force",),
    "link_inertia": ("mass",),
    "payload": ("mass",),
}
"""Parameters by whose common length an effect on the arm is judged; joint effects by their first parameter."""


@dataclass(frozen=True)
class ScoredFinding:
    """One effect that a diagnosis named: its probability, whether it is right, and its set of rivals.

    ``covered`` and ``size`` describe the smallest set of names that reaches ``LEVEL``.
    """

    probability: float
    right: bool
    covered: bool
    size: int


@dataclass(frozen=True)
class Compared:
    """One case: what is true, what was said.

    Attributes:
        name, kind: the case.
        severity: its severity class as text, ``fault`` or ``healthy``.
        truth, found: what is at work and what was named, largest share first.
        unknown: whether the cause is outside the catalogue.
        verdict: of the diagnosis; ``failed`` where there is none.
        top, exact, exact_strict: first name right; the set right, modulo classes and strictly.
        jaccard: of the two sets, modulo classes.
        joints: per effect named rightly whether all of its joints are right.
        errors: per such effect on the right joints, the relative error of its first parameter.
        findings: probabilities.
        closure: share of the gap closed, or ``None``.
        seconds: duration of the diagnosis [s].
    """

    name: str
    kind: str
    severity: str
    truth: tuple[Named, ...]
    found: tuple[Named, ...]
    unknown: bool
    verdict: str
    top: bool
    exact: bool
    exact_strict: bool
    jaccard: float
    joints: tuple[bool, ...] = ()
    errors: tuple[float, ...] = ()
    findings: tuple[ScoredFinding, ...] = ()
    closure: dict[str, Any] | None = None
    seconds: float | None = None
    robot: str = ""
    conditions: dict[str, Any] = field(default_factory=dict)


def compare(
    name: str,
    label: dict[str, Any],
    document: dict[str, Any] | None,
    seconds: float | None = None,
    closed: dict[str, Any] | None = None,
) -> Compared:
    """Set a diagnosis beside its label; ``None`` stands for a diagnosis that failed."""
    n, motions = len(label["gap"]), label["motions"][:-1]
    unknown = any(entry["effect"] == "unknown" for entry in label["effects"])
    entries = [entry for entry in label["effects"] if entry["effect"] != "unknown"]
    said = document["effects"] if document else []
    truth, found = tuple(map(named, entries)), tuple(map(named, said))
    pairs = matched(truth, found, n, motions)
    verdict = document["verdict"] if document else "failed"
    all_found = len(pairs) == len(truth) == len(found)
    right_verdict = verdict == (
        "unexplained" if unknown else "effects_found" if truth else "no_gap"
    )
    return Compared(
        name=name,
        kind=label["kind"],
        severity=_severity(label),
        truth=truth,
        found=found,
        unknown=unknown,
        verdict=verdict,
        top=bool(found) and any(same(t, found[0], n, motions) for t in truth),
        exact=all_found and bool(truth),
        exact_strict=bool(truth) and strict(truth, found),
        jaccard=len(pairs) / max(len(truth) + len(found) - len(pairs), 1)
        if truth or found
        else float(right_verdict),
        joints=tuple(
            set(truth[i].joints) == set(found[j].joints)
            for i, j in pairs
            if truth[i].joints and truth[i].effect == found[j].effect
        ),
        errors=tuple(
            e
            for i, j in pairs
            for e in [first_parameter_error(entries[i], said[j])]
            if e is not None
        ),
        findings=tuple(_finding(entry, truth, n, motions) for entry in said),
        closure=closed,
        seconds=seconds,
        robot=label["conditions"]["robot"],
        conditions=label["conditions"],
    )


def _severity(label: dict[str, Any]) -> str:
    if label["severity"] is None:
        return "healthy"
    if label["measure"] == "none":
        return "fault"
    low, high = label["severity"]
    return f"{low:g}-{high:g}"


def first_parameter_error(truth: dict[str, Any], found: dict[str, Any]) -> float | None:
    """|found - true| / |true| of the first parameter, median over joints; ``None`` where it cannot be compared."""
    if truth["effect"] != found["effect"] or set(truth["joints"]) != set(
        found["joints"]
    ):
        return None
    names = VECTORS.get(truth["effect"], tuple(truth["parameters"])[:1])
    if not names or any(
        name not in found["parameters"] or truth["parameters"][name].get("unit") == ""
        for name in names
    ):
        return None
    true, given = (
        np.hstack([np.ravel(e["parameters"][name]["value"]) for name in names])
        for e in (truth, found)
    )
    if truth["effect"] in VECTORS:
        return float(np.linalg.norm(given - true) / np.linalg.norm(true))
    order = [found["joints"].index(joint) for joint in truth["joints"]]
    return float(
        np.median(np.abs(given[order] - true) / np.maximum(np.abs(true), 1e-12))
    )


def _finding(
    entry: dict[str, Any], truth: Sequence[Named], n: int, motions: Sequence[str]
) -> ScoredFinding:
    candidates = [
        (entry, entry["probability"]),
        *((rival, rival["probability"]) for rival in entry["alternatives"]),
    ]
    names = {e["effect"]: named(e) for e, _ in candidates}
    chosen = smallest_set([(e["effect"], p) for e, p in candidates], LEVEL)
    right = [any(same(t, names[name], n, motions) for t in truth) for name in chosen]
    return ScoredFinding(
        probability=float(entry["probability"]),
        right=any(same(t, names[entry["effect"]], n, motions) for t in truth),
        covered=any(right),
        size=len(chosen),
    )
