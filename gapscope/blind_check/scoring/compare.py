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
"""Parameters whose common length is compared for an effect on the arm; of a joint effect it is the first parameter."""


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
    """One case: what is true, what was reported.

    Attributes:
        name, kind: the case.
        severity: its severity class as text, ``fault`` or ``healthy``.
        truth, found: what is at work and what was named, largest share first.
        unknown: whether the cause is outside the catalogue.
        verdict: of the diagnosis; ``failed`` if there is none.
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
    """Set a diagnosis beside its label; ``None`` means a diagnosis that failed."""
    n, motions = len(label["gap"]), label["motions"][:-1]
    unknown = any(entry["effect"] == "unknown" for entry in label["effects"])
    entries = [entry for entry in label["effects"] if entry["effect"] != "unknown"]
    reported = document["effects"] if document else []
    verdict = document["verdict"] if document else "failed"
    truth, found = tuple(map(named, entries)), tuple(map(named, reported))
    pairs = matched(truth, found, n, motions)
    all_found = len(pairs) == len(truth) == len(found)
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
        jaccard=_jaccard(truth, found, len(pairs), verdict, unknown),
        joints=_joints_right(truth, found, pairs),
        errors=_parameter_errors(entries, reported, pairs),
        findings=tuple(_finding(entry, truth, n, motions) for entry in reported),
        closure=closed,
        seconds=seconds,
        robot=label["conditions"]["robot"],
        conditions=label["conditions"],
    )


def _jaccard(
    truth: Sequence[Named],
    found: Sequence[Named],
    common: int,
    verdict: str,
    unknown: bool,
) -> float:
    """Common names over all names; of two empty sets 1 if the verdict is right, 0 otherwise."""
    if truth or found:
        return common / max(len(truth) + len(found) - common, 1)
    return float(verdict == ("unexplained" if unknown else "no_gap"))


def _joints_right(
    truth: Sequence[Named], found: Sequence[Named], pairs: Sequence[tuple[int, int]]
) -> tuple[bool, ...]:
    """Per joint effect that is named rightly whether all of its joints are right."""
    right = []
    for i, j in pairs:
        if truth[i].joints and truth[i].effect == found[j].effect:
            right.append(set(truth[i].joints) == set(found[j].joints))
    return tuple(right)


def _parameter_errors(
    entries: Sequence[dict[str, Any]],
    reported: Sequence[dict[str, Any]],
    pairs: Sequence[tuple[int, int]],
) -> tuple[float, ...]:
    """Relative errors of the first parameter of effects named rightly, if they can be compared."""
    errors = [first_parameter_error(entries[i], reported[j]) for i, j in pairs]
    return tuple(error for error in errors if error is not None)


def _severity(label: dict[str, Any]) -> str:
    if label["severity"] is None:
        return "healthy"
    if label["measure"] == "none":
        return "fault"
    low, high = label["severity"]
    return f"{low:g}-{high:g}"


def first_parameter_error(truth: dict[str, Any], found: dict[str, Any]) -> float | None:
    """|found - true| / |true| of the first parameter, median over joints; ``None`` if it cannot be compared."""
    same_joints = set(truth["joints"]) == set(found["joints"])
    if truth["effect"] != found["effect"] or not same_joints:
        return None
    names = VECTORS.get(truth["effect"], tuple(truth["parameters"])[:1])
    comparable = all(
        name in found["parameters"] and truth["parameters"][name].get("unit") != ""
        for name in names
    )
    if not names or not comparable:
        return None
    true, given = _values(truth, names), _values(found, names)
    if truth["effect"] in VECTORS:
        return float(np.linalg.norm(given - true) / np.linalg.norm(true))
    order = [found["joints"].index(joint) for joint in truth["joints"]]
    error = np.abs(given[order] - true) / np.maximum(np.abs(true), 1e-12)
    return float(np.median(error))


def _values(entry: dict[str, Any], names: Sequence[str]) -> np.ndarray:
    """Values of some parameters of an effect, one after the other."""
    return np.hstack([np.ravel(entry["parameters"][name]["value"]) for name in names])


def _finding(
    entry: dict[str, Any], truth: Sequence[Named], n: int, motions: Sequence[str]
) -> ScoredFinding:
    """A finding with its rivals, beside the truth."""
    candidates = [entry, *entry["alternatives"]]
    effects = {candidate["effect"]: named(candidate) for candidate in candidates}
    probabilities = [(c["effect"], c["probability"]) for c in candidates]
    right = {
        name: any(same(true, effect, n, motions) for true in truth)
        for name, effect in effects.items()
    }
    chosen = smallest_set(probabilities, LEVEL)
    return ScoredFinding(
        probability=float(entry["probability"]),
        right=right[entry["effect"]],
        covered=any(right[name] for name in chosen),
        size=len(chosen),
    )
