"""Puts the folder of the diagnosis' tests on ``sys.path``: archives hold their ``documents``."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "diagnosis"))
