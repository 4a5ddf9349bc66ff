"""Many tasks at once: on the cores of this machine or on a Ray cluster, results as they come or in order."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from dataclasses import dataclass, replace
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from joblib.externals.loky import ProcessPoolExecutor
from joblib.externals.loky.process_executor import BrokenProcessPool

from gapscope.arm.errors import extra
from gapscope.arm.nearest_name import check_known
from gapscope.effects.catalogue import FILES

# What a pool of workers does for ``as_completed``.


class WorkerLostError(Exception):
    """The worker of a call died, or its machine did: the call may be made again."""


class Pool:
    """One call at a time, in the calling process; others have workers, each of which runs one.

    Attributes:
        jobs: number of calls that run at a time.
    """

    jobs = 1

    def submit(
        self, function: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> Future[Any]:
        """Begin a call, while fewer than ``jobs`` run."""
        made: Future[Any] = Future()
        try:
            made.set_result(function(*arguments))
        except Exception as error:
            made.set_exception(error)
        return made

    def lost(self, error: BaseException | None) -> str:
        """Why a worker died, if that is why a call has ended; else empty."""
        return ""

    def close(self) -> None:
        """End the workers, and calls that still run, if there are any."""


# The places where calls run: this machine, or a Ray cluster.


LOCAL, RAY = "local", "ray"


def check_backend(backend: str) -> None:
    """Check that a backend exists before any work is done for it.

    Raises:
        InputError: unknown backend, or Ray is not installed.
    """
    check_known("backend", backend, (LOCAL, RAY), where="--backend")
    if backend == RAY:
        ray_module()


def ray_module() -> Any:
    """Ray, which is imported only if it is asked for.

    Raises:
        InputError: it is not installed.
    """
    # Ray reads this on import: it sends no usage data unless the user asks for that
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    with extra("cluster", "--backend ray"):
        import ray
    return ray


# Workers of this machine, in processes of their own.


THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class LocalProcesses(Pool):
    """Processes of this machine, each in an executor of its own: one that dies takes no other call with it."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._executors: dict[Future[Any], Any] = {}
        # a process that is ended leaves its temporary folders behind: they lie in this one
        self._aside = TemporaryDirectory(prefix="gapscope-")

    def submit(
        self, function: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> Future[Any]:
        """Begin a call in a process that is free, or in a new one."""
        executor = None
        # what has ended frees its process, unless that died
        for ended in [future for future in self._executors if future.done()]:
            own = self._executors.pop(ended)
            # one free process is enough for this call
            if executor is None and not self.lost(ended.exception()):
                executor = own
            else:
                own.shutdown()
        if executor is None:
            # of one process, which starts with its first call; numeric libraries get one thread there
            environment = dict.fromkeys(THREADS, "1") | {"TMPDIR": self._aside.name}
            executor = ProcessPoolExecutor(1, env=environment)
        made = executor.submit(function, *arguments)
        self._executors[made] = executor
        return made

    def lost(self, error: BaseException | None) -> str:
        """Whether the process died."""
        broken = isinstance(error, BrokenProcessPool)
        return str(error).splitlines()[0] if broken else ""

    def close(self) -> None:
        """End the processes, and what they left in their temporary folders."""
        for executor in self._executors.values():
            executor.shutdown(kill_workers=True)
        self._aside.cleanup()


# Workers of a Ray cluster.


class RayPool(Pool):
    """Workers of the cluster at ``RAY_ADDRESS``, or of the one that this machine belongs to, else of this machine.

    Ray itself repeats no call: ``as_completed`` does, counts the tries, and ends a call that kills every worker.
    """

    def __init__(self, jobs: int | None) -> None:
        """Join the cluster, or start one.

        Args:
            jobs: calls at a time; ``None``: as many as the cluster has cores.
        """
        self._ray = ray_module()
        self._remote: dict[Callable[..., Any], Any] = {}
        self._running: dict[Future[Any], Any] = {}
        if not self._ray.is_initialized():
            # a cluster that is there comes first
            quiet = {"log_to_driver": False}
            try:
                self._ray.init(address="auto", **quiet)
            except ConnectionError:
                own = {"num_cpus": jobs, "include_dashboard": False}
                self._ray.init(address="local", **own, **quiet)
        cores = self._ray.cluster_resources().get("CPU", 1)
        self.jobs = jobs or max(1, int(cores))

    def submit(
        self, function: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> Future[Any]:
        """Send a call to the cluster, which keeps no copy of what has ended."""
        # a function is sent to the cluster once, not with every call
        if function not in self._remote:
            options: dict[str, Any] = {"max_retries": 0}
            if os.environ.get(FILES):
                # a worker may have been started before the effects of the user's files were read here
                options["runtime_env"] = {"env_vars": {FILES: os.environ[FILES]}}
            self._remote[function] = self._ray.remote(**options)(function)
        self._running = {f: own for f, own in self._running.items() if not f.done()}
        handle = self._remote[function].remote(*arguments)
        made: Future[Any] = handle.future()
        self._running[made] = handle
        return made

    def lost(self, error: BaseException | None) -> str:
        """Whether worker, machine or result were lost, or ended for want of memory; not what the function raised."""
        errors = self._ray.exceptions
        if isinstance(error, errors.RayTaskError) or not isinstance(
            error, errors.RayError
        ):
            return ""
        return f"{type(error).__name__}: {str(error).strip().splitlines()[0]}"

    def close(self) -> None:
        """End the calls that still run; the cluster stays."""
        for future, handle in self._running.items():
            if not future.done():
                self._ray.cancel(handle, force=True)


# Results of many calls as they end, in any order; a call whose worker dies is made again.


TRIES = 3
"""Times that a call is begun, at most, if its workers die."""


@dataclass(frozen=True)
class Ended:
    """A call that has ended.

    Attributes:
        number: of the call, from 0.
        arguments: of the call.
        tries: times that it was begun.
        result: of the function; ``None`` if there is none.
        error: why there is no result: what the function raised, or the loss of the last worker.
    """

    number: int
    arguments: tuple[Any, ...]
    tries: int = 1
    result: Any = None
    error: BaseException | None = None


def as_completed(
    function: Callable[..., Any],
    calls: Iterable[tuple[Any, ...]],
    jobs: int | None = None,
    backend: str = LOCAL,
    tries: int = TRIES,
) -> Generator[Ended, None, None]:
    """Make calls side by side and give each as it ends.

    Calls are drawn from ``calls`` as workers become free: no more than ``jobs`` arguments and results are held.

    Args:
        function: of a module, with arguments and results that can be pickled.
        calls: arguments of each call; may be an endless generator.
        jobs: calls at a time; ``None``: one on this machine, as many as a cluster has cores.
        backend: ``local``: one job runs in this process, several in processes of their own; ``ray``: see ``RayPool``.
        tries: times that a call is begun, at most.
    """
    waiting = (Ended(number, arguments) for number, arguments in enumerate(calls))
    pool = Pool()
    if backend == RAY:
        pool = RayPool(jobs)
    elif jobs and jobs > 1:
        pool = LocalProcesses(jobs)
    with closing(pool):
        # by the future, so that what has ended tells which call it was
        running = {}

        def begin(call: Ended) -> None:
            running[pool.submit(function, call.arguments)] = call

        def fill() -> None:
            while len(running) < pool.jobs:
                call = next(waiting, None)
                if call is None:
                    return
                begin(call)

        fill()
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                call, error = running.pop(future), future.exception()
                lost = error and pool.lost(error)
                if lost and call.tries < tries:
                    begin(replace(call, tries=call.tries + 1))
                # no try is left, or the function itself has raised, as it would again
                elif error:
                    yield replace(call, error=WorkerLostError(lost) if lost else error)
                else:
                    yield replace(call, result=future.result())
            fill()


# Results of calls that run side by side, in the order of their arguments.


Result = TypeVar("Result")


def in_order(
    function: Callable[..., Result],
    arguments: Sequence[tuple[Any, ...]],
    jobs: int,
    backend: str,
) -> Iterator[Result | Exception]:
    """Results of the calls, in the order of the arguments, each as soon as it and those before are there.

    Args:
        function: of a module, with arguments and results that can be pickled.
        arguments: of each call.
        jobs: calls at a time.
        backend: see ``as_completed``.

    Returns:
        The result of each call, or the exception if it could not be run to its end.
    """
    early: dict[int, Any] = {}
    following = 0
    for ended in as_completed(function, arguments, jobs, backend):
        early[ended.number] = ended.error or ended.result
        while following in early:
            yield early.pop(following)
            following += 1
