"""What a part of the benchmarks is made of: settings that all parts share, and points that are measured one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from experiments.benchmarks.measured_cases import Measured
from experiments.benchmarks.row import Row


@dataclass(frozen=True)
class Settings:
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


@dataclass(frozen=True)
class Point:
    """One measurement, which is stored as a whole and not repeated.

    Attributes:
        name: unique in its part; ``--only`` picks points by parts of their names.
        measure: runs it; a row for each figure.
    """

    name: str
    measure: Callable[[], Iterable[Row]]
