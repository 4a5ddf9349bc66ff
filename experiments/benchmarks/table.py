"""Rows as a Markdown table, and put into a page between its markers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from experiments.benchmarks.row import Row
from gapscope.arm.io.atomic_write import atomic_write

HEAD = "| what | figure | speed, relative | more |\n|---|---|---|---|"


def table(rows: Iterable[Row]) -> str:
    """A line for each row: median and spread, ratio and its spread, and what else it says."""
    return "\n".join([HEAD, *map(_line, rows)])


def _line(row: Row) -> str:
    ratio = _with_spread(row.ratio, row.ratio_spread)
    if ratio and row.yardstick and not row.name.endswith(row.yardstick):
        ratio += f" to {row.yardstick}"
    details = [_detail(key, value) for key, value in row.details.items()]
    more = "; ".join([*filter(None, [row.note]), *details])
    figure = _with_spread(row.figure, row.spread)
    return f"| {row.name} | {figure} {row.unit} | {ratio} | {more} |"


def _with_spread(value: float | None, spread: float | None) -> str:
    if value is None:
        return ""
    return _number(value) + ("" if spread is None else f" ± {_number(spread, 1)}")


def _number(value: float | str, digits: int = 3) -> str:
    """Three significant digits, without an exponent as far as that is readable."""
    if isinstance(value, str):
        return value
    if value and not 1e-4 <= abs(value) < 1e7:
        return f"{value:.{digits}g}"
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.10f}".rstrip("0").rstrip(".")


def _detail(key: str, value: float | str) -> str:
    """A figure with the unit of its key behind it."""
    name, _, unit = key.partition(" [")
    return f"{name} {_number(value)} {unit.removesuffix(']')}".strip()


def put_into(page: Path, part: str, title: str, text: str) -> None:
    """Replace what stands between the markers of a part in a page; without them, add a section at its end."""
    begin, end = f"<!-- {part}: written by a script -->", f"<!-- end of {part} -->"
    whole = page.read_text(encoding="utf-8")
    before, _, rest = whole.partition(begin)
    _, closed, after = rest.partition(end)
    if not closed:
        before, after = f"{whole.rstrip()}\n\n## {title}\n\n", "\n"
    with atomic_write(page) as aside:
        aside.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", encoding="utf-8")
