"""What tests of the diagnosis share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measured recordings and sample cases, which a user of the project does not have."""
    root = Path(
        os.environ.get("GAPSCOPE_DATA")
        or Path(__file__).resolve().parents[3] / "shared" / "data"
    )
    if not (root / "sample_cases" / "labels.json").is_file():
        pytest.skip(f"no recordings in {root} (set GAPSCOPE_DATA)")
    return root
