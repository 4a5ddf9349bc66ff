"""Scores of the benchmark of real arms, as tables; see ``26_real_benchmark.py``.

Names are matched as in the blind check (``gapscope/blind_check/scoring``): exact equivalents count as the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from real_plan import Planned

from gapscope.blind_check.scoring.classes import Named, matched, named, same
from gapscope.blind_check.scoring.compare import Compared, compare
from gapscope.blind_check.scoring.statistics import (
    brier,
    proportion,
    reliability,
    wilson,
)
from gapscope.reports.blind_check.tables import Table


@dataclass(frozen=True)
class Scored:
    """A case with its truth, its result and how they compare.

    Attributes:
        plan, truth: the case.
        result: of the diagnosis: ``status``, ``document``, seconds.
        compared: names, joints and parameters beside the truth.
    """

    plan: Planned
    truth: dict[str, Any]
    result: dict[str, Any]
    compared: Compared

    @property
    def document(self) -> dict[str, Any]:
        """The diagnosis, empty if there is none."""
        return dict(self.result.get("document") or {})

    @property
    def links(self) -> tuple[bool, ...]:
        """Per link inertia that is named rightly whether it is on the right link."""
        found = self.compared.found
        pairs = matched(self.compared.truth, found, len(self.truth["gap"]), ["slow"])
        both = [(self.compared.truth[i], found[j]) for i, j in pairs]
        return tuple(
            a.link == b.link for a, b in both if a.effect == b.effect and a.link
        )


def scored(plan: Planned, truth: dict[str, Any], result: dict[str, Any]) -> Scored:
    """Set a result beside its truth."""
    document = result.get("document") or {}
    slide = len(truth["gap"]) == 1
    for entry in (*document.get("effects", []), *document.get("possible", [])):
        for one in (entry, *entry.get("alternatives", [])):
            if one["probability"] is None:
                # what is no number says nothing in favour of the effect
                one["probability"] = 0.0
            if slide and one["effect"] in ("armature", "link_inertia"):
                # the mass of a slide has one name
                one["effect"], one["joints"] = "payload", []
    compared = compare(
        plan.name, truth, result.get("document"), result.get("cpu_seconds")
    )
    return Scored(plan, truth, result, compared)


def score_tables(cases: Sequence[Scored]) -> list[Table]:
    """All tables."""
    faulty = [c for c in cases if c.plan.kind != "healthy"]
    return [
        _overview("Total", cases, lambda c: "all"),
        _overview("By mode", cases, lambda c: c.plan.mode),
        _overview("By arm", cases, lambda c: c.plan.arm),
        _overview("By kind", cases, lambda c: c.plan.kind),
        _overview("By size (times what a full model leaves)", faulty, _size),
        _overview("By effect (singles)", _singles(cases), _effect),
        _verdicts(cases),
        _calibration(cases),
        _possible(cases),
        _wrong(cases),
    ]


def _singles(cases: Sequence[Scored]) -> list[Scored]:
    return [c for c in cases if c.plan.kind == "single"]


def _size(case: Scored) -> str:
    return "fault" if case.truth["measure"] == "none" else f"{case.plan.size:g}"


def _effect(case: Scored) -> str:
    return str(case.truth["effects"][0]["effect"])


def _share(values: Sequence[bool]) -> str:
    """Hits of a count with the percentage."""
    if not values:
        return "–"
    hits, total = proportion(values)
    return f"{hits}/{total} ({100 * hits / total:.0f} %)"


def _overview(
    title: str, cases: Sequence[Scored], key: Callable[[Scored], str]
) -> Table:
    """One row for each value of a key."""
    head = ("", "cases", "healthy: named", "first answer", "exact set", "joints")
    head = (*head, "parameter error", "seconds: median, worst", "failed")
    groups: dict[str, list[Scored]] = {}
    for case in cases:
        groups.setdefault(key(case), []).append(case)
    rows = [(name, *_figures(groups[name])) for name in sorted(groups)]
    return Table(title, head, tuple(rows))


def _figures(cases: Sequence[Scored]) -> tuple[str, ...]:
    healthy = [c for c in cases if c.plan.kind == "healthy"]
    faulty = [c.compared for c in cases if c.plan.kind != "healthy"]
    joints = [right for c in faulty for right in c.joints]
    joints += [right for c in cases for right in c.links]
    errors = [e for c in faulty for e in c.errors]
    seconds = [float(c.result["cpu_seconds"]) for c in cases]
    failed = sum(c.result["status"] != "done" for c in cases)
    return (
        str(len(cases)),
        _share([bool(c.compared.found) for c in healthy]),
        _share([c.top for c in faulty]),
        _share([c.exact for c in faulty]),
        _share(joints),
        f"{100 * np.median(errors):.0f} %" if errors else "–",
        f"{np.median(seconds):.0f}, {max(seconds):.0f}",
        str(failed),
    )


def _verdicts(cases: Sequence[Scored]) -> Table:
    """How often each verdict, by kind and mode."""
    names = ("no_gap", "effects_found", "unexplained", "failed")
    counts: dict[str, Counter[str]] = {}
    for case in cases:
        group = f"{case.plan.kind}, {case.plan.mode}"
        counts.setdefault(group, Counter())[case.compared.verdict] += 1
    rows = [
        (group, *(str(counts[group][name]) for name in names))
        for group in sorted(counts)
    ]
    return Table("Verdicts", ("", *names), tuple(rows))


def _calibration(cases: Sequence[Scored]) -> Table:
    """Stated probability of all named and possible effects against how often they are right."""
    probability, right = [], []
    for case in cases:
        for entry in _stated(case):
            probability.append(float(entry["probability"]))
            right.append(_is_right(case, named(entry)))
    p, r = np.array(probability), np.array(right, dtype=float)
    rows = []
    for row in reliability(p, r, bins=5):
        hits = round(row["right"] * row["count"])
        low, high = wilson(hits, int(row["count"]))
        rows.append(
            (
                f"{row['from']:.1f} to {row['to']:.1f}",
                str(row["count"]),
                f"{row['probability']:.2f}",
                f"{row['right']:.2f}",
                f"{low:.2f} to {high:.2f}",
            )
        )
    score = brier(p, r)
    title = "Calibration" if score is None else f"Calibration (Brier {score:.2f})"
    head = ("probability", "effects", "mean stated", "right", "95 % interval")
    return Table(title, head, tuple(rows))


def _stated(case: Scored) -> list[dict[str, Any]]:
    """Effects that are named or possible."""
    return [*case.document.get("effects", []), *case.document.get("possible", [])]


def _is_right(case: Scored, one: Named) -> bool:
    n = len(case.truth["gap"])
    return any(same(true, one, n, ["slow"]) for true in case.compared.truth)


def _possible(cases: Sequence[Scored]) -> Table:
    """Effects that are only possible: how many, and how often right."""
    rows = []
    for kind in ("healthy", "single", "pair"):
        entries = [
            _is_right(c, named(e))
            for c in cases
            if c.plan.kind == kind
            for e in c.document.get("possible", [])
        ]
        rows.append((kind, str(len(entries)), str(sum(entries))))
    return Table("Possible effects", ("", "listed", "right"), tuple(rows))


def _wrong(cases: Sequence[Scored]) -> Table:
    """Cases whose answer is not the truth."""
    head = ("case", "kind", "size", "truth", "answer", "possible", "verdict")
    rows = []
    for case in cases:
        c = case.compared
        right = not c.found if case.plan.kind == "healthy" else c.exact
        if right and case.result["status"] == "done":
            continue
        document = case.document
        rows.append(
            (
                case.plan.name,
                case.plan.kind,
                f"{case.plan.size:g}",
                ", ".join(_short(e) for e in case.truth["effects"]) or "–",
                ", ".join(_short(e) for e in document.get("effects", [])) or "–",
                ", ".join(_short(e) for e in document.get("possible", [])) or "–",
                str(document.get("verdict", case.result.get("error", "")))[:90],
            )
        )
    return Table("Wrong cases", head, tuple(rows))


def _short(entry: dict[str, Any]) -> str:
    """``coulomb_friction [3] 1.2 N m (97 %)``."""
    values = []
    for parameter in list(entry["parameters"].values())[:2]:
        value = parameter["value"]
        text = (
            value
            if isinstance(value, str)
            else np.array2string(
                np.asarray(value, dtype=float), precision=3, separator=", "
            )
        )
        values.append(f"{text} {parameter['unit']}".strip())
    joints = entry["joints"] or ""
    chance = f" ({100 * entry['probability']:.0f} %)" if "probability" in entry else ""
    return f"{entry['effect']} {joints} {'; '.join(values)}{chance}".replace("  ", " ")
