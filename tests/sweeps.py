"""Sweeps over many cases: a few of them in ``make test``, the others in ``make nightly``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def nightly(*values: Any, **more: Any) -> Any:
    """Arguments of a test that only the nightly run makes; ``more`` as for ``pytest.param``."""
    return pytest.param(*values, marks=pytest.mark.nightly, **more)


def daily(every: Iterable[Any], *kept: Any) -> list[Any]:
    """Arguments of a test, of which those that are kept are made every day and the others nightly."""
    return [value if value in kept else nightly(value) for value in every]
