"""A case in memory with friction that its nominal arm does not know, and its diagnosis."""

from __future__ import annotations

import pytest
import rubbing_arm
from rubbing_arm import synthetic

import gapscope


@pytest.fixture(scope="session")
def case() -> gapscope.Case:
    """An arm with more Coulomb friction on joint 2 than its data sheet says."""
    channels = rubbing_arm.arrays(synthetic.Truth(coulomb=rubbing_arm.COULOMB))
    return gapscope.Case.from_arrays(synthetic.arm(), **channels, name="stiff")


@pytest.fixture(scope="session")
def result(case):
    """Its diagnosis."""
    return gapscope.diagnose(case)
