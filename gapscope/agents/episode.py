"""An episode of an evaluation: one model on one motion."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from gapscope.agents.tracking_metrics import Measures
from gapscope.arm.io.json_file import plain


@dataclass(frozen=True)
class Episode:
    """One model on one motion.

    Attributes:
        model, engine, motion, disturbance, seed: which.
        measures: how well it was tracked.
        torque_error: NRMSE of the model's feedforward against the torque that the motion needs, mean over joints [1].
    """

    model: str
    engine: str
    motion: str
    disturbance: str
    seed: int
    measures: Measures
    torque_error: float

    def row(self) -> dict[str, Any]:
        """As plain data; numbers that are not finite are ``None``."""
        row = asdict(self)
        row |= row.pop("measures")
        return dict(plain(row, null_if_not_finite=True))
