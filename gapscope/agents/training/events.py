"""TensorBoard events of a training, if tensorboard is installed."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gapscope.agents.training.curve import Point


def write_events(folder: Path, point: Point, losses: Mapping[str, Any]) -> None:
    """Write the scores of a point, and the learner's own figures; nothing if tensorboard is not installed."""
    if find_spec("tensorboard") is None:
        return
    from torch.utils.tensorboard import SummaryWriter

    plain = point.plain()
    with SummaryWriter(str(folder), purge_step=point.steps) as writer:
        for part in ("simulator", "hidden"):
            for name, value in (plain[part] or {}).items():
                if value is not None:
                    writer.add_scalar(f"{part}/{name}", value, point.steps)
        for name, value in losses.items():
            if isinstance(value, (int, float)):
                writer.add_scalar(name, value, point.steps)
