"""An identification on the terminal: errors per joint, what was fitted and found, questions and warnings."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gapscope.ident.checks.table_row import FOUND, Row
from gapscope.ident.checks.warnings import WORSE
from gapscope.ident.identification import Identification
from gapscope.ident.output.filter_json import filter_document
from gapscope.reports.identification.filter_section import filter_sentence

MAX_WARNING = 160
"""Longest warning [characters]; the report has all of it."""
MAX_NAMES = 3
"""Most recordings that are named one by one."""


def summary(result: Identification) -> Group:
    """The table of errors per joint, and lines on what was fitted, found, asked, and what is doubtful.

    Before them, if the nominal arm predicts what was held out better, that it does.
    """
    found = [row for row in result.table if row.verdict == FOUND]
    warnings = [text for text in result.warnings if not _repeats(text, found)]
    lines = [
        *_facts(result),
        *(f"asks: {question}" for question in result.questions),
        *(f"found: {row.entry.cause}{_on_joints(row.joints)}" for row in found),
        *(f"warning: {shortened(warning)}" for warning in warnings),
    ]
    first = [f"warning: {text}" for text in warnings if text.startswith(WORSE)]
    rest = [line for line in lines if WORSE not in line]
    return Group(*map(Text, first), _errors(result), *map(Text, rest))


def _errors(result: Identification) -> Table:
    """Relative error of the torque per joint, before and after, on fitted and held-out samples."""
    fit, held_out = result.validation
    title = f"RMS residual over RMS torque of {result.case.name} [%]"
    table = Table(title=title, title_justify="left", padding=(0, 0, 0, 1))
    table.add_column("", no_wrap=True)
    for number in range(1, result.case.arm.n_joints + 1):
        table.add_column(f"J{number}", justify="right")
    table.add_column("all", justify="right")
    for label, errors in (
        ("nominal, held out", held_out.nominal),
        ("fitted", fit.every),
        ("held out", held_out.every),
        ("held out, moving", held_out.moving),
    ):
        values = (_percent(value) for value in errors.relative)
        table.add_row(label, *values, _percent(errors.overall))
    return table


def _facts(result: Identification) -> list[str]:
    """Which recordings were fitted and held out, and the size and condition of the problem."""
    fit, held_out = result.validation
    base, cutoff = result.base, result.settings.cutoff
    moved = () if result.moved is None else (_moved(result, result.moved),)
    document = {"filter": filter_document(result.filtered, base.expressions(1e-2))}
    return [
        f"fitted {_named(fit.recordings)}; held out {_named(held_out.recordings)}",
        f"{base.count} base parameters of {len(base.names)}, condition number {result.condition:.3g}; "
        f"friction: {result.choice.law}; cut-off {cutoff:.3g} Hz",
        *moved,
        f"Kalman filter: {filter_sentence(document)}",
    ]


def _moved(result: Identification, moved: np.ndarray) -> str:
    """Which base parameters a partial update moved."""
    names = [n for n, m in zip(result.estimate.names, moved, strict=True) if m]
    which = f": {', '.join(names)}" if names else ""
    return shortened(
        f"partial update: {len(names)} of {len(moved)} base parameters moved, the others stay nominal{which}"
    )


def shortened(warning: str, limit: int = MAX_WARNING) -> str:
    """The first clauses of a warning, as many as ``limit`` characters hold, or words of the first clause."""
    first, *others = warning.split("; ")
    kept = first
    for clause in others:
        if len(kept) + 2 + len(clause) > limit:
            break
        kept = f"{kept}; {clause}"
    return textwrap.shorten(kept, limit, placeholder=" ...")


def _repeats(warning: str, found: Sequence[Row]) -> bool:
    """Whether a warning says no more than a row that is shown."""
    return any(warning.startswith(row.entry.cause) for row in found)


def _named(recordings: Sequence[str]) -> str:
    """Names of recordings, or how many there are."""
    if len(recordings) <= MAX_NAMES:
        return ", ".join(recordings)
    return f"{len(recordings)} recordings, {recordings[0]} first"


def _on_joints(joints: tuple[int, ...]) -> str:
    return f", joint {', '.join(map(str, joints))}" if joints else ""


def _percent(value: float) -> str:
    is_nan = value != value
    return "–" if is_nan else f"{100 * value:.1f}"
