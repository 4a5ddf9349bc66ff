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
from gapscope.blind_check.run import DONE, FROZEN
from gapscope.blind_check.scoring.classes import CLASSES
from gapscope.blind_check.scoring.closure import closure
from gapscope.blind_check.scoring.compare import Compared, compare
from gapscope.blind_check.scoring.summary import healthy, scores, summary, unknown
from gapscope.blind_check.seal import UNSEEN, open_labels
from gapscope.provenance import sha256, source_hash

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
    truth, unseen = (
        content["cases"],
        (labels if labels.is_dir() else labels.parent) / UNSEEN,
    )
    progress("predicts the recordings held out")
    work = (
        delayed(_compare)(
            name, label, cases / name, unseen / f"{name}.csv", results / name
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
        name
        for name in truth
        if hashes.get(name)
        != (
            sha256(file)
            if (file := results / name / "diagnosis.json").is_file()
            else None
        )
    ]
    return {
        "complete": bool(hashes),
        "source_sha256": begun["source_sha256"],
        "source_changed_during_the_run": begun.get("source_sha256_at_the_end")
        != begun["source_sha256"],
        "source_is_this": begun["source_sha256"] == source_hash(),
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
    out = {}
    for method, says in answers.items():
        chosen = [compare(name, label, says(name)) for name, label in truth.items()]
        kinds = dict.fromkeys(c.kind for c in chosen)
        out[method] = {
            "by_kind": {
                kind: scores([c for c in chosen if c.kind == kind]) for kind in kinds
            },
            "healthy": healthy([c for c in chosen if c.kind == "healthy"]),
            "unknown": unknown(chosen),
        }
    return out


def _answer_on(
    designs: dict[str, Design | None],
    method: Callable[[Design], dict[str, Any]],
    name: str,
) -> dict[str, Any] | None:
    made = designs[name]
    return None if made is None else method(made)


def _designs(cases: Path, names: list[str], jobs: int) -> list[Design | None]:
    return list(Parallel(n_jobs=jobs)(delayed(_design)(cases / name) for name in names))


def _design(folder: Path) -> Design | None:
    """The regression of a case; ``None`` where its recordings cannot be used by a plain method."""
    try:
        return design(folder)
    except (GapscopeError, ValueError, np.linalg.LinAlgError):
        return None


def _trained(cases: Path, labels: Path, jobs: int) -> Classifier:
    truth = open_labels(cases, labels)["cases"]
    usable = {
        name: label["effects"][0]["effect"] if label["effects"] else "healthy"
        for name, label in truth.items()
        if len(label["effects"]) <= 1
    }
    pairs = [
        (d, c)
        for d, c in zip(
            _designs(cases, list(usable), jobs), usable.values(), strict=True
        )
        if d is not None
    ]
    return train(np.stack([features(d) for d, _ in pairs]), [name for _, name in pairs])
