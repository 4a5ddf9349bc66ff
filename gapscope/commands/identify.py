"""Identification of a case from its files to its results."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.commands.diagnose import make_folder
from gapscope.effects.corrected_file import write_corrected
from gapscope.ident.checks.troubleshooting import FOUND, Row
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)
from gapscope.ident.output.base_file import write_base
from gapscope.ident.output.identification_json import document, write_document
from gapscope.ident.output.identified_arm import (
    effects,
    expressible,
    urdf_text,
    write_case_beside,
)
from gapscope.reports.identification import render

DOCUMENT, REPORT, EFFECTS = "identification.json", "report.html", "identified.yaml"
CASE, URDF, BASE = "identified_case.yaml", "identified.urdf", "base_parameters.npz"
RECORDINGS = (".csv", ".parquet", ".npz", ".mcap", ".db3")
"""How files end that hold a recording and no case."""
SHORT = 160
"""Most characters of a warning on the terminal; the report has all of it."""


@dataclass(frozen=True)
class Identified:
    """An identification and what was written of it.

    Attributes:
        result: what was identified.
        paths: the files, the report first.
        left_out: what of the model the identified arm's files cannot say, or an empty string.
    """

    result: Identification
    paths: tuple[Path, ...]
    left_out: str


def identify_path(
    path: Path,
    out: Path,
    settings: IdentificationSettings,
    progress: Callable[[str], None] = lambda message: None,
) -> Identified:
    """Identify the case at a path and write report, identified arm and, as the last, ``identification.json``.

    Raises:
        InputError: ``path`` is a recording, or the case cannot be identified from.
        GapscopeError: no physically consistent parameters were found, or a file cannot be written.

    The identified arm is a URDF of consistent bodies, a case beside it with the data sheet, and ``identified.yaml``
    with the effects that the catalogue has: ``predict``, ``replay`` and ``gap`` read the case with that as model.
    """
    if path.suffix.lower() in RECORDINGS:
        raise InputError(
            "is a recording, not a case",
            "give the case.yaml that lists it, or its folder",
            file=path,
        )
    make_folder(out)
    try:
        (out / DOCUMENT).unlink(missing_ok=True)
    except OSError as error:
        raise GapscopeError(
            f"{out / DOCUMENT}: cannot be replaced ({error.strerror})", "remove it"
        ) from None
    progress("reads the case")
    case = load_case(path)
    result = identify(case, settings, progress)
    plain, left_out = result, ""
    if not expressible(result):
        progress("identifies what URDF, data sheet and effects can say")
        plain = identify(
            case, replace(settings, cutoff=result.settings.cutoff, plain=True)
        )
        left_out = (
            f"{URDF}, {CASE} and {EFFECTS} hold a fit without {_unsaid(result)}, which they have no place for: "
            f"{plain.validation[1].every.overall:.1%} relative error on the judged samples, "
            f"{result.validation[1].every.overall:.1%} with it"
        )
        result = replace(result, warnings=(*result.warnings, left_out))
    progress("writes the report")
    with atomic_write(out / URDF) as aside:
        aside.write_text(urdf_text(plain), encoding="utf-8")
    write_case_beside(
        plain, path / "case.yaml" if path.is_dir() else path, out / CASE, URDF
    )
    write_corrected(case.name, effects(plain), out / EFFECTS)
    write_base(result, out / BASE)
    files = {
        "report": REPORT,
        "urdf": URDF,
        "case": CASE,
        "effects": EFFECTS,
        "base": BASE,
    }
    content = document(result, files)
    render(result, content, out / REPORT)
    write_document(content, out / DOCUMENT)
    paths = tuple(out / name for name in (REPORT, DOCUMENT, CASE, URDF, EFFECTS, BASE))
    return Identified(result, paths, left_out)


def _unsaid(result: Identification) -> str:
    parts = []
    if result.columns.coupled:
        motors = ", ".join(label[:-1] for label in result.columns.coupled)
        parts.append(f"rotor and friction of coupled motor {motors} as such")
    if result.choice.law.presliding is not None:
        parts.append("friction that keeps its direction at rest")
    return " and ".join(parts)


def summary(identified: Identified) -> Group:
    """What the terminal shows: errors per joint, what was fitted, found, asked, and what is doubtful."""
    result = identified.result
    fit, judged = result.validation
    found = [row for row in result.table if row.verdict == FOUND]
    title = f"RMS residual over RMS torque of {result.case.name} [%]"
    table = Table(title=title, title_justify="left", padding=(0, 0, 0, 1))
    table.add_column("", no_wrap=True)
    for number in range(1, result.case.arm.n_joints + 1):
        table.add_column(f"J{number}", justify="right")
    table.add_column("all", justify="right")
    for label, errors in (
        ("nominal, judged", judged.nominal),
        ("fitted", fit.every),
        ("judged", judged.every),
        ("judged, moving", judged.moving),
    ):
        table.add_row(
            label, *(_percent(x) for x in errors.relative), _percent(errors.overall)
        )
    lines = [
        f"fitted {_named(fit.recordings)}; judged {_named(judged.recordings)}",
        f"{result.base.count} base parameters of {len(result.base.names)}, condition number {result.condition:.3g}; "
        f"friction: {result.choice.law}; cut-off {result.settings.cutoff:.3g} Hz",
        *(f"asks: {question}" for question in result.questions),
        *(f"found: {row.entry.cause}" + _where(row.joints) for row in found),
        *(
            f"warning: {shortened(warning)}"
            for warning in result.warnings
            if not _said(warning, found)
        ),
    ]
    return Group(table, *(Text(line) for line in lines))


def shortened(warning: str, most: int = SHORT) -> str:
    """The first of a warning: whole clauses, as many as ``most`` characters hold, or words of the first clause."""
    parts = warning.split("; ")
    kept = parts[0]
    for part in parts[1:]:
        if len(kept) + 2 + len(part) > most:
            break
        kept = f"{kept}; {part}"
    return textwrap.shorten(kept, most, placeholder=" ...")


def _said(warning: str, found: Sequence[Row]) -> bool:
    """Whether a warning says no more than a row that is shown."""
    return any(warning.startswith(row.entry.cause) for row in found)


def _named(recordings: Sequence[str], most: int = 3) -> str:
    """Names of recordings, or how many there are."""
    return (
        ", ".join(recordings)
        if len(recordings) <= most
        else f"{len(recordings)} recordings, {recordings[0]} first"
    )


def _where(joints: tuple[int, ...]) -> str:
    return f", joint {', '.join(map(str, joints))}" if joints else ""


def _percent(value: float) -> str:
    return f"{100 * value:.1f}" if value == value else "–"
