"""The seal: labels that are kept apart from the cases, and the commitment published beside the cases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.provenance import sha256

COMMITMENT = "commitment.json"
"""File beside the cases that fixes the labels without revealing them."""
LABELS = "labels.json"
"""File with the truth."""
UNSEEN = "unseen"
"""Folder beside the labels with the recordings that are held out."""


def labels_folder(cases: Path) -> Path:
    """Where labels lie by default: ``DIR-labels`` beside DIR."""
    cases = cases.resolve()
    return cases.with_name(f"{cases.name}-labels")


def commit(cases: Path, labels: Path, count: int) -> None:
    """Publish the hash of the labels beside the cases."""
    write_json(
        {"schema": 1, "cases": count, "labels_sha256": sha256(labels)},
        cases / COMMITMENT,
    )


def read_commitment(cases: Path) -> dict[str, Any]:
    """The commitment of a set of cases.

    Raises:
        InputError: there is none: the set is not complete, or this is no such set.
    """
    return read_json(
        cases / COMMITMENT,
        "gapscope blind make ends with it; run that again for the rest",
    )


def open_labels(cases: Path, labels: Path) -> dict[str, Any]:
    """The labels, after their hash was compared with the commitment.

    Raises:
        InputError: these are not the labels that were committed to.
    """
    labels = labels / LABELS if labels.is_dir() else labels
    content = read_json(labels, "give the labels that gapscope blind make wrote")
    if sha256(labels) != read_commitment(cases)["labels_sha256"]:
        raise InputError(
            "is not the file whose hash was published with the cases",
            f"give the labels that belong to {cases}, unchanged",
            file=labels,
        )
    for name, label in content["cases"].items():
        unseen = labels.parent / UNSEEN / f"{name}.csv"
        if not unseen.is_file() or sha256(unseen) != label["unseen_sha256"]:
            raise InputError(
                "is not the recording that was held out",
                "restore it beside the labels",
                file=unseen,
            )
    return content


def readable_labels(cases: Path, labels: Path | None = None) -> Path | None:
    """A file with the truth that this process can read, or ``None``.

    Looked at are the path given; every file in the place where labels lie by default; and, in the cases' folder and in
    the folders beside it, every ``labels.json`` with the hash that was committed to.
    """
    cases = cases.resolve()
    certain = [labels_folder(cases)]
    if labels is not None:
        certain.append(labels.resolve())
    for place in certain:
        files = [place]
        if place.is_dir():
            files = sorted(path for path in place.rglob("*") if path.is_file())
        for file in files:
            if _readable(file):
                return file
    wanted = read_commitment(cases)["labels_sha256"]
    around = {cases, cases.parent, *_folders(cases), *_folders(cases.parent)}
    for folder in sorted(around):
        place = folder / LABELS
        if _readable(place) and sha256(place) == wanted:
            return place
    return None


def _folders(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.is_dir())
    except OSError:
        return []


def _readable(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return bool(file.read(1))
    except OSError:
        return False
