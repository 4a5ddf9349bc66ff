"""What scripts share: parts by name, tasks in processes of their own, and the diagnosis of a case, by any program.

An outside program answers in place of Gapscope, so that other ideas can be compared on the same cases:

    python PROGRAM CASE [--against REFERENCE]

prints a line for each effect that it names, ``effect joint anything [values] number``, joints from 1 and 0 for the arm
or, for ``link_inertia``, the link; and as its last line the processor time, ``1.2 s of processor time``. It may read
CSV recordings in the columns of the case format and a URDF of the arm alone, which is what ``write_plain`` writes.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.plain_urdf import moving_links, plain_urdf
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.json_file import plain, read_json, write_json
from gapscope.arm.io.write_case import write_case
from gapscope.blind_check.scoring import wilson
from gapscope.reports.blind_check import Table

T = TypeVar("T")
WAITING = 5.0
"""A task may take so many times its limit of processor time on a busy machine [1]."""
Ended = Callable[[T, str, float], None]
"""Called with a task, how its process ended (``ended``, ``timed out`` or ``died``) and its seconds."""


def command_line(description: str | None, **defaults: Any) -> argparse.ArgumentParser:
    """A command line with options by their defaults: ``seeds=3`` is ``--seeds 3``, ``table=False`` a flag."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in defaults.items():
        option = f"--{name.replace('_', '-')}"
        if default is False:
            parser.add_argument(option, action="store_true")
        else:
            parser.add_argument(
                option,
                type=type(default),
                default=default,
                help="default: %(default)s",
            )
    return parser


def run_part(description: str, parts: Mapping[str, Callable[[], object]]) -> None:
    """Run the part that the first word of the command line names; the other words are its own."""
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
        program: an outside program that answers in place of Gapscope.
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
            found, result["cpu_seconds"] = outside_answer(program, case, reference)
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


class Wanted(NamedTuple):
    """A diagnosis that is wanted.

    Attributes:
        case: folder of its case.
        reference: folder of the case that it is compared with, if any.
        file: of its result, with the name of the diagnosis.
    """

    case: Path
    reference: Path | None
    file: Path


def diagnose_missing(wanted: Sequence[Wanted], options: argparse.Namespace) -> None:
    """Diagnose all that has no result yet, as ``study_options`` has it."""
    limit = options.limit
    left = [one for one in wanted if not one.file.is_file()]
    progress = Progress("diagnose", len(left))

    def ended(one: Wanted, how: str, seconds: float) -> None:
        name = one.file.stem
        if how != "ended" or not one.file.is_file():
            write_no_result(name, how, seconds, limit, one.file)
        result = read_json(one.file, "")
        said = "; ".join([*names_of(result), verdict_of(result)])
        progress(name, f"{seconds:.0f} s  {said}")

    def diagnosed(one: Wanted) -> None:
        diagnose_to_file(*one, options.sketch)

    run_tasks(diagnosed, left, options.jobs, limit, ended)


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


def study_options(
    description: str | None, *more_steps: str, jobs: int = 1, **defaults: Any
) -> argparse.ArgumentParser:
    """The command line of a script that makes, runs and scores diagnoses (``study``), with options of its own."""
    parser = command_line(description, **defaults)
    steps = ("make", "run", "score", "all", *more_steps)
    parser.add_argument("--step", choices=steps, default="all")
    parser.add_argument("--results", default="results", help="folder in OUT")
    parser.add_argument("--jobs", type=int, default=jobs)
    parser.add_argument(
        "--limit", type=float, default=600.0, help="processor time per diagnosis [s]"
    )
    parser.add_argument(
        "--sketch", type=Path, help="an outside program in place of Gapscope"
    )
    return parser


def study(
    options: argparse.Namespace,
    make: Callable[[], None],
    plans: Callable[[], Sequence[T]],
    wanted: Callable[[T], Wanted],
    tables: Callable[[list[tuple[T, dict[str, Any]]]], Sequence[Table]],
) -> None:
    """Make cases, diagnose them, and publish tables of plans and results, as ``--step`` asks.

    Args:
        options: of ``study_options``, with ``out``.
        make: writes the cases.
        plans: what is planned, once the cases are made.
        wanted: the diagnosis of a plan.
        tables: of the plans that have a result.
    """
    if options.step in ("make", "all"):
        make()
    planned = [(plan, wanted(plan)) for plan in plans()]
    if options.step in ("run", "all"):
        made = [one for _, one in planned if (one.case / "case.yaml").is_file()]
        diagnose_missing(made, options)
    if options.step in ("score", "all"):
        done = [(plan, one.file) for plan, one in planned if one.file.is_file()]
        rows = [(plan, read_json(file, "remove it")) for plan, file in done]
        results = options.out / options.results
        publish(tables(rows), len(planned) - len(rows), len(planned), results)


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


# Outside programs

FINDING = re.compile(r"(\w+) (\d+) .*?(\[.*\]) ")
"""Effect, joint and values of a line."""
SIZES = {
    "actuator_delay": ("delay", "s"),
    "armature": ("inertia", "kg m^2"),
    "coulomb_friction": ("torque", "N m"),
    "load_friction": ("coefficient", "1"),
    "payload": ("mass", "kg"),
    "torque_offset": ("torque", "N m"),
    "torque_scale": ("scale", "1"),
    "viscous_friction": ("coefficient", "N m s/rad"),
}
"""First parameter and unit of effects of which the first value of a line is just that."""


def write_plain(case: Case, folder: Path) -> None:
    """Write a case on the joints' side; its URDF has the arm's joints alone, in the order of the columns."""
    write_case(case, folder, overwrite=True)
    links = moving_links(RigidBody(case.arm), movable=False)
    root = ET.fromstring(plain_urdf(links))
    for link, element in zip(links, root.findall("link")[1:], strict=True):
        inertia = element.find("inertial/inertia")
        assert inertia is not None
        for key, moment in zip(("ixx", "iyy", "izz"), link.moments, strict=True):
            inertia.set(key, repr(float(moment)))
    (folder / "robot.urdf").write_text(ET.tostring(root, encoding="unicode"))


def outside_answer(
    program: Path, case: Path, reference: Path | None
) -> tuple[dict[str, Any], float]:
    """What a program says of a case, as ``verdict`` and ``effects`` of a diagnosis, and its processor time [s].

    Raises:
        RuntimeError: it ended with an error, or said nothing of its time.
    """
    with tempfile.TemporaryDirectory() as name:
        folders = {"case": case}
        if reference is not None:
            folders["reference"] = reference
        command = [sys.executable, str(program), str(Path(name) / "case")]
        for role, folder in folders.items():
            write_plain(load_case(folder, any_unit=True), Path(name) / role)
        if reference is not None:
            command += ["--against", str(Path(name) / "reference")]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        ended = subprocess.run(command, capture_output=True, text=True, env=environment)
    lines = ended.stdout.splitlines()
    time = re.match(r"([\d.]+) s of processor time", lines[-1] if lines else "")
    if ended.returncode or time is None:
        raise RuntimeError(
            "".join(ended.stderr.strip().splitlines()[-1:]) or "no answer"
        )
    effects: dict[tuple[str, int], dict[str, Any]] = {}
    for line in lines[:-1]:
        found = FINDING.match(line)
        if found is None:
            raise RuntimeError(f"no finding: {line}")
        _add_line(effects, found[1], int(found[2]), json.loads(found[3]))
    verdict = "effects_found" if effects else "no_gap"
    return {"verdict": verdict, "effects": list(effects.values())}, float(time[1])


def _add_line(
    effects: dict[tuple[str, int], dict[str, Any]],
    name: str,
    joint: int,
    values: list[float],
) -> None:
    """Add a line to the effects: one entry for all joints of an effect, of several lines on one joint the first."""
    link = joint if name == "link_inertia" else 0
    entry = effects.setdefault(
        (name, link),
        {
            "effect": name,
            "joints": [],
            "parameters": {"link": {"unit": "", "value": link}} if link else {},
            "probability": None,
            "share": None,
            "alternatives": [],
        },
    )
    if joint and joint in entry["joints"]:
        return
    if joint and not link:
        entry["joints"].append(joint)
    if name in SIZES:
        key, unit = SIZES[name]
        size = entry["parameters"].setdefault(key, {"unit": unit, "value": []})
        size["value"].append(values[0])
    elif name == "base_tilt":
        for key, value in zip(("roll", "pitch"), values, strict=True):
            entry["parameters"][key] = {"unit": "rad", "value": value}
    elif name == "external_force":
        entry["parameters"]["force"] = {"unit": "N", "value": values}
