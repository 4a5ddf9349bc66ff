"""The effects of ``diagnosis.json`` as rows: one for each number of each effect on each place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

AXES = "xyz"
"""What three values of the arm or of a link are along."""


class Number(NamedTuple):
    """One number of an effect on a joint, a link or the arm.

    Attributes:
        effect: name of the effect.
        joint: from 1; ``None`` for effects on a link or the arm.
        link: of a changed link, from 1; else ``None``.
        parameter: its name; empty for a fault of the set-up that is there or not.
        component: ``x``, ``y`` or ``z`` of a vector, else empty.
        unit: SI unit of ``value`` and ``std``; empty without a parameter.
        value: as in the document; ``None`` without a parameter.
        std: its standard deviation, ``None`` if not known.
    """

    effect: str
    joint: int | None
    link: int | None
    parameter: str = ""
    component: str = ""
    unit: str = ""
    value: float | None = None
    std: float | None = None

    @property
    def place(self) -> str:
        """``joint 4``, ``link 3`` or ``the whole arm``."""
        return place_text(self.joint, self.link)


def place_text(joint: int | None, link: int | None) -> str:
    """Where an effect acts, in words."""
    if joint:
        return f"joint {joint}"
    return f"link {link}" if link else "the whole arm"


def numbers_of(entry: Mapping[str, Any]) -> Iterator[Number]:
    """The numbers of an entry of ``effects`` or ``possible``; that of its link is a place, not a number."""
    effect, joints, parameters = entry["effect"], entry["joints"], entry["parameters"]
    link = int(parameters["link"]["value"]) if "link" in parameters else None
    names = [name for name in parameters if name != "link"]
    # an effect without parameters still has its places
    if not names:
        for joint in joints or [None]:
            yield Number(effect, joint, link)
    for name in names:
        parameter = parameters[name]
        values = np.atleast_1d(np.array(parameter["value"], float))
        stds = np.broadcast_to(np.array(parameter["std"], float), values.shape)
        # joints that turn and that slide have a unit each
        units = parameter.get("units") or [parameter["unit"]] * len(values)
        # three values of the arm are x, y, z; of joints they are three joints
        vector = not joints and len(values) == len(AXES)
        for k, (value, std) in enumerate(zip(values, stds, strict=True)):
            yield Number(
                effect,
                joints[k] if joints else None,
                link,
                name,
                AXES[k] if vector else "",
                units[k],
                float(value),
                float(std) if np.isfinite(std) else None,
            )


def number_rows(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """A row for each number of each effect of a diagnosis: ``Number``, its effect's probability, share, if named."""
    # one row per number, so that effects of all kinds have the same columns
    for section in ("effects", "possible"):
        for entry in document[section]:
            more = {key: entry[key] for key in ("probability", "share")}
            more["named"] = section == "effects"
            for number in numbers_of(entry):
                yield {**number._asdict(), **more}
