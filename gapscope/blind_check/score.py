"""The score: labels opened, each verdict set beside its truth, figures, tables and pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import read_json
from gapscope.blind_check.baselines.classifier import Classifier, features, train
from gapscope.blind_check.baselines.columns import Design, design
from gapscope.blind_check.baselines.methods import (
    chance,
    forward_bic,
    largest_r2,
    ridge,
)
from gapscope.blind_check.run import DONE, FROZEN, diagnosis_hash
from gapscope.blind_check.scoring.classes import CLASSES
from gapscope.blind_check.scoring.closure import closure
from gapscope.blind_check.scoring.compare import Compared, compare
from gapscope.blind_check.scoring.summary import healthy, scores, summary, unknown
from gapscope.blind_check.seal import UNSEEN, open_labels
from gapscope.provenance import source_hash

METHODS = {"largest R^2": largest_r2, "forward BIC": forward_bic, "ridge": ridge}
"""Baselines that need nothing but the case."""


@dataclass(frozen=True)
class Scored:
    """A blind check, scored.

    Attributes:
        figures: what ``score.json`` holds.
        cases: verdict and truth of each case.
    """

    figures: dict[str, Any]
    cases: tuple[Compared, ...]


def score(
    cases: Path,
    results: Path,
    labels: Path,
    *,
    baselines: bool = True,
    training: tuple[Path, Path] | None = None,
    jobs: int = 1,
    progress: Callable[[str], None] = lambda message: None,
) -> Scored:
    """Open the labels and score the verdicts.

    Args:
        cases, results: folders of ``make`` and ``run``.
        labels: file of the labels, or its folder.
        baselines: whether to run the plain methods as well.
        training: folder of other cases and their labels, on which the classifier is trained.
        jobs: cases at a time.
        progress: called with a few words at each step.

    Raises:
        InputError: the labels are not those that were committed to.
    """
    progress("compares the labels with the commitment")
    content = open_labels(cases, labels)
    truth = content["cases"]
    folder = labels if labels.is_dir() else labels.parent
    progress("predicts the recordings held out")
    work = (
        delayed(_compare)(
            name,
            label,
            cases / name,
            folder / UNSEEN / f"{name}.csv",
            results / name,
        )
        for name, label in truth.items()
    )
    compared = tuple(Parallel(n_jobs=jobs)(work))
    figures: dict[str, Any] = {
        "schema": 1,
        "frozen": _frozen(results, truth),
        "plan": content["plan"],
        "classes": [[c.first, c.second, c.when, c.why] for c in CLASSES],
        **summary(compared),
    }
    if baselines:
        progress("runs the baselines")
        figures["baselines"] = _baselines(cases, truth, training, jobs)
    return Scored(figures, compared)


def _compare(
    name: str, label: dict[str, Any], case: Path, unseen: Path, results: Path
) -> Compared:
    """One case, with the gap that the diagnosis closes on the held-out recording."""
    file = results / "diagnosis.json"
    document = (
        read_json(file, "run gapscope blind run again") if file.is_file() else None
    )
    done = results / DONE
    seconds = read_json(done, "remove it")["seconds"] if done.is_file() else None
    closed = None
    if document is not None and label["measure"] == "torque" and label["effects"]:
        closed = closure(
            case, unseen, results / "corrected.yaml", np.array(label["floor"])
        )
    return compare(name, label, document, seconds, closed)


def _frozen(results: Path, truth: dict[str, Any]) -> dict[str, Any]:
    """Whether the run was frozen: one source throughout, no diagnosis changed after it."""
    begun = read_json(results / FROZEN, "run gapscope blind run first")
    hashes = begun.get("diagnoses") or {}
    changed = [
        name for name in truth if hashes.get(name) != diagnosis_hash(results / name)
    ]
    source = begun["source_sha256"]
    return {
        "complete": bool(hashes),
        "source_sha256": source,
        "source_changed_during_the_run": begun.get("source_sha256_at_the_end")
        != source,
        "source_is_this": source == source_hash(),
        "changed_after_the_run": changed,
    }


def _baselines(
    cases: Path, truth: dict[str, Any], training: tuple[Path, Path] | None, jobs: int
) -> dict[str, Any]:
    """Figures of each plain method on the same cases."""
    designs = dict(zip(truth, _designs(cases, list(truth), jobs), strict=True))
    rng = np.random.default_rng(0)
    answers: dict[str, Callable[[str], dict[str, Any] | None]] = {
        "chance": lambda name: chance(len(truth[name]["gap"]), rng),
    }
    for method, function in METHODS.items():
        answers[method] = partial(_answer_on, designs, function)
    if training is not None:
        classifier = _trained(*training, jobs)
        answers["classifier"] = partial(_answer_on, designs, classifier.diagnose)
    figures = {}
    for method, answer_to in answers.items():
        compared = [
            compare(name, label, answer_to(name)) for name, label in truth.items()
        ]
        figures[method] = _method_figures(compared)
    return figures


def _method_figures(compared: list[Compared]) -> dict[str, Any]:
    """Figures of one plain method."""
    by_kind: dict[str, list[Compared]] = {}
    for case in compared:
        by_kind.setdefault(case.kind, []).append(case)
    return {
        "by_kind": {kind: scores(chosen) for kind, chosen in by_kind.items()},
        "healthy": healthy(by_kind.get("healthy", [])),
        "unknown": unknown(compared),
    }


def _answer_on(
    designs: dict[str, Design | None],
    method: Callable[[Design], dict[str, Any]],
    name: str,
) -> dict[str, Any] | None:
    """Answer of a method that needs the regression of a case."""
    made = designs[name]
    return None if made is None else method(made)


def _designs(cases: Path, names: list[str], jobs: int) -> list[Design | None]:
    return list(Parallel(n_jobs=jobs)(delayed(_design)(cases / name) for name in names))


def _design(folder: Path) -> Design | None:
    """The regression of a case; ``None`` if its recordings cannot be used by a plain method."""
    try:
        return design(folder)
    except (GapscopeError, ValueError, np.linalg.LinAlgError):
        return None


def _trained(cases: Path, labels: Path, jobs: int) -> Classifier:
    """The classifier, trained on the cases with at most one cause; what is outside the catalogue is ``unknown``."""
    truth = open_labels(cases, labels)["cases"]
    class_of = {}
    for name, label in truth.items():
        if len(label["effects"]) <= 1:
            effects = [entry["effect"] for entry in label["effects"]]
            class_of[name] = effects[0] if effects else "healthy"
    rows, names = [], []
    for name, made in zip(class_of, _designs(cases, list(class_of), jobs), strict=True):
        if made is not None:
            rows.append(features(made))
            names.append(class_of[name])
    return train(np.stack(rows), names)
