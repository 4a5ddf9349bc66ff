"""What the set-up faults of a case ask of its import section: its ``mend:``, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.diagnosis.setup_faults.channel_mapping import ChannelMapping
from gapscope.diagnosis.setup_faults.found_fault import OF_TAU_ALONE, FoundFault


@dataclass(frozen=True)
class _Columns:
    """x_j = scale_j read x_source_j + offset_j for n joints, (n,) each; ``source`` counts from 0."""

    source: np.ndarray
    scale: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, entry: Mapping[str, Any], n: int) -> _Columns:
        """From an entry of ``mend:``."""
        source = np.array(entry.get("columns", range(1, n + 1))) - 1
        scale = np.broadcast_to(entry.get("scale", 1.0), n)
        return cls(source, scale, np.broadcast_to(entry.get("offset", 0.0), n))

    def then(
        self, source: Sequence[int], scale: Sequence[float], offset: Sequence[float]
    ) -> _Columns:
        """Read so, and then once more by other columns, scales and offsets."""
        order, factor = list(source), np.array(scale)
        return _Columns(
            self.source[order],
            self.scale[order] * factor,
            self.offset[order] * factor + np.array(offset),
        )

    def entry(self) -> dict[str, Any]:
        """As an entry of ``mend:``, without what changes nothing."""
        out: dict[str, Any] = {}
        n = len(self.source)
        if (self.source != np.arange(n)).any():
            out["columns"] = (self.source + 1).tolist()
        for key, values, nothing in (
            ("scale", self.scale, 1.0),
            ("offset", self.offset, 0.0),
        ):
            if (values != nothing).any():
                same = (values == values[0]).all()
                out[key] = float(values[0]) if same else values.tolist()
        return out


@dataclass(frozen=True)
class Mending:
    """What faults ask for, in the order in which they are put right.

    Attributes:
        faults: those that ask for another reading, or for inertials on other links.
        n_joints: of the arm.
        link_shift: links by which the inertials of the URDF have to move...
        moved_only: ...among those that a joint moves, or among all.
    """

    faults: tuple[FoundFault, ...]
    n_joints: int
    link_shift: int = 0
    moved_only: bool = False

    def __bool__(self) -> bool:
        return bool(self.faults)

    def reason(self, key: str) -> str:
        """The faults for which an entry of ``mend:``, or ``robot``, is as it is."""
        return "; ".join(str(fault) for fault in self.faults if key in _asks(fault))

    def after(self, before: Mapping[str, Any]) -> dict[str, Any]:
        """The entries of ``mend:`` of a case whose import section has those of ``before`` already."""
        n = self.n_joints
        motion = _Columns.of(before.get("motion", {}), n)
        torque = _Columns.of(before.get("torque", {}), n)
        sensor = _Columns.of(before.get("sensor", {}), n)
        time = dict(before.get("time", {}))
        of_torque = {
            key: before["torque"][key]
            for key in ("delay", "gravity")
            if key in before.get("torque", {})
        }
        for fault in self.faults:
            mapping = fault.mapping
            assert mapping is not None
            none = (0.0,) * n
            motion = motion.then(
                mapping.motion_source, mapping.motion_factor, mapping.motion_offset
            )
            torque = torque.then(mapping.torque_source, mapping.torque_factor, none)
            if fault.name not in OF_TAU_ALONE:
                sensor = sensor.then(mapping.torque_source, mapping.torque_factor, none)
            if mapping.time_factor != 1.0:
                time["scale"] = time.get("scale", 1.0) * mapping.time_factor
            if mapping.time_factor != 1.0 and fault.recordings:
                time["files"] = _files(fault)
            if mapping.torque_delay:
                delay = of_torque.get("delay", 0.0) + mapping.torque_delay
                of_torque["delay"] = delay
            if mapping.without_gravity:
                of_torque["gravity"] = "left_out"
        entries = {
            "time": time,
            "motion": motion.entry(),
            "torque": torque.entry() | of_torque,
            "sensor": sensor.entry(),
        }
        return {key: entry for key, entry in entries.items() if entry}


def mending(faults: Sequence[FoundFault], n_joints: int) -> Mending:
    """What the faults of a case ask for; nothing if its files can be read as they are."""
    asking = tuple(fault for fault in faults if _asks(fault))
    shifts = [
        fault.mapping
        for fault in asking
        if fault.mapping is not None and fault.mapping.link_shift
    ]
    return Mending(
        asking,
        n_joints,
        sum(mapping.link_shift for mapping in shifts),
        any(mapping.moved_only for mapping in shifts),
    )


def _asks(fault: FoundFault) -> set[str]:
    """The entries of ``mend:``, or ``robot``, that a fault asks to change."""
    mapping = fault.mapping
    if mapping is None:
        return set()
    same = ChannelMapping.identity(len(mapping.motion_source))
    differs = {
        name: getattr(mapping, name) != getattr(same, name) for name in vars(same)
    }
    torque = differs["torque_source"] or differs["torque_factor"]
    asked = {
        "time": differs["time_factor"],
        "motion": any(differs[f"motion_{x}"] for x in ("source", "factor", "offset")),
        "torque": torque or differs["torque_delay"] or differs["without_gravity"],
        "sensor": torque and fault.name not in OF_TAU_ALONE,
        "robot": differs["link_shift"],
    }
    return {key for key, wanted in asked.items() if wanted}


def _files(fault: FoundFault) -> list[str]:
    """Names of the files whose recordings have a fault; those of a part of a file name the whole file."""
    names = (name.partition(" rows ")[0] for name in fault.recordings)
    whole = (name.partition(" episode ")[0] for name in names)
    return list(dict.fromkeys(whole))
