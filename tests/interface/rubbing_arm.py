"""Recordings as arrays of an arm with more friction than its data sheet says."""

from __future__ import annotations

import numpy as np
import synthetic

COULOMB = (0.0, 4.0, 0.0)
"""Coulomb friction beyond the data sheet [N m]."""


def arrays(truth: synthetic.Truth) -> dict[str, list[np.ndarray]]:
    """Channels of three recordings."""
    recordings = synthetic.recordings(truth)
    return {name: [getattr(r, name) for r in recordings] for name in ("t", "q", "tau")}
