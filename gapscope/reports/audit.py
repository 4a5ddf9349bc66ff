"""An audit as a page and on the terminal: findings worst first, and the table of the links."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Group
from rich.text import Text

from gapscope.arm.display import MISSING
from gapscope.arm.dynamics.description import SINGLE
from gapscope.diagnosis.document.wording import Document
from gapscope.reports.pages import write_html

# What page and terminal of an audit share: findings of a kind together, and sentences of its document.


MAX_PLACES = 6
"""Most places that are named of findings of a kind."""


def groups(content: Document) -> Sequence[Document]:
    """Of each severity and kind the worst finding, worst first; ``others``: where the others are, in words."""
    together: dict[tuple[str, str], list[Document]] = {}
    for finding in content["findings"]:
        together.setdefault((finding["severity"], finding["kind"]), []).append(finding)
    found = []
    # findings come worst first: so does each group
    for worst, *more in together.values():
        named = [place(one) for one in more[:MAX_PLACES]]
        rest = len(more) - len(named)
        others = "; ".join([*named, f"{rest} more"] if rest else named)
        found.append({**worst, "others": others})
    return found


def heading(content: Document) -> str:
    """How many findings of each severity, in one sentence."""
    counts = [f"{count} {name}" for name, count in content["counts"].items() if count]
    mass = content["total_mass"]
    # fixed joints do not move
    moving = sum(one["kind"] in SINGLE for one in content["joints"])
    size = f"{len(content['links'])} links, {moving} moving joints, {number(mass)} kg"
    return f"{size}: {', '.join(counts)}." if counts else f"{size}: nothing odd."


def place(finding: Document) -> str:
    """Link or joint with the line of the file."""
    line = f"line {finding['line']}" if finding["line"] else ""
    return ", ".join(part for part in (finding["place"], line) if part) or "whole file"


def number(value: float | None) -> str:
    """A number with three digits; a dash if there is none."""
    return MISSING if value is None else f"{value:.3g}"


# An audit as a page that opens without a network.


def write_page(content: Document, path: Path) -> None:
    """Write the findings, worst first, and the table of the links.

    Args:
        content: the document.
        path: the page.

    Raises:
        GapscopeError: the file cannot be written.
    """
    write_html(
        "audit/audit.html",
        path,
        content=content,
        heading=heading(content),
        groups=groups(content),
        place=place,
        number=number,
        # marked in the table of links
        odd={finding["place"] for finding in content["findings"]},
    )


# An audit on the terminal: one paragraph per kind of finding, worst first.


STYLES = {"impossible": "bold red", "implausible": "red", "missing": "yellow"}
"""Style of a severity."""
MAX_EXPLANATIONS = 4


def summary(content: Document) -> Group:
    """What is odd about a model, and what to do."""
    head = f"{content['robot']} ({content['file']}): {heading(content)}"
    parts = [Text(head, "bold")]
    for worst in groups(content):
        title = (
            f"\n{worst['severity']}: {worst['kind'].replace('_', ' ')}, {place(worst)}"
        )
        parts.append(Text(title, STYLES.get(worst["severity"], "")))
        for label, key in (
            ("", "found"),
            ("expected: ", "expected"),
            ("to do: ", "remedy"),
            ("also: ", "others"),
        ):
            if worst[key]:
                parts.append(Text(f"  {label}{worst[key]}"))
    # only with a recording of static poses
    if content["static"] is not None:
        parts += map(Text, _static(content["static"]))
    return Group(*parts)


def _static(static: Document) -> Iterator[str]:
    """Gravity torque against measured, joint by joint."""
    yield f"\ngravity torque in {static['poses']} poses, measured against the model's:"
    columns = (static[name] for name in ("joints", "correlation", "scale", "offset"))
    for joint, correlation, scale, offset in zip(*columns, strict=True):
        yield (
            f"  {joint}: correlation {number(correlation)}, scale {number(scale)}, "
            f"offset {number(offset)} N m"
        )
    for one in static["explanations"][:MAX_EXPLANATIONS]:
        yield f"  {one['name']} leaves {one['misfit']:.1%} of the spread"
