"""Effects between two ends, all drawn anew at a reset; as a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.case_file import read_yaml
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import read_entry


@dataclass(frozen=True)
class EffectRange:
    """An effect of which each parameter lies between two ends, independently of the others.

    Attributes:
        low, high: the effect with its lower and upper values; same name, same joints.
    """

    low: AppliedEffect
    high: AppliedEffect

    @property
    def key(self) -> tuple[str, int]:
        """Name of the effect, and the link that it changes, 0 without one."""
        return self.low.name, int(self.low.parameters.get("link", 0))

    def draw(self, rng: np.random.Generator) -> AppliedEffect:
        """The effect with each value drawn evenly between its ends."""
        ends = zip(
            self.low.parameters.items(), self.high.parameters.values(), strict=True
        )
        drawn = {name: rng.uniform(low, high) for (name, low), high in ends}
        return AppliedEffect(self.low.name, self.low.joints, drawn)


@dataclass(frozen=True)
class EffectRanges:
    """Effects that are all drawn at a reset, each within its range.

    Attributes:
        ranges: at most one of an effect on a joint, a link or the arm.
    """

    ranges: tuple[EffectRange, ...]

    def draw(self, rng: np.random.Generator) -> tuple[AppliedEffect, ...]:
        """The effects with values; the same state of ``rng`` gives the same, bit by bit."""
        return tuple(item.draw(rng) for item in self.ranges)


def write_effect_ranges(ranges: EffectRanges, path: Path, head: str = "") -> None:
    """Write ranges as YAML; ``path`` never holds half of it.

    Raises:
        GapscopeError: the file cannot be written.
    """
    content = {"schema": 1, "ranges": [_entry(item) for item in ranges.ranges]}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    with atomic_write(path) as aside:
        aside.write_text(head + text, encoding="utf-8")


def read_effect_ranges(path: Path | str) -> EffectRanges:
    """Ranges from a file of ``gapscope export --format environment``.

    Raises:
        InputError: the file is missing or not YAML, or an entry is not an effect with ``low`` and ``high``.
    """
    path = Path(path)
    content = read_yaml(path, "check the path")
    entries = content.get("ranges") if isinstance(content, Mapping) else None
    if not isinstance(entries, list):
        raise InputError(
            "expected the keys schema: 1 and ranges: [...]",
            "gapscope export --format environment --randomise writes such a file",
            file=path,
        )
    found = [_read(entry, f"ranges[{i}]", path) for i, entry in enumerate(entries)]
    return EffectRanges(tuple(found))


def _read(entry: Any, where: str, path: Path) -> EffectRange:
    """A range from its entry."""
    if not isinstance(entry, Mapping) or not {"low", "high"} <= set(entry):
        raise InputError(
            "expected effect:, joints:, low: and high:", file=path, where=where
        )
    rest = {name: entry[name] for name in ("effect", "joints") if name in entry}
    low, high = (
        read_entry(rest | {"parameters": entry[end]}, f"{where}.{end}", path)
        for end in ("low", "high")
    )
    for name, value in low.parameters.items():
        if (value > high.parameters[name]).any():
            raise InputError(
                f"{name} is higher in low: than in high:",
                "give the lower value in low:",
                file=path,
                where=where,
            )
    return EffectRange(low, high)


def _entry(item: EffectRange) -> dict[str, Any]:
    low, high = (
        {name: value.tolist() for name, value in end.parameters.items()}
        for end in (item.low, item.high)
    )
    joints = {"joints": list(item.low.joints)} if item.low.joints else {}
    return {"effect": item.low.name, **joints, "low": low, "high": high}
