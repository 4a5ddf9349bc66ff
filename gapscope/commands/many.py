"""The commands for many diagnoses: ``rehearse``, ``fleet``, ``serve`` and ``watch``."""

from __future__ import annotations

import signal
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from typer import Argument, Option

from gapscope.commands.options import (
    AsJson,
    CaseOption,
    CasePath,
    File,
    Folder,
    Names,
    NotNegative,
    Positive,
    Results,
    RobotName,
    split_names,
)
from gapscope.terminal import Progress, note, say, show, wrote

PACE = 1.0
"""Least time between two lines of progress [s]."""


def rehearse(
    case: CasePath,
    *,
    out: Folder | None = None,
    effect: Names = None,
    joint: Annotated[list[int] | None, Option(metavar="N")] = None,
    sizes: str = "half,nine_of_ten",
    seed: NotNegative = 0,
    jobs: Positive = 1,
    json_: AsJson = False,
) -> None:
    """Put effects of known size into a case's own recordings, and say which of them are found.

    Args:
        out: folder for rehearsal.html, rehearsal.json and the diagnoses, from which the same command goes on
        effect: put in this one; may be given several times. Default: all that there is a law for
        joint: put effects in here, from 1; may be given several times. Default: one for each effect, drawn
        sizes: half, nine_of_ten (sizes named in so many cases) and severity (usual on real arms), with commas
        seed: of joints, signs and forms
        jobs: diagnoses at a time
    """
    from gapscope.many.rehearse import rehearse as rehearse_case

    with Progress(case) as progress:
        result = rehearse_case(
            case,
            out,
            effects=effect or (),
            joints=joint or (),
            sizes=split_names(sizes),
            seed=seed,
            jobs=jobs,
            progress=progress,
        )
        written = () if out is None else result.save(out)
    show(result, *written, as_json=json_)


def fleet(
    cases: Annotated[list[str], Argument(metavar="CASES...")],
    *,
    out: Results,
    jobs: Positive | None = None,
    backend: str = "local",
    again: bool = False,
    keep: str = "json",
    units_by: str = "case",
    largest: Annotated[float, Option(metavar="GB", min=0.0)] = 2.0,
    scratch: Folder | None = None,
    tries: Positive = 3,
) -> None:
    """Diagnose many cases, compare their units, and find what changed.

    Args:
        cases: folders or archives of cases, lists of them (.txt, .csv), or URLs: s3://..., gs://..., zip://...
        jobs: cases at a time; default: 1, on a cluster all its cores
        backend: local, or ray (needs ray installed)
        again: diagnose also what is done
        keep: files kept of each diagnosis: nothing, json or report
        units_by: what names the unit of a case: case or folder
        largest: size that a case may have [GB]
        scratch: folder for cases while they are diagnosed
        tries: times that a case is begun if its workers die
    """
    from scipy.constants import giga

    from gapscope.many.fleet import DOCUMENT, PAGE, fleet

    with Progress("fleet") as progress:
        overview = fleet(
            cases,
            out,
            progress=_paced(progress),
            jobs=jobs,
            backend=backend,
            again=again,
            keep=keep,
            units_by=units_by,
            largest=int(largest * giga),
            scratch=scratch,
            tries=tries,
        )
    say(str(overview.counts))
    show(overview)
    wrote(out / PAGE, out / DOCUMENT)
    # a script that calls this has to learn that some failed
    raise typer.Exit(1 if overview.counts.failed else 0)


def _paced(progress: Progress) -> Callable[[str], None]:
    """Passes a message on unless one was passed on just now: there may be thousands a minute."""
    # the first message always passes
    last = -PACE

    def show(message: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PACE:
            last = now
            progress(message)

    return show


def serve(
    folder: Annotated[Path, Argument(metavar="DIR")],
    *,
    port: Annotated[int, Option(min=0, max=65535)] = 0,
    units_by: str = "case",
    open_: bool = False,
) -> None:
    """Show many diagnoses as a table, and the effects of each unit over time; read-only, on this machine alone.

    Args:
        folder: folder with diagnoses, at any depth
        port: on 127.0.0.1; 0: any that is free
        units_by: what names a unit, without dates: case, or the folder above a diagnosis
        open_: open the browser
    """
    from gapscope.many.archive import Archive, ArchiveServer

    archive = Archive(folder, units_by)
    with ArchiveServer(archive, port) as server:
        with Progress(str(folder)) as progress:
            count = len(archive.rows(progress))
        noun = "diagnosis" if count == 1 else "diagnoses"
        say(f"{count} {noun} at {server.address} (Ctrl-C ends)")
        if open_:
            webbrowser.open(server.address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            say("stopped")


def watch(
    source: Path,
    *,
    case: CaseOption = None,
    robot: RobotName = None,
    corrected: File | None = None,
    out: Folder | None = None,
    learn: float = 60.0,
    false_alarms: float = 0.1,
    rest: float = 5.0,
    once: bool = False,
    until_idle: Annotated[float | None, Option(metavar="N")] = None,
) -> None:
    """Follow a recording while it grows, and name what changes: a load, friction, an offset, an encoder.

    Args:
        source: CSV that grows, or a folder in which recordings or files of ROS bags appear
        case: case of the arm: says how its logs are read
        robot: in place of a case: kuka_iiwa, ..., or a URDF; logs are in the columns of the case format
        corrected: corrected.yaml of a diagnosis, or identified.yaml; default: the nominal arm
        out: folder for events.jsonl and the state that a later run goes on from
        learn: motion from which normal behaviour is learnt [s]; 0: the recordings of the case show it
        false_alarms: wanted per 24 h of motion at most, for a perfect model
        rest: a file is complete after this time unwritten [s]
        once: use what is there, and end; for cron
        until_idle: end when nothing new came for this long [s]
    """
    from gapscope.arm.case import load_case
    from gapscope.arm.errors import GapscopeError, InputError
    from gapscope.arm.io.locked_section import locked
    from gapscope.arm.robots import load_nominal_arm
    from gapscope.interface.models import corrected_arm
    from gapscope.watching.detector import WatchSettings
    from gapscope.watching.watch import Watch

    if (case is None) == (robot is None):
        raise InputError(
            "expected one of --case and --robot",
            "give the case of the arm, or the robot if its logs are in the columns of the case format",
        )
    settings = WatchSettings(
        source=source,
        out=out,
        learning=learn,
        false_alarms=false_alarms,
        rest=rest,
        # once: nothing new is waited for
        until_idle=0.0 if once else until_idle,
    )
    # if nothing is learnt, the recordings of the case say what is normal
    loaded = load_case(case, read_recordings=not learn) if case else None
    arm = loaded.arm if loaded else load_nominal_arm(str(robot))
    with locked(out):
        watched = Watch(corrected_arm(arm, corrected), settings, loaded)
        model = (
            f"{arm.name} as {corrected} corrects it"
            if corrected
            else f"{arm.name}, nominal"
        )
        begun = (
            "goes on where it ended"
            if watched.resumed
            else f"learns from {learn:g} s of motion"
            if learn
            else f"what the recordings of {case} show is normal"
        )
        note(f"watching {source} with {model}: {begun}; Ctrl-C ends")
        with _stop_on_signals() as asked:
            for event in watched.run(lambda: bool(asked)):
                say(f"{event.event}: {event.sentence}")
    share = watched.detector.learnt
    if share < 1:
        note(f"ended while learning, at {share:.0%} of {learn:g} s of motion")
    note(
        f"{watched.alarms} alarms, {watched.misfits} misfits, {len(watched.read)} recordings read"
    )
    if out is not None:
        say(f"wrote {out}")
    # asked to end before the first file it did what it was told
    if not (watched.read or watched.resumed or asked):
        raise GapscopeError(
            f"{source}: no recording was read",
            "check the path and the endings of the files; one that is still written to is read by the next run",
        )


@contextmanager
def _stop_on_signals() -> Iterator[list[int]]:
    """A list that is no longer empty once the process was asked to end; asked again, it ends at once."""
    asked: list[int] = []

    # asked a second time: the recording in work is not waited for
    def ask(number: int, _: FrameType | None) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)

    before = {
        number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
