"""Runs one reader on many mutated inputs in one process, with limits of memory and time and a watch on what it does."""

from __future__ import annotations

import filecmp
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from fuzz_mutations import OUTSIDE
from fuzz_targets import Target

from gapscope.arm.errors import GapscopeError, InputError

_TIMERS = (
    (signal.ITIMER_PROF, signal.SIGPROF, 10.0),
    (signal.ITIMER_REAL, signal.SIGALRM, 60.0),
)
"""An input of some kB that is not read after this processor time, or this time, hangs its reader [s]."""
MEMORY = 1_500_000_000
"""Memory beyond that of the process before, which a reader may not ask for on such an input [bytes]."""
ODD_PLACES = 0.01
"""Share of the inputs that are no regular file [1]."""


class HangError(BaseException):
    """Not caught by what catches exceptions."""


@dataclass
class Outcome:
    """What became of the inputs.

    Attributes:
        read, refused: accepted by the reader; refused with a reason that names the file.
        faults: all others, with the number of the input, what happened, and where.
    """

    read: int = 0
    refused: int = 0
    faults: list[dict[str, Any]] = field(default_factory=list)


class Watch:
    """Notes what code that reads an input does beyond reading it: an audit hook of Python."""

    _WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
    _CHANGES = ("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.symlink")
    _FORBIDDEN = (
        *("os.system", "os.exec", "os.posix_spawn", "os.fork", "subprocess.Popen"),
        *("socket.connect", "socket.getaddrinfo", "pickle.find_class", "os.chmod"),
        *("os.link", "os.truncate", "os.chown", "urllib.Request", "ctypes.dlopen"),
    )

    def __init__(self, folder: Path) -> None:
        self.noted: list[str] = []
        self._folder, self._secret = str(folder), str(folder.parent / OUTSIDE)

    def note(self, event: str, arguments: tuple[Any, ...]) -> None:
        """An event of Python's audit."""
        if event == "open":
            self._opened(*arguments)
        elif event in self._FORBIDDEN or (
            event in self._CHANGES and not self._inside(arguments)
        ):
            self.noted.append(f"{event} {arguments!r}"[:200])

    def _opened(self, path: Any, mode: Any, flags: int) -> None:
        if not isinstance(path, (str, bytes)):
            return
        name = os.path.realpath(os.fsdecode(path)) if "\0" not in str(path) else ""
        if name == self._secret:
            self.noted.append("opens a file that an input names, outside its folder")
        writes = flags & self._WRITING or str(mode or "r")[0] in "wax"
        if writes and not self._inside(path) and name != os.devnull:
            self.noted.append(f"writes {name}")

    def _inside(self, arguments: Any) -> bool:
        """Whether a path lies in the working folder, or is relative to an open folder, as in its removal."""
        path, *more = arguments if isinstance(arguments, tuple) else (arguments,)
        if not isinstance(path, (str, bytes)):
            return False
        relative = more and isinstance(more[-1], int) and not os.path.isabs(path)
        if relative and more[-1] >= 0:
            return True
        place = os.path.realpath(os.fsdecode(path))
        return place.startswith((self._folder, tempfile.gettempdir() + "/gapscope"))

    @contextmanager
    def on(self) -> Iterator[None]:
        """Watch while the block runs."""
        self.noted = []
        _install()
        _WATCHING.append(self)
        try:
            yield
        finally:
            _WATCHING.remove(self)


_WATCHING: list[Watch] = []
"""The watch that is on, if any."""


@cache
def _install() -> None:
    """Add the one audit hook, which stays for the rest of the process."""

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        for watch in _WATCHING:
            watch.note(event, arguments)

    sys.addaudithook(hook)


def limit_memory() -> None:
    """Refuse this process more than ``MEMORY`` beyond what it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def run(
    target: Target,
    numbers: range,
    work: Path,
    progress: Path | None = None,
    *,
    bounded: bool = True,
) -> Outcome:
    """Mutate, read, judge.

    Args:
        target: the reader.
        numbers: of the inputs; an input follows from its number and the target's name alone.
        work: an empty folder.
        progress: file for the number of the input that is being read.
        bounded: whether to limit memory, which holds for the rest of the process.
    """
    folder, seeds = work / "input", work / "seeds"
    seeds.mkdir(parents=True)
    target.fill(seeds)
    (work / OUTSIDE).write_text("t,q1\n0,0\n")
    content, place = (seeds / target.file).read_bytes(), folder / target.file
    others = [path.relative_to(seeds) for path in seeds.rglob("*") if path.is_file()]
    outcome, watch = Outcome(), Watch(folder)
    with quiet():
        shutil.copytree(seeds, folder)
        target.read(folder)  # loads libraries, and shows that the seed is valid
        if bounded:
            limit_memory()
        for number in numbers:
            if progress is not None:
                # whoever reads the file meanwhile finds a number, whole or with leading zeros
                with progress.open("r+" if progress.exists() else "w") as file:
                    file.write(f"{number:012d}")
            changed = mutated(target, content, number)
            with suppress(OSError):
                place.unlink()
            if place.is_dir():
                shutil.rmtree(place)
            if changed is None:
                _odd_place(place, number)
            else:
                place.write_bytes(changed)
                with suppress(OSError, ValueError, TypeError, KeyError):
                    target.finish(folder)
            judge(target, number, folder, watch, outcome)
            for other in others:
                if other != Path(target.file) and not (
                    (folder / other).is_file()
                    and filecmp.cmp(seeds / other, folder / other, shallow=False)
                ):
                    shutil.copyfile(seeds / other, folder / other)
    return outcome


def mutated(target: Target, content: bytes, number: int) -> bytes | None:
    """The input of a number; ``None`` for one that is no regular file."""
    rng = random.Random(f"{target.name} {number}")
    if rng.random() < ODD_PLACES:
        return None
    return target.mutate(content, rng)


def judge(
    target: Target, number: int, folder: Path, watch: Watch, outcome: Outcome
) -> None:
    """Read what lies in the folder, and add to the outcome what became of it."""
    fault = ""
    for timer, alarm, seconds in _TIMERS:
        signal.signal(alarm, _hang)
        signal.setitimer(timer, seconds)
    try:
        with watch.on():
            target.read(folder)
        outcome.read += 1
    except InputError as error:
        outcome.refused += 1
        if error.file is None:
            fault = f"names no file: {error}"
    except GapscopeError:
        outcome.refused += 1
    except HangError:
        fault = "hangs\n" + traceback.format_exc()
    except BaseException as error:  # whatever else comes out is the finding
        if isinstance(error, KeyboardInterrupt):
            raise
        fault = f"{type(error).__name__}: {str(error)[:200]}\n" + traceback.format_exc()
    finally:
        for timer, _, _ in _TIMERS:
            signal.setitimer(timer, 0)
    opened = all("opens" in x for x in watch.noted)
    if watch.noted and not (target.may_name_files and opened):
        fault = f"{watch.noted[0]}; {fault}"
    if fault:
        what, where = fault.splitlines()[0], _origin(fault)
        outcome.faults.append({"number": number, "what": what, "where": where})


def _odd_place(place: Path, number: int) -> None:
    """Something that is no regular file of the folder."""
    links = ("/dev/zero", place.name, "/absent", "/dev/null")
    kind = number % (2 + len(links))
    if kind == 0:
        os.mkfifo(place)
    elif kind == 1:
        place.mkdir()
    else:
        place.symlink_to(links[kind - 2])


def _hang(*_: object) -> None:
    raise HangError


def _origin(fault: str) -> str:
    """The last line of the project in a traceback, by which faults are told apart."""
    lines = [x for x in fault.splitlines() if "/gapscope/" in x and "File" in x]
    return lines[-1].strip().split("/gapscope/")[-1] if lines else ""


def kinds(faults: list[dict[str, Any]]) -> Counter[str]:
    """Faults by what and where."""
    return Counter(f"{fault['what'][:110]} @ {fault['where']}" for fault in faults)


@contextmanager
def quiet() -> Iterator[None]:
    """Warnings and what C libraries print are not shown."""
    saved = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
