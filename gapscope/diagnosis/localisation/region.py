"""A region of the motion that holds more of a gap than its size explains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Region:
    """A region that holds more of a joint's gap than its size explains.

    Attributes:
        joint: joint from 1.
        kind: ``regime``, ``position``, ``time`` or ``frequency``: a part cut in advance; ``rule``, ``interval``,
            ``line`` or ``coherence``: learnt from the gap.
        regime: what the region is, in words.
        share: its share of the joint's squared gap, 0..1.
        coverage: its share of the samples; of a frequency band, its share of the power of the nominal torque, 0..1.
        detail: the same as numbers, further keys of the document.
    """

    joint: int
    kind: str
    regime: str
    share: float
    coverage: float
    detail: Mapping[str, Any] = field(default_factory=dict)

    @property
    def enrichment(self) -> float:
        """Share over coverage."""
        return self.share / max(self.coverage, 1e-3)
