"""Tasks in processes of their own with a time limit, and the diagnosis of the case in a folder."""

from __future__ import annotations

import multiprocessing
import resource
import signal
import time
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from outside_program import answer

import gapscope
from gapscope.arm.case import load_case
from gapscope.arm.io.json_file import plain, write_json

T = TypeVar("T")
WAITING = 5.0
"""A task may take so many times its limit of processor time on a busy machine [1]."""
Ended = Callable[[T, str, float], None]
"""Called with a task, how its process ended (``ended``, ``timed out`` or ``died``) and its seconds."""


class Running(NamedTuple):
    """A task in its process."""

    task: Any
    process: BaseProcess
    started: float


def run_tasks(
    function: Callable[[T], None],
    tasks: Sequence[T],
    jobs: int,
    limit: float,
    ended: Ended[T],
) -> None:
    """Call a function of each task, ``jobs`` at a time, each in a process of its own.

    A process ends after ``limit`` seconds of the processor's time, so that a busy machine changes no result, and in any
    case after ``WAITING`` times as long.
    """
    context = multiprocessing.get_context("fork")

    def limited(task: T) -> None:
        seconds = int(np.ceil(limit))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
        function(task)

    waiting = list(tasks)
    running: list[Running] = []
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                task = waiting.pop(0)
                process = context.Process(target=limited, args=(task,))
                process.start()
                running.append(Running(task, process, time.monotonic()))
            wait([one.process.sentinel for one in running], timeout=0.5)
            running = [one for one in running if not _over(one, limit, ended)]
    finally:
        for one in running:
            one.process.kill()


def _over(one: Running, limit: float, ended: Ended[Any]) -> bool:
    """Whether a task is over; one beyond its time is ended."""
    seconds = time.monotonic() - one.started
    if one.process.exitcode is None:
        if seconds < WAITING * limit:
            return False
        one.process.kill()
        one.process.join()
        ended(one.task, "timed out", seconds)
        return True
    ways = {0: "ended", -signal.SIGXCPU: "timed out"}
    ended(one.task, ways.get(one.process.exitcode, "died"), seconds)
    return True


def diagnose_to_file(
    case: Path, reference: Path | None, file: Path, program: Path | None = None
) -> None:
    """Diagnose the case in a folder and write what came of it, an error too.

    Args:
        case: its folder.
        reference: folder of the case that it is compared with, if any.
        file: gets ``status``, ``document`` or ``error``, ``seconds``, ``cpu_seconds`` and ``peak_mb``.
        program: an outside program that answers in place of Gapscope, see ``outside_program.py``.
    """
    started = time.monotonic()
    result: dict[str, Any] = {"case": case.name, "status": "done"}
    cpu = time.process_time()
    try:
        if program is None:
            loaded = load_case(case, any_unit=True)
            against = None if reference is None else load_case(reference)
            # the document is made whole within the time that is counted
            found = gapscope.diagnose(loaded, against=against).document
            result["cpu_seconds"] = time.process_time() - cpu
        else:
            found, result["cpu_seconds"] = answer(program, case, reference)
        result["document"] = plain(found, null_if_not_finite=True)
    # whatever a diagnosis raises is a result of the benchmark: it is recorded and counted
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}:{last.lineno}"
        result["status"] = "failed"
        result["error"] = f"{type(error).__name__}: {error} ({place})"
        result["cpu_seconds"] = time.process_time() - cpu
    result["seconds"] = time.monotonic() - started
    who = resource.RUSAGE_SELF if program is None else resource.RUSAGE_CHILDREN
    result["peak_mb"] = resource.getrusage(who).ru_maxrss / 1024
    write_json(result, file)


def write_no_result(
    name: str, how: str, seconds: float, limit: float, file: Path
) -> None:
    """Record a diagnosis that did not end by itself."""
    result = {"case": name, "status": how, "error": how, "seconds": seconds}
    write_json({**result, "cpu_seconds": min(seconds, limit)}, file)
