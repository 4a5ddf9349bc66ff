"""Workers of this machine: the calling process itself, or processes of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any

from joblib.externals.loky import ProcessPoolExecutor
from joblib.externals.loky.process_executor import BrokenProcessPool

from gapscope.workers.pool import Pool, WorkerLostError


class ThisProcess(Pool):
    """One call at a time, in the calling process."""

    jobs = 1

    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Make the call at once."""
        made: Future[Any] = Future()
        try:
            made.set_result(function(*arguments))
        except Exception as error:
            made.set_exception(error)
        return made

    def wait(self, handles: Sequence[Any]) -> Sequence[Any]:
        """All calls: each has ended when it was begun."""
        return handles

    def result(self, handle: Any) -> Any:
        """Result of a call."""
        return handle.result()

    def close(self) -> None:
        """Nothing runs any more."""


class LocalProcesses(Pool):
    """Processes of this machine, each in an executor of its own: one that dies takes no other call with it."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._free = [_executor() for _ in range(jobs)]
        self._busy: dict[Future[Any], Any] = {}

    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Begin a call in a free process."""
        executor = self._free.pop()
        handle: Future[Any] = executor.submit(function, *arguments)
        self._busy[handle] = executor
        return handle

    def wait(self, handles: Sequence[Any]) -> Sequence[Any]:
        """Wait for the first calls to end."""
        return list(wait(handles, return_when=FIRST_COMPLETED).done)

    def result(self, handle: Any) -> Any:
        """Result of a call; its process is free again, or replaced if it died."""
        executor = self._busy.pop(handle)
        try:
            result = handle.result()
        except BrokenProcessPool as error:
            executor.shutdown()
            self._free.append(_executor())
            problem = str(error).splitlines()[0]
            raise WorkerLostError(problem) from None
        except Exception:
            self._free.append(executor)
            raise
        self._free.append(executor)
        return result

    def close(self) -> None:
        """End the processes."""
        for executor in (*self._free, *self._busy.values()):
            executor.shutdown(kill_workers=True)


def _executor() -> Any:
    """An executor of one process, which starts with its first call; numeric libraries get one thread there."""
    threads = dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
    )
    return ProcessPoolExecutor(max_workers=1, env=threads)
