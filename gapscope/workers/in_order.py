"""Results of calls that run side by side, in the order of their arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from joblib import Parallel, delayed

from gapscope.workers.as_completed import as_completed
from gapscope.workers.backends import RAY

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
        backend: ``local``: processes of this machine, by joblib; ``ray``: the cluster at ``RAY_ADDRESS``, or the one
            that this machine belongs to, else processes of this machine.

    Returns:
        The result of each call; with Ray the exception if a call could not be run to its end.
    """
    if backend == RAY:
        return _by_ray(function, arguments, jobs)
    made: Iterator[Result] = Parallel(n_jobs=jobs, return_as="generator")(
        delayed(function)(*a) for a in arguments
    )
    return made


def _by_ray(
    function: Callable[..., Result], arguments: Sequence[tuple[Any, ...]], jobs: int
) -> Iterator[Result | Exception]:
    early: dict[int, Any] = {}
    following = 0
    for ended in as_completed(function, arguments, jobs, RAY):
        early[ended.number] = ended.error or ended.result
        while following in early:
            yield early.pop(following)
            following += 1
