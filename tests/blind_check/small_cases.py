"""Small blind cases for tests: made and diagnosed in seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import pytest

from gapscope.arm.case import load_case
from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.simulate import CaseSpec, Conditions
from gapscope.diagnosis.diagnose import diagnose

pytest.importorskip("mujoco")
pytest.importorskip("numba")

CLEAN = Conditions("small", rate=250, loop_rate=500, recordings=2, duration=(5.0, 6.0))
"""A drawn arm with three joints, true inertials, known controller."""


class Solved(NamedTuple):
    """A case with its truth and its verdict."""

    folder: Path
    label: dict[str, Any]
    document: dict[str, Any]


def solve(laws: tuple[str, ...], folder: Path, seed: int = 1) -> Solved:
    """Make one small case and diagnose it."""
    made = make_case(
        CaseSpec(
            "single" if laws else "healthy", laws, (8.0, 16.0) if laws else None, CLEAN
        ),
        (seed,),
    )
    write_case(made, "case", False, folder, folder.with_suffix(".csv"))
    return Solved(folder, made.label, dict(diagnose(load_case(folder)).document))
