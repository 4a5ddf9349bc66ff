"""What a pool of workers does for ``as_completed``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any


class WorkerLostError(Exception):
    """The worker of a call died, or its machine did: the call may be made again."""


class Pool(ABC):
    """Workers, each of which runs one call at a time.

    Attributes:
        jobs: number of calls that run at a time.
    """

    jobs: int

    @abstractmethod
    def submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Begin a call, while fewer than ``jobs`` run; returns its handle."""

    @abstractmethod
    def wait(self, handles: Sequence[Any]) -> Sequence[Any]:
        """Wait until at least one call has ended; returns the handles of those that have."""

    @abstractmethod
    def result(self, handle: Any) -> Any:
        """Result of a call that has ended.

        Raises:
            WorkerLostError: its worker died.
            Exception: what the function itself raised.
        """

    @abstractmethod
    def close(self) -> None:
        """End the workers, and calls that still run."""
