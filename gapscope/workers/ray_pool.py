"""Workers of a Ray cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

from gapscope.effects.catalogue import FILES
from gapscope.workers.backends import ray_module
from gapscope.workers.pool import Pool, WorkerLostError


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
        self._running: set[Any] = set()
        if not self._ray.is_initialized():
            self._join(jobs)
        cores = self._ray.cluster_resources().get("CPU", 1)
        self.jobs = jobs or max(1, int(cores))

    def _join(self, jobs: int | None) -> None:
        try:
            self._ray.init(address="auto", log_to_driver=False)
        except ConnectionError:
            self._ray.init(
                address="local",
                num_cpus=jobs,
                include_dashboard=False,
                log_to_driver=False,
            )

    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Send a call to the cluster."""
        # a function is sent to the cluster once, not with every call
        if function not in self._remote:
            options: dict[str, Any] = {"max_retries": 0}
            if os.environ.get(FILES):
                # a worker may have been started before the effects of the user's files were read here
                options["runtime_env"] = {"env_vars": {FILES: os.environ[FILES]}}
            self._remote[function] = self._ray.remote(**options)(function)
        handle = self._remote[function].remote(*arguments)
        self._running.add(handle)
        return handle

    def wait(self, handles: Sequence[Any]) -> Sequence[Any]:
        """Wait for the first calls to end."""
        ended, _ = self._ray.wait(list(handles))
        return list(ended)

    def result(self, handle: Any) -> Any:
        """Result of a call, of which the cluster keeps no copy."""
        errors = self._ray.exceptions
        self._running.discard(handle)
        try:
            return self._ray.get(handle)
        except errors.RayTaskError:  # the function's own exception
            raise
        except errors.RayError as error:
            # worker, machine or result lost, or ended for want of memory
            raise WorkerLostError(_first_line(error)) from None

    def close(self) -> None:
        """End the calls that still run; the cluster stays."""
        for handle in self._running:
            self._ray.cancel(handle, force=True)


def _first_line(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).strip().splitlines()[0]}"
