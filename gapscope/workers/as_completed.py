"""Results of many calls as they end, in any order; a call whose worker dies is made again."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

from gapscope.workers.backends import LOCAL
from gapscope.workers.local_pool import LocalProcesses, ThisProcess
from gapscope.workers.pool import Pool, WorkerLostError
from gapscope.workers.ray_pool import RayPool

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
    error: Exception | None = None


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
    with closing(_pool(jobs, backend)) as pool:
        running: dict[Any, Ended] = {}

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
            for handle in pool.wait(list(running)):
                call = running.pop(handle)
                ended = _ended(pool, handle, call)
                if isinstance(ended.error, WorkerLostError) and call.tries < tries:
                    begin(replace(call, tries=call.tries + 1))
                else:
                    yield ended
            fill()


def _pool(jobs: int | None, backend: str) -> Pool:
    if backend != LOCAL:
        return RayPool(jobs)
    return LocalProcesses(jobs) if jobs and jobs > 1 else ThisProcess()


def _ended(pool: Pool, handle: Any, call: Ended) -> Ended:
    try:
        return replace(call, result=pool.result(handle))
    except Exception as error:
        return replace(call, error=error)
