"""A few small blind cases that the tests of the blind check share."""

from __future__ import annotations

import pytest
from small_cases import Solved, solve


@pytest.fixture(scope="session")
def solved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Solved]:
    """Three small single effects that have nothing in common, made and diagnosed once."""
    root = tmp_path_factory.mktemp("blind")
    return {
        name: solve((name,), root / name)
        for name in ("coulomb_friction", "torque_scale", "torque_ripple")
    }
