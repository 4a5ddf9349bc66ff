"""What the benchmarks are made of: points that are measured and stored one by one, their rows and tables."""

from __future__ import annotations

import os
import platform
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import read_json, write_json

from .cases import Measured

Clock = Callable[[], float]
MEMORY = "peak memory [MB]"
"""Key of a row's details."""


@dataclass(frozen=True)
class Row:
    """One figure, and what it is relative to a yardstick that was measured in the same run.

    Attributes:
        name: what was measured.
        figure: the median over the rounds, or the only value.
        unit: of the figure; ``s`` are seconds of the processor unless the note says otherwise.
        spread: half the distance between the quartiles over the rounds, in the same unit; ``None``: measured once.
        ratio: speed relative to the yardstick, so that 2 is twice as fast; the median of the rounds' ratios.
        ratio_spread: half the distance between the quartiles of the ratio.
        yardstick: name of what the ratio is to.
        note: what else is to know in a few words.
        details: other figures by name, with their unit.
    """

    name: str
    figure: float
    unit: str
    spread: float | None = None
    ratio: float | None = None
    ratio_spread: float | None = None
    yardstick: str = ""
    note: str = ""
    details: Mapping[str, float | str] = field(default_factory=dict)


def half_quartiles(values: Sequence[float]) -> float | None:
    """Half the distance between the quartiles; ``None`` of a single value."""
    if len(values) < 2:
        return None
    low, high = np.quantile(values, (0.25, 0.75))
    return float(high - low) / 2


def in_turns(
    loops: Mapping[str, Callable[[], object]],
    rounds: int,
    clock: Clock = time.process_time,
    prepare: Mapping[str, Callable[[], object]] | None = None,
) -> dict[str, list[float]]:
    """Time of each loop in each round [s], without what prepares it; turns, so that a busy machine slows all."""
    times = {name: [] for name in loops}
    for _ in range(rounds):
        for name, loop in loops.items():
            if prepare is not None:
                prepare[name]()
            start = clock()
            loop()
            times[name].append(clock() - start)
    return times


def compared(
    times: Mapping[str, Sequence[float]],
    yardstick: str,
    unit: str = "s",
    per: float = 1.0,
    what: str = "",
    notes: Mapping[str, str] | None = None,
) -> list[Row]:
    """A row for each loop, relative to one of them.

    Args:
        times: time of each loop in each round [s].
        yardstick: the loop that the ratios are to; it has ratio 1 itself.
        unit: of the figures, which are the times over ``per``.
        per: what a time is divided by, for instance the number of steps.
        what: what all of them do; the rows' names begin with it.
        notes: a note for some of them.
    """
    rows = []
    base = np.array(times[yardstick])
    for name, values in times.items():
        ratios = base / np.array(values)
        row = Row(
            f"{what}, {name}" if what else name,
            float(np.median(values)) / per,
            unit,
            spread=_scaled(half_quartiles(values), per),
            ratio=float(np.median(ratios)),
            ratio_spread=half_quartiles(ratios.tolist()),
            yardstick=yardstick,
            note=(notes or {}).get(name, ""),
        )
        rows.append(row)
    return rows


def _scaled(value: float | None, per: float) -> float | None:
    return None if value is None else value / per


STOPPED = "stopped after [s]"
"""Detail of a row whose measurement was stopped, so that its figure is a lower bound [s]."""
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


class Settings(NamedTuple):
    """What the command line asks for.

    Attributes:
        out: folder for what a part keeps: cases, environments of other tools.
        rounds: how many times loops that take turns are run.
        quick: whether to measure small sizes only, to see that all works.
        against: another checkout of the project, whose code is measured in turns with this one's.
        cases: cases of the user's own that are diagnosed as well.
    """

    out: Path
    rounds: int = 5
    quick: bool = False
    against: Path | None = None
    cases: tuple[Measured, ...] = ()


class Point(NamedTuple):
    """One measurement, which is stored as a whole and not repeated.

    Attributes:
        name: unique in its part; ``--only`` picks points by parts of their names.
        measure: runs it; a row for each figure.
    """

    name: str
    measure: Callable[[], Iterable[Row]]


LIBRARIES = ("numpy", "scipy", "pin", "mujoco", "pybullet")


def machine() -> dict[str, str]:
    """Cores, kind of processor, Python, and the versions that matter."""
    found = {
        "cores": str(os.cpu_count()),
        "processor": _processor(),
        "python": platform.python_version(),
    }
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _processor() -> str:
    """The processor's name as Linux gives it, else its architecture."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.machine()
    name = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return name[1].strip() if name else platform.machine()


def point_file(folder: Path, part: str, name: str) -> Path:
    """Where a point is stored."""
    return folder / "points" / part / (re.sub(r"[^\w.-]+", "_", name) + ".json")


def stored(path: Path) -> list[Row] | None:
    """The rows of a point; ``None`` if it has not been measured."""
    if not path.is_file():
        return None
    content = read_json(path, "remove the file: the point is then measured again")
    return [Row(**row) for row in content["rows"]]


def measured(path: Path, part: str, point: Point) -> list[Row]:
    """Measure a point, and store its rows once it is done."""
    rows = list(point.measure())
    content = {"part": part, "point": point.name, "machine": machine()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json({**content, "rows": [asdict(row) for row in rows]}, path)
    return rows
