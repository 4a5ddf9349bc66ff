"""Calls of one function that run side by side: on this machine's processes, or on a cluster."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, TypeVar

from joblib import Parallel, delayed

from gapscope.arm.errors import GapscopeError, InputError

Result = TypeVar("Result")

LOCAL, RAY = "local", "ray"


def check_backend(backend: str) -> None:
    """Check that a backend exists before any work is done for it.

    Raises:
        InputError: unknown backend.
        GapscopeError: Ray is not installed.
    """
    if backend not in (LOCAL, RAY):
        raise InputError(
            f"unknown backend {backend!r}", "use local or ray", where="--backend"
        )
    if backend == RAY:
        _ray()


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
    ray = _ray()
    if not ray.is_initialized():
        try:
            ray.init(address="auto", log_to_driver=False)
        except ConnectionError:
            ray.init(
                address="local",
                num_cpus=jobs,
                include_dashboard=False,
                log_to_driver=False,
            )
    remote = ray.remote(function)
    calls = iter(arguments)
    running = [remote.remote(*call) for call in islice(calls, jobs)]
    results = deque(running)
    while results:
        # results are given in order, so the first is waited for; calls that end meanwhile make room for others
        while results[0] in running:
            ended, running = ray.wait(running)
            more = [remote.remote(*call) for call in islice(calls, len(ended))]
            running += more
            results += more
        try:
            yield ray.get(results.popleft())
        except ray.exceptions.RayError as error:
            yield error


def _ray() -> Any:
    # Ray reads this on import: it sends no usage data unless the user asks for that
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError:
        raise GapscopeError(
            "ray is not installed",
            "pip install 'gapscope[cluster]', or use --backend local",
        ) from None
    return ray
