"""The reference of a comparison, from what a user has at hand: a case, or an arm identified before."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import real_path
from gapscope.arm.io.atomic_write import atomic_write, begin_results
from gapscope.diagnosis.diagnose import diagnose as diagnose_case
from gapscope.diagnosis.diagnose_change import (
    FOLDER,
    Change,
    KeptReference,
    check_same_arm,
    diagnose_change,
    identified_folder,
    identify_reference,
    place_of,
    read_reference,
    write_reference,
)
from gapscope.diagnosis.document.diagnosis_json import write_document
from gapscope.diagnosis.document.numbers import Number, number_rows
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.diagnosis.result import Diagnosis
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import write_corrected
from gapscope.ident.identification_json import write_case_beside
from gapscope.interface.models import case_file, case_of
from gapscope.interface.result import Result
from gapscope.provenance import KEY, made_from
from gapscope.reports.diagnosis import (
    CASE,
    CORRECTED,
    DOCUMENT,
    REPORT,
    URDF,
    render,
    summary,
)
from gapscope.reports.mended_case import write_mended_case

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
    # against itself nothing has changed, whatever is wrong
    if source.get("case_sha256") == made_from(case)["case_sha256"]:
        raise InputError(
            "is the case itself",
            "give recordings of the same arm from a day on which it was healthy",
            where=place_of(reference),
        )
    # an identified one is checked when the case is compared with it
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
    # a case is identified once for all cases, beside their results
    folder = out / FOLDER
    # what an earlier run left may not be whole
    with suppress(InputError):
        earlier = read_reference(folder)
        # the same files and the same program identify the same arm
        if earlier.made_from == made_from(reference):
            return folder, earlier
    found = identified(reference, progress)
    write_reference(found, folder)
    return folder, found


@dataclass(frozen=True, repr=False)
class DiagnosisResult(Result):
    """The findings on one case.

    Attributes:
        case: the case.
        diagnosis: document, effects, and what the report draws.
        change: what changed since a reference, if the case was compared with one.
        workspace: the folder of the identified arm's URDF, which lasts as long as this record.
    """

    COLUMNS = (*Number._fields, "probability", "share", "named")

    case: Case
    diagnosis: Diagnosis
    change: Change | None = None
    workspace: tempfile.TemporaryDirectory[str] | None = field(default=None, repr=False)

    @property
    def document(self) -> Mapping[str, Any]:
        """The content of ``diagnosis.json``."""
        return self.diagnosis.document

    @property
    def verdict(self) -> str:
        """``effects_found``, ``no_gap`` or ``unexplained``."""
        return str(self.document["verdict"])

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """The effects named, the one with the largest share first."""
        return self.change.effects if self.change else self.diagnosis.effects

    @property
    def possible(self) -> tuple[AppliedEffect, ...]:
        """The effects that are possible and not confirmed, by share; none of them is part of ``corrected``."""
        return self.diagnosis.possible

    @property
    def corrected(self) -> CorrectedArm:
        """The nominal arm, or the one identified on the reference, plus the effects found."""
        if self.change:
            return self.change.corrected
        arm = self.case.arm
        # how friction builds up is part of the arm, not an effect of its own
        if self.diagnosis.presliding:
            arm = replace(arm, presliding=np.array(self.diagnosis.presliding))
        states = self.diagnosis.states
        # as the arm was at the end
        last = states[-1].effects if states else self.effects
        return CorrectedArm(arm, last, states=states)

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``corrected.yaml``, ``report.html`` and, as the last, ``diagnosis.json``.

        If faults of the set-up were found that another reading of the files puts right, also ``mended_case.yaml``, the
        case that reads them so.

        After a comparison with a reference also ``identified_case.yaml`` and ``identified.urdf``: the case with the
        identified arm as its nominal one, which ``corrected.yaml`` corrects; and, if the reference was identified in
        this run, ``identified``, the folder that a later comparison takes as ``against``.
        """
        out, found, change = Path(folder), self.diagnosis, self.change
        begin_results(out, DOCUMENT)
        # written only if some file needs it: a case in memory has none
        source = partial(case_file, self.case, out)
        others = write_mended_case(found.faults, self.case, source, out)
        # the identified arm goes along as a case: corrected.yaml counts from it
        if change is not None:
            with atomic_write(out / URDF) as aside:
                shutil.copyfile(change.case.arm.urdf, aside)
            write_case_beside(change.case.arm, source(), out / CASE, URDF)
            others = (out / CASE, out / URDF, *others)
            # read from a folder: there it stays
            if change.reference.file is None:
                others = (*others, write_reference(change.reference, out / FOLDER))
        elif real_path(self.case.arm.urdf) != real_path(out / URDF):
            # what the corrected.yaml of an earlier comparison corrects, unless it is this very case
            old = out / CORRECTED
            if old.is_file() and f"corrects: {CASE}" in old.read_text("utf-8"):
                for name in (CASE, URDF):
                    (out / name).unlink(missing_ok=True)
        write_corrected(
            str(self.document["case"]),
            self.effects,
            out / CORRECTED,
            presliding=found.presliding,
            corrects=None if change is None else CASE,
            remainder=None if change is None else change.remainder,
            states=found.states,
        )
        render(found, out / REPORT)
        # last: with it the results are whole
        write_document(self.document, out / DOCUMENT)
        return out / REPORT, out / DOCUMENT, out / CORRECTED, *others

    def shown(self) -> RenderableType:
        """Verdict, effects, gap per joint, what is possible, what is open and the warnings."""
        return summary(self.document)

    def table(self) -> Iterator[dict[str, Any]]:
        """A row for each number of each effect: place, value, standard deviation, probability, share, named."""
        return number_rows(self.document)


def diagnose(
    case: Case | str | Path,
    *,
    against: Reference | None = None,
    progress: Progress = silent,
) -> DiagnosisResult:
    """Find where the gap of a case lies, which effects cause it, and how far it shrinks with them.

    Args:
        case: the nominal arm and its recordings; or the folder of a case.
        against: a case of the same arm, known healthy and without load: what changed since then? Or what an earlier
            comparison with it has identified: the folder ``identified`` of its results, or ``change.reference``.
        progress: called with a few words at each step.

    Raises:
        InputError: the case cannot be used; names the file and the line or field.
        GapscopeError: no recording carries a torque that can be trusted, nor is there a known controller.

    Examples:
        >>> import gapscope
        >>> result = gapscope.diagnose("my_arm")  # doctest: +SKIP
        >>> result.verdict, [effect.name for effect in result.effects]  # doctest: +SKIP
        ('effects_found', ['payload'])
    """
    progress("reads the case")
    # units may be wrong: the diagnosis tests that
    loaded = case_of(case, any_unit=True)
    # of the files as they are, before anything is put right
    source = made_from(loaded)
    if against is None:
        found = diagnose_case(loaded, progress)
        return DiagnosisResult(loaded, _with_source(found, source))
    # checks before minutes of work
    known = known_reference(against)
    check_reference(loaded, known)
    reference = identified(known, progress)
    # the identified URDF must be a file as long as the case is predicted with it
    workspace = tempfile.TemporaryDirectory(prefix="gapscope-")
    change = diagnose_change(loaded, reference, Path(workspace.name), progress)
    found = _with_source(change.diagnosis, source)
    return DiagnosisResult(loaded, found, change, workspace)


def _with_source(diagnosis: Diagnosis, source: Mapping[str, str]) -> Diagnosis:
    return replace(diagnosis, document={**diagnosis.document, KEY: source})
