"""The places where calls run: this machine, or a Ray cluster."""

from __future__ import annotations

import os
from typing import Any

from gapscope.arm.errors import GapscopeError, InputError

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
        ray_module()


def ray_module() -> Any:
    """Ray, which is imported only if it is asked for.

    Raises:
        GapscopeError: it is not installed.
    """
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
