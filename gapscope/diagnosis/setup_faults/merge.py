"""Findings of the same fault on several joints, made one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from gapscope.diagnosis.setup_faults.found_fault import FoundFault, Quantity


def merged(faults: Iterable[FoundFault]) -> tuple[FoundFault, ...]:
    """Faults with the same name and variant as one, joints in order; swaps stay apart, and keep all others apart."""
    faults = tuple(faults)
    if any(f.name == "joint_swap" for f in faults):
        return faults
    out: dict[tuple[str, str, tuple[str, ...], bool], FoundFault] = {}
    for fault in faults:
        key = (fault.name, fault.variant, fault.recordings, bool(fault.joints))
        out[key] = _joined(out[key], fault) if key in out and fault.joints else fault
    return tuple(out.values())


def _joined(first: FoundFault, second: FoundFault) -> FoundFault:
    if (
        set(first.joints) & set(second.joints)
        or first.reading is None
        or second.reading is None
    ):
        return first
    joints = first.joints + second.joints
    order = sorted(range(len(joints)), key=lambda i: joints[i])
    parameters = {
        name: Quantity(
            q.unit,
            tuple((q.value + second.parameters[name].value)[i] for i in order),
            None
            if q.std is None
            else tuple((q.std + (second.parameters[name].std or ()))[i] for i in order),
        )
        for name, q in first.parameters.items()
    }
    return replace(
        first,
        joints=tuple(joints[i] for i in order),
        parameters=parameters,
        probability=min(first.probability, second.probability),
        reading=first.reading.then(second.reading),
    )
