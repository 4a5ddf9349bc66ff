"""Making a set of blind cases: in parallel, resumable, the labels apart."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.conditions import CaseSpec
from gapscope.blind_check.own_laws import enter_own_laws
from gapscope.blind_check.plan import BlindPlan, allocate_cases
from gapscope.blind_check.seal import (
    COMMITMENT,
    LABELS,
    UNSEEN,
    commit,
    labels_folder,
)
from gapscope.provenance import sha256

PLAN = "plan.json"
"""Seed and plan of a set that is being made, beside its labels."""


def make(
    out: Path,
    plan: BlindPlan,
    *,
    seed: int | None = None,
    labels: Path | None = None,
    jobs: int = 1,
    progress: Callable[[str], None] = lambda message: None,
) -> tuple[Path, Path]:
    """Make the cases of a plan; those that are there already are kept.

    Args:
        out: folder of the cases.
        plan: what they are.
        seed: draws the same cases again; ``None``: a secret one, or that of the set that was begun.
        labels: folder of the labels and of the recordings held out; default ``out``-labels.
        jobs: cases at a time.
        progress: called with a short message after each case.

    Returns:
        The commitment and the labels.

    Raises:
        InputError: ``labels`` lies inside ``out``, or another plan or seed was begun there.
    """
    folder = (labels or labels_folder(out)).resolve()
    if folder.is_relative_to(out.resolve()):
        raise InputError(
            f"{folder} lies inside {out}",
            "keep the labels outside the cases",
            where="--labels",
        )
    begun = _begin(folder, plan, seed)
    specs = allocate_cases(plan, begun["seed"])
    names = [f"case{k:04d}" for k in range(len(specs))]
    parts = folder / "parts"
    todo = [
        k
        for k, name in enumerate(names)
        if not (out / name).is_dir() or not (parts / f"{name}.json").is_file()
    ]
    done = len(specs) - len(todo)
    work = (
        delayed(_one)(specs[k], names[k], (begun["seed"], 2, k), out, folder)
        for k in todo
    )
    for line in Parallel(n_jobs=jobs, return_as="generator_unordered")(work):
        done += 1
        progress(f"{done} of {len(specs)} made, {line}")
    cases = {
        name: read_json(parts / f"{name}.json", "run the command again")
        for name in names
    }
    write_json({"schema": 1, **begun, "cases": cases}, folder / LABELS, private=True)
    commit(out, folder / LABELS, len(names))
    return out / COMMITMENT, folder / LABELS


def _begin(folder: Path, plan: BlindPlan, seed: int | None) -> dict[str, Any]:
    """Seed, salt and plan of the set, from an earlier run if there was one."""
    file = folder / PLAN
    if file.is_file():
        begun = read_json(file, "remove it and the cases made so far")
        if begun["plan"] != plan.plain() or seed not in (None, begun["seed"]):
            raise InputError(
                "was begun with another plan or seed",
                "give the same ones, or other folders for cases and labels",
                file=file,
            )
        return begun
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    begun = {
        "seed": secrets.randbits(64) if seed is None else seed,
        "salt": secrets.token_hex(16),
        "plan": plan.plain(),
    }
    write_json(begun, file, private=True)
    return begun


def _one(
    spec: CaseSpec, name: str, seed: tuple[int, ...], out: Path, folder: Path
) -> str:
    """Make one case; its folder is renamed into place at the end, after its label was written."""
    enter_own_laws(spec.laws)  # a process of its own does not have them yet
    aside = out / f".{name}"
    shutil.rmtree(aside, ignore_errors=True)
    shutil.rmtree(out / name, ignore_errors=True)
    unseen = folder / UNSEEN / f"{name}.csv"
    try:
        made = make_case(spec, seed)
        write_case(made, name, spec.conditions.bare, aside, unseen)
        write_json(
            {**made.label, "unseen_sha256": sha256(unseen)},
            folder / "parts" / f"{name}.json",
            private=True,
        )
        aside.rename(out / name)
    except OSError as error:
        raise GapscopeError(
            f"{error.filename}: cannot be written ({error.strerror})",
            "check the folder's permissions",
        ) from None
    attempts = made.label["attempts"]
    return f"in {attempts} draw{'s' if attempts > 1 else ''}"
