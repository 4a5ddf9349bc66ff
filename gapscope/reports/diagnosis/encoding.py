"""Curves as text within a page."""

from __future__ import annotations

import base64

import numpy as np


def encode(values: np.ndarray) -> str:
    """Base64 of the values as little-endian float32."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode(
        "ascii"
    )
