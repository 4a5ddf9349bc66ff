"""What scripts share: parts by name, tasks in processes of their own, diagnoses, results that are kept, tables."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

import gapscope
from gapscope.arm.case import load_case
from gapscope.arm.errors import ModelWarning
from gapscope.arm.io.json_file import plain, read_json, write_json
from gapscope.blind_check.scoring import named, same, wilson
from gapscope.reports.pages import PageSection as Table

T = TypeVar("T")
CASES = Path(__file__).resolve().parent / "cases"
"""Cases of real arms."""
DATA = Path(os.environ.get("GAPSCOPE_DATA", CASES.parents[1] / "../shared/data"))
"""Their recordings."""
WAITING = 5.0
"""A task may take so many times its limit of processor time on a busy machine [1]."""
Ended = Callable[[T, str, float], None]
"""Called with a task, how its process ended (``ended``, ``timed out`` or ``died``) and its seconds."""


def command_line(
    description: str | None, *paths: str, **options: Any
) -> argparse.ArgumentParser:
    """A command line with paths and options by their defaults: ``seeds=3`` is ``--seeds 3``, ``table=False`` a flag.

    A type stands for an option without a default: ``steps=int``. A pair holds either with words of help, a dictionary
    what argparse is told instead.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for path in paths:
        parser.add_argument(path, type=Path)
    for name, given in options.items():
        default, words = given if isinstance(given, tuple) else (given, "")
        how = {"type": type(default), "default": default}
        if isinstance(default, dict):
            how = default
        elif default is False:
            how = {"action": "store_true"}
        elif isinstance(default, type):
            how = {"type": default}
        words += " (default: %(default)s)" * ("default" in how)
        parser.add_argument(f"--{name.replace('_', '-')}", **{"help": words} | how)
    return parser


def run_part(
    description: str,
    *functions: Callable[[], object],
    **named: Callable[[], object],
) -> None:
    """Run the part that the first word of the command line names, a function or a name for one.

    The other words are its own.
    """
    parts = {function.__name__: function for function in functions} | named
    parser = command_line(description)
    parser.add_argument(
        "part", choices=parts, help="one of them; PART --help says what it takes"
    )
    part = parser.parse_args(sys.argv[1:2]).part
    sys.argv = [f"{sys.argv[0]} {part}", *sys.argv[2:]]
    parts[part]()


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
    running = []
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


class Progress:
    """Counts tasks as they end."""

    def __init__(self, what: str, total: int) -> None:
        self.what, self.total, self.done = what, total, 0
        self.started = time.monotonic()

    def __call__(self, name: str, text: str) -> None:
        """Print that a task ended."""
        self.done += 1
        passed = (time.monotonic() - self.started) / 60
        count = f"{self.done}/{self.total}"
        print(f"{self.what} {count} {passed:5.1f} min  {name}  {text}", flush=True)


def run_missing(
    make: Callable[[T], Any],
    tasks: Mapping[Path, T],
    jobs: int,
    limit: float,
    failed: Callable[[T, str, float], Any] | None = None,
    say: Callable[[Any], str] = lambda result: "",
) -> list[Any]:
    """JSON data of tasks from their files; those that have none are made, each in a process of its own.

    Args:
        make: what a task comes to.
        tasks: by the file of each.
        jobs, limit: see ``run_tasks``.
        failed: what stands for a task that did not end, from how it ended and its seconds; without it no file is left.
        say: what to print of a result.
    """
    left = [file for file in tasks if not file.is_file()]
    progress = Progress("made", len(left))

    def ended(file: Path, how: str, seconds: float) -> None:
        if failed is not None and (how != "ended" or not file.is_file()):
            write_json(failed(tasks[file], how, seconds), file)
        said = say(read_json(file, "remove it")) if file.is_file() else ""
        progress(file.stem, f"{how}, {seconds:.0f} s  {said}")

    def run(file: Path) -> None:
        made = plain(make(tasks[file]), null_if_not_finite=True)
        write_json(made, file)

    run_tasks(run, left, jobs, limit, ended)
    return [read_json(file, "remove it") for file in tasks if file.is_file()]


def diagnosis(folder: Path, reference: Path | None) -> Any:
    """The document of the diagnosis of a case, compared with another one if that is given."""
    case = load_case(folder, any_unit=True)
    against = None if reference is None else load_case(reference)
    return gapscope.diagnose(case, against=against).document


class Wanted(NamedTuple):
    """A diagnosis that is wanted.

    Attributes:
        case: folder of its case.
        reference: folder of the case that it is compared with, if any.
        file: of its result, with the name of the diagnosis.
        asked: makes the document.
    """

    case: Path
    reference: Path | None
    file: Path
    asked: Callable[[Path, Path | None], Any] = diagnosis


def diagnosed(wanted: Wanted) -> dict[str, Any]:
    """Diagnose a case: ``status``, ``document`` or ``error``, ``seconds``, ``cpu_seconds`` and ``peak_mb``."""
    started, cpu = time.monotonic(), time.process_time()
    result = {"case": wanted.case.name, "status": "done"}
    try:
        # the document is made whole within the time that is counted
        found = wanted.asked(wanted.case, wanted.reference)
        result["document"] = plain(found, null_if_not_finite=True)
    # whatever a diagnosis raises is a result of the benchmark: it is recorded and counted
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}:{last.lineno}"
        result["status"] = "failed"
        result["error"] = f"{type(error).__name__}: {error} ({place})"
    result["cpu_seconds"] = time.process_time() - cpu
    result["seconds"] = time.monotonic() - started
    result["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return result


def diagnose_missing(wanted: Sequence[Wanted], options: argparse.Namespace) -> None:
    """Diagnose all that has no result yet, as ``study_options`` has it."""

    def failed(one: Wanted, how: str, seconds: float) -> dict[str, Any]:
        result = {"case": one.file.stem, "status": how, "error": how}
        cpu = min(seconds, options.limit)
        return {**result, "seconds": seconds, "cpu_seconds": cpu}

    def said(result: dict[str, Any]) -> str:
        return "; ".join([*names_of(result), verdict_of(result)])

    tasks = {one.file: one for one in wanted}
    run_missing(diagnosed, tasks, options.jobs, options.limit, failed, said)


def names_of(result: dict[str, Any]) -> list[str]:
    """Effects that a result names, with their joints."""
    effects = (result.get("document") or {}).get("effects", [])
    return [
        " ".join([e["effect"], ",".join(map(str, e["joints"]))]).strip()
        for e in effects
    ]


def verdict_of(result: dict[str, Any]) -> str:
    """Verdict, or the error."""
    document = result.get("document") or {}
    return str(document.get("verdict", f"failed: {result.get('error', '')[:80]}"))


def stated(truth: dict[str, Any], document: dict[str, Any]) -> list[tuple[float, bool]]:
    """Probability of each finding of a diagnosis, named or possible, and whether it is in the label."""
    true = [named(entry) for entry in truth["effects"]]
    n, motions = len(truth["gap"]), truth.get("motions", [])[:-1]
    entries = [*document.get("effects", []), *document.get("possible", [])]
    return [
        (
            float(e["probability"] or 0.0),
            any(same(t, named(e), n, motions) for t in true),
        )
        for e in entries
    ]


def study_options(
    description: str | None, *more_steps: str, jobs: int = 1, **defaults: Any
) -> argparse.ArgumentParser:
    """The command line of a script that makes, runs and scores diagnoses (``study``), with options of its own."""
    steps = ("make", "run", "score", "all", *more_steps)
    return command_line(
        description,
        **defaults,
        step={"choices": steps, "default": "all"},
        results=("results", "folder in OUT"),
        jobs=jobs,
        limit=(600.0, "processor time per diagnosis [s]"),
    )


def study(
    options: argparse.Namespace,
    make: Callable[[], None],
    plans: Callable[[], Sequence[T]],
    sides: Callable[[T], tuple[Path, Path | None]],
    tables: Callable[[list[tuple[T, dict[str, Any]]]], Sequence[Table]],
    asked: Callable[[T], Callable[[Path, Path | None], Any]] = lambda plan: diagnosis,
) -> None:
    """Make cases, diagnose them, and publish tables of plans and results, as ``--step`` asks; on one thread a process.

    Args:
        options: of ``study_options``, with ``out``.
        make: writes the cases.
        plans: what is planned, once the cases are made, each with a ``name``.
        sides: folder of the case of a plan, and of the reference that it is compared with, if any.
        tables: of the plans that have a result.
        asked: makes the document of a plan, from its sides.
    """
    warnings.simplefilter("ignore", ModelWarning)
    threadpool_limits(1)
    results = options.out / options.results
    if options.step in ("make", "all"):
        make()
    planned = [
        (plan, Wanted(*sides(plan), results / f"{plan.name}.json", asked(plan)))
        for plan in plans()
    ]
    if options.step in ("run", "all"):
        made = [one for _, one in planned if (one.case / "case.yaml").is_file()]
        diagnose_missing(made, options)
    if options.step in ("score", "all"):
        done = [(plan, one.file) for plan, one in planned if one.file.is_file()]
        rows = [(plan, read_json(file, "remove it")) for plan, file in done]
        publish(tables(rows), len(planned) - len(rows), len(planned), results)


def grouped(
    title: str,
    head: Sequence[str],
    items: Sequence[T],
    key: Callable[[T], str],
    cells: Callable[[Sequence[T]], Sequence[str]],
    whole: Sequence[T] = (),
) -> Table:
    """A row for each value of a key, how many items have it and what is said of these; ``all`` of the whole at last."""
    groups = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    named = [*sorted(groups.items()), *[("all", whole)] * bool(whole)]
    rows = [(name, str(len(own)), *cells(own)) for name, own in named]
    return Table(title, ("", *head), rows)


def kept(file: Path, make: Callable[..., Any], *arguments: Any) -> Any:
    """JSON data from a file, or made, written whole and its name printed."""
    if not file.is_file():
        write_json(make(*arguments), file)
        print(f"  {file.stem}", flush=True)
    return read_json(file, "remove it")


def markdown(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def share_text(hits: int, count: int) -> str:
    """``19 of 21 (71 to 97 %)``, the interval of 95 %."""
    low, high = wilson(hits, count)
    return f"{hits} of {count} ({100 * low:.0f} to {100 * high:.0f} %)"


def publish(tables: Sequence[Table], missing: int, total: int, results: Path) -> None:
    """Print tables, and write them beside the folder of the results."""
    text = "\n".join(table.markdown() for table in tables)
    if missing:
        text += f"\n{missing} of {total} planned cases have no result.\n"
    print(text)
    results.with_suffix(".md").write_text(text, encoding="utf-8")
