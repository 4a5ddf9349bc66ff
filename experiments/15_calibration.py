"""Fit the probabilities of findings to a blind set made for it alone.

Writes ``gapscope/diagnosis/assessment/calibration.json``.

    .venv/bin/python experiments/15_calibration.py CASES RESULTS LABELS [CASES RESULTS LABELS ...] [--dry]

CASES, RESULTS and LABELS are the folders of ``gapscope blind make`` and ``gapscope blind run``. The blind check that is
reported must be another set, from another seed. Prints how well the probabilities hold on cases left out of the fit.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from gapscope.arm.io.json_file import to_json, write_json
from gapscope.blind_check.check import open_labels
from gapscope.blind_check.scoring import brier, compare, ece
from gapscope.diagnosis.assessment.confidence import (
    FILE,
    WEIGHT_PRECISION,
    Alternative,
    Support,
    probability,
    with_probabilities,
)
from gapscope.effects.catalogue import CATALOGUE

PRIOR_EFFECT = 4.0
"""Inverse variance of the number of each effect: few errors are seen of any one."""
LEVEL = 0.9
"""Coverage of the conformal sets."""
SEEN = 0.95
"""Share of the findings whose healthy residual counts as seen [1]."""


class Finding(NamedTuple):
    """One finding of a blind case: what supports it, whether it is right, which effects of the case nothing names."""

    case: str
    effect: str
    support: Support
    alternatives: tuple[Alternative, ...]
    right: bool
    missed: frozenset[str]


def findings(cases: Path, results: Path, labels: Path) -> list[Finding]:
    """All findings on a blind set that carry their support."""
    out = []
    for name, label in open_labels(cases, labels)["cases"].items():
        file = results / name / "diagnosis.json"
        if label["kind"] == "ladder" or not file.is_file():
            continue
        document = json.loads(file.read_text(encoding="utf-8"))
        # what is possible was weighed as well: without it only the likely findings would be learnt from
        weighed = [*document["effects"], *document["possible"]]
        named = {entry["effect"] for entry in weighed}
        missed = frozenset(entry["effect"] for entry in label["effects"]) - named
        judged = compare(name, label, {**document, "effects": weighed}).findings
        for entry, finding in zip(weighed, judged, strict=True):
            if "support" in entry:
                alternatives = tuple(
                    Alternative(r["effect"], (), 0.0, r["evidence"])
                    for r in entry["alternatives"]
                    if not r["equivalent"]
                )
                support = Support(**entry["support"])
                out.append(
                    Finding(
                        f"{cases}/{name}",
                        entry["effect"],
                        support,
                        alternatives,
                        finding.right,
                        missed,
                    )
                )
    return out


def fit(known: Sequence[Finding]) -> dict[str, Any]:
    """Intercept, weights and numbers of the effects, of the largest posterior."""
    x = np.array([f.support.features() for f in known])
    right = np.array([f.right for f in known], dtype=float)
    names = sorted(CATALOGUE)
    which = np.array([[f.effect == name for name in names] for f in known], dtype=float)
    known_alternatives = np.array([f.support.evidence for f in known])
    count = x.shape[1]

    def loss(v: np.ndarray) -> float:
        p = known_alternatives / (
            1.0 + np.exp(-(v[0] + x @ v[1 : 1 + count] + which @ v[1 + count :]))
        )
        likelihood = -np.log(np.where(right > 0, p, 1.0 - p) + 1e-12).sum()
        return float(
            likelihood
            + 0.5 * WEIGHT_PRECISION * v[1 : 1 + count] @ v[1 : 1 + count]
            + 0.5 * PRIOR_EFFECT * v[1 + count :] @ v[1 + count :]
        )

    v = minimize(loss, np.zeros(1 + count + len(names)), method="L-BFGS-B").x
    return {
        "intercept": round(float(v[0]), 4),
        "weights": [round(float(w), 4) for w in v[1 : 1 + count]],
        "effects": {
            name: round(float(w), 4)
            for name, w in zip(names, v[1 + count :], strict=True)
            if abs(w) > 5e-4
        },
    }


def fit_alternatives(known: Sequence[Finding]) -> dict[str, float]:
    """Temper of the evidence of alternatives and weight of unlisted causes, most likely on findings that are wrong."""
    wrong = [f for f in known if not f.right]

    def likelihood(temper: float, unlisted: float) -> float:
        total = 0.0
        for f in wrong:
            ranked = with_probabilities(
                f.alternatives, 0.0, f.support, {"temper": temper, "unlisted": unlisted}
            )
            true = f.missed or {"none"}
            listed = [other.probability for other in ranked if other.effect in true]
            total += np.log(
                max(
                    sum(listed) if listed else 1.0 - sum(r.probability for r in ranked),
                    1e-6,
                )
            )
        return total

    grid = itertools.product(
        (0.005, 0.01, 0.02, 0.05, 0.1, 0.2),
        (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0),
    )
    temper, unlisted = (
        max(grid, key=lambda pair: likelihood(*pair)) if wrong else (0.05, 0.5)
    )
    return {"temper": temper, "unlisted": unlisted}


def fit_level(known: Sequence[Finding], values: dict[str, Any]) -> float:
    """Level at which the sets hold the truth in ``LEVEL`` of the findings, or as near as they come."""
    reached = []
    for f in known:
        if f.right:
            reached.append(0.0)
            continue
        p = probability(f.effect, f.support, values)
        total = p
        for other in with_probabilities(f.alternatives, p, f.support, values):
            if other.effect in f.missed or (other.effect == "none" and not f.missed):
                break
            total += other.probability
        reached.append(total)
    quantile = float(
        np.quantile(reached, min(1.0, LEVEL * (1 + 1 / len(reached))), method="higher")
    )
    return round(float(np.clip(quantile + 1e-6, LEVEL, 0.999)), 6)


def left_out(known: Sequence[Finding], folds: int = 10) -> np.ndarray:
    """Probability of each finding by a fit without a tenth of the cases, its own among them."""
    cases = sorted({f.case for f in known})
    place = {
        case: k % folds
        for k, case in enumerate(np.random.default_rng(0).permutation(cases))
    }
    out = np.empty(len(known))
    for fold in range(folds):
        values = {
            # all arms are of the same generator
            "expected": 1.0,
            **fit([f for f in known if place[f.case] != fold]),
        }
        for k, f in enumerate(known):
            if place[f.case] == fold:
                out[k] = probability(f.effect, f.support, values)
    return out


def main() -> None:
    """Fit, report and write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    parser.add_argument("--dry", action="store_true", help="report without writing")
    arguments = parser.parse_args()
    if len(arguments.folders) % 3:
        parser.error("give three folders for each set: cases, results, labels")
    known = [
        f
        for k in range(0, len(arguments.folders), 3)
        for f in findings(*arguments.folders[k : k + 3])
    ]
    right = np.array([f.right for f in known], dtype=float)
    p = left_out(known)
    print(
        f"{len(known)} findings, {right.mean():.1%} right; left out of the fit: mean probability {p.mean():.1%}, "
        f"Brier {brier(p, right):.3f} (constant {right.var():.3f}), ECE {ece(p, right):.3f}"
    )
    for low, high in itertools.pairwise((0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)):
        inside = (p > low) & (p <= high)
        if inside.any():
            print(
                f"  {low:.2f} to {high:.2f}: {inside.sum():3d} findings, said {p[inside].mean():.2f}, "
                f"right {right[inside].mean():.2f}"
            )
    values: dict[str, Any] = {
        "fitted_by": "experiments/15_calibration.py",
        "findings": len(known),
        **fit(known),
    }
    values["expected"] = round(
        float(np.quantile([f.support.expected for f in known], SEEN)), 4
    )
    values |= fit_alternatives(known)
    values["level"] = fit_level(known, values)
    print(to_json(values))
    if not arguments.dry:
        write_json(values, FILE)
        print(f"wrote {FILE}")


if __name__ == "__main__":
    main()
