"""Results of calls that run side by side, in the order of their arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from gapscope.workers.as_completed import as_completed

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
