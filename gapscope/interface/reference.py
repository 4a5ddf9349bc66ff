"""The reference of a comparison, from what a user has at hand: a case, or an arm identified before."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import InputError
from gapscope.diagnosis.diagnose_change import (
    FOLDER,
    KeptReference,
    check_same_arm,
    identified_folder,
    identify_reference,
    place_of,
    read_reference,
    write_reference,
)
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.provenance import made_from

Reference = Case | KeptReference | str | Path
"""A case of the same arm, an arm identified on one, or the path of either."""


def known_reference(against: Reference) -> Case | KeptReference:
    """The reference as it is known: a case, or an arm identified before.

    Raises:
        InputError: there is neither at that path.
    """
    if isinstance(against, (Case, KeptReference)):
        return against
    folder = identified_folder(Path(against))
    return load_case(against) if folder is None else read_reference(folder)


def identified(
    reference: Case | KeptReference,
    progress: Progress = silent,
) -> KeptReference:
    """The arm of a reference; a case is identified.

    Raises:
        InputError: nothing can be identified from its recordings.
        GapscopeError: no physically consistent parameters were found.
    """
    if isinstance(reference, KeptReference):
        return reference
    found = identify_reference(
        reference, lambda message: progress(f"reference: {message}")
    )
    return replace(found, made_from=made_from(reference))


def check_reference(case: Case, reference: Case | KeptReference) -> None:
    """Check, before anything is identified, that a reference is of the same arm and is not the case itself.

    Raises:
        InputError: it is the case itself, or of another arm.
    """
    source = (
        made_from(reference) if isinstance(reference, Case) else reference.made_from
    )
    if source.get("case_sha256") == made_from(case)["case_sha256"]:
        raise InputError(
            "is the case itself",
            "give recordings of the same arm from a day on which it was healthy",
            where=place_of(reference),
        )
    if isinstance(reference, Case):
        check_same_arm(case, reference)


def kept_reference(
    against: Path,
    out: Path,
    progress: Progress = silent,
) -> tuple[Path, KeptReference]:
    """The folder of an identified reference, for several cases: a case is identified once, and kept beside the results.

    What an earlier run identified on the same files, with the same program, is taken again.

    Args:
        against: the case of the reference, or the folder of an arm identified before.
        out: folder of the results; a case is identified into ``identified`` in it.
        progress: called with a few words at each step.

    Returns:
        The folder, and the reference in it.

    Raises:
        InputError: as ``known_reference`` and ``identified``.
        GapscopeError: as ``identified``; or the folder cannot be written.
    """
    reference = known_reference(against)
    if isinstance(reference, KeptReference):
        assert reference.file is not None
        return reference.file.parent, reference
    folder = out / FOLDER
    earlier = _earlier(folder)
    if earlier is not None and earlier.made_from == made_from(reference):
        return folder, earlier
    found = identified(reference, progress)
    write_reference(found, folder)
    return folder, found


def _earlier(folder: Path) -> KeptReference | None:
    """What an earlier run identified; ``None`` if it left nothing whole."""
    try:
        return read_reference(folder)
    except InputError:
        return None
