"""A case in memory with a load that its nominal arm does not know, and what the interface makes of it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import gapscope

sys.path.insert(0, str(Path(__file__).parents[1] / "diagnosis"))
import synthetic

COULOMB = (0.0, 4.0, 0.0)
"""Coulomb friction beyond the data sheet [N m]."""


def arrays(truth: synthetic.Truth) -> dict[str, list[np.ndarray]]:
    """Channels of three recordings."""
    recordings = synthetic.recordings(truth)
    return {name: [getattr(r, name) for r in recordings] for name in ("t", "q", "tau")}


@pytest.fixture(scope="session")
def case() -> gapscope.Case:
    """An arm with more Coulomb friction on joint 2 than its data sheet says."""
    truth = synthetic.Truth(coulomb=COULOMB)
    return gapscope.Case.from_arrays(synthetic.arm(), **arrays(truth), name="stiff")


@pytest.fixture(scope="session")
def result(case):
    """Its diagnosis."""
    return gapscope.diagnose(case)
