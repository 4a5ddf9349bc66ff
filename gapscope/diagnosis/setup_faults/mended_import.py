"""What the set-up faults of a case ask of its file, its import section above all, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.controller import Controller
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
        faults: those that ask for another reading, another controller, or inertials on other links.
        others: those that every diagnosis puts right by itself, or of which a case file cannot say so.
        asked: for each of ``faults`` what it asks to change: entries of ``mend:``, channels of ``import:`` that are
            not to be read, ``controller``, or ``robot``.
        n_joints: of the arm.
    """

    faults: tuple[FoundFault, ...]
    others: tuple[FoundFault, ...]
    asked: tuple[frozenset[str], ...]
    n_joints: int

    def __bool__(self) -> bool:
        return bool(self.faults)

    def reason(self, key: str) -> str:
        """The faults for which something is changed; empty if it is not."""
        pairs = zip(self.faults, self.asked, strict=True)
        return "; ".join(str(fault) for fault, keys in pairs if key in keys)

    @property
    def unread(self) -> list[str]:
        """Channels of the import section that are not to be read."""
        return [name for name in ("dq", "tau") if self.reason(name)]

    @property
    def shift(self) -> tuple[int, bool]:
        """Links by which the inertials of the URDF have to move, and whether among those that a joint moves alone."""
        mappings = [f.mapping for f in self.faults if f.mapping is not None]
        shifts = [mapping for mapping in mappings if mapping.link_shift]
        return sum(m.link_shift for m in shifts), any(m.moved_only for m in shifts)

    def controller(self, controller: Controller | None) -> Controller | None:
        """The controller at work."""
        for fault in self.faults:
            controller = fault.repair_controller(controller)
        return controller

    def after(self, before: Mapping[str, Any]) -> dict[str, Any]:
        """The entries of ``mend:`` of a case whose import section has those of ``before`` already."""
        n, none = self.n_joints, (0.0,) * self.n_joints
        motion = _Columns.of(before.get("motion", {}), n)
        torque = _Columns.of(before.get("torque", {}), n)
        sensor = _Columns.of(before.get("sensor", {}), n)
        of_torque = {
            key: value
            for key, value in before.get("torque", {}).items()
            if key in ("delay", "gravity")
        }
        time, reference = (
            dict(before.get("time", {})),
            dict(before.get("reference", {})),
        )
        for fault in self.faults:
            _of_reference(fault, reference)
            mapping = fault.mapping
            if mapping is None:
                continue
            motion = motion.then(
                mapping.motion_source, mapping.motion_factor, mapping.motion_offset
            )
            torque = torque.then(mapping.torque_source, mapping.torque_factor, none)
            if fault.name not in OF_TAU_ALONE:
                sensor = sensor.then(mapping.torque_source, mapping.torque_factor, none)
            _of_time(fault, mapping, time)
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
            "reference": reference,
        }
        return {key: entry for key, entry in entries.items() if entry}


def mending(faults: Sequence[FoundFault], case: Case) -> Mending:
    """What the faults of a case ask for; nothing if its files can be read as they are."""
    names = {r.name for r in (*case.recordings, *case.judged)}
    asked = {id(fault): _asks(fault, case.controller, names) for fault in faults}
    asking = tuple(fault for fault in faults if asked[id(fault)])
    return Mending(
        asking,
        tuple(fault for fault in faults if not asked[id(fault)]),
        tuple(frozenset(asked[id(fault)]) for fault in asking),
        case.arm.n_joints,
    )


def _asks(
    fault: FoundFault, controller: Controller | None, names: set[str]
) -> set[str]:
    """What a fault asks to change; ``names`` are those of all recordings."""
    if fault.mapping is not None:
        return _asked_by_mapping(fault, fault.mapping)
    # an entry about references concerns all files
    if fault.recordings and names - set(fault.recordings):
        return set()
    if fault.name == "unmeasured_torque":
        # the controller, if it is known, gives the torque
        known = controller is not None and "kp_at_work" in fault.parameters
        return {"tau"} if known else set()
    return _OF_REFERENCES.get(fault.name, set())


_OF_REFERENCES = {
    "velocity_of_reference": {"dq"},
    "ignored_velocity_reference": {"reference"},
    "speed_scaling": {"reference"},
    "gain_mismatch": {"controller"},
}
"""What faults of references and of the controller ask to change."""


def _asked_by_mapping(fault: FoundFault, mapping: ChannelMapping) -> set[str]:
    """The entries of ``mend:``, or ``robot``, that another mapping of the channels asks to change."""
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


def _of_reference(fault: FoundFault, entry: dict[str, Any]) -> None:
    """Enter what a fault asks of the references."""
    values = {name: p.value[0] for name, p in fault.parameters.items() if p.value}
    if fault.name == "ignored_velocity_reference":
        entry["lead"] = entry.get("lead", 0.0) + values["lead"]
    if fault.name == "speed_scaling":
        entry["pace"] = entry.get("pace", 1.0) * values["factor"]


def _of_time(fault: FoundFault, mapping: ChannelMapping, entry: dict[str, Any]) -> None:
    """Enter what a fault asks of the time; its files are those of its recordings, each as a whole."""
    if mapping.time_factor == 1.0:
        return
    entry["scale"] = entry.get("scale", 1.0) * mapping.time_factor
    names = (name.partition(" rows ")[0] for name in fault.recordings)
    files = list(dict.fromkeys(name.partition(" episode ")[0] for name in names))
    if files:
        entry["files"] = files
