"""How long a user waits before anything is done: processor time of a fresh process, against Python alone.

*First line* is ``gapscope diagnose`` until it shows its first progress; the case need not exist for that. Bytecode is
cached, as of an installed package: the first round fills the cache and is not counted.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from functools import partial

from .child import ONE_THREAD, ROOT
from .measure import Point, Row, Settings, compared, in_turns

BARE = "python -c pass"
COMMANDS = {
    BARE: ("-c", "pass"),
    "import gapscope": ("-c", "import gapscope"),
    "gapscope --help": ("-m", "gapscope", "--help"),
}
FIRST_LINE = "gapscope diagnose, first line"
DIAGNOSE = ("-m", "gapscope", "diagnose", "case", "--out", "out")


def points(settings: Settings) -> list[Point]:
    """All in turns."""
    return [Point("start-up", partial(_measured, settings))]


def _measured(settings: Settings) -> list[Row]:
    settings.out.mkdir(parents=True, exist_ok=True)
    environment = {
        **os.environ,
        **ONE_THREAD,
        "PYTHONPATH": str(ROOT),
        "PYTHONPYCACHEPREFIX": str(settings.out / "bytecode"),
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)

    def start(words: tuple[str, ...], until_line: bool = False) -> None:
        process = subprocess.Popen(
            [sys.executable, *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=environment,
            cwd=settings.out,
        )
        assert process.stderr is not None
        if until_line:
            process.stderr.readline()
            process.kill()
        process.communicate()

    loops = {name: partial(start, words) for name, words in COMMANDS.items()}
    loops[FIRST_LINE] = partial(start, DIAGNOSE, until_line=True)
    in_turns(loops, 1)
    times = in_turns(loops, settings.rounds, _of_children)
    return compared(times, BARE)


def _of_children() -> float:
    """Processor time of all processes that were started and have ended [s]."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime
