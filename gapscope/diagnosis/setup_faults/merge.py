"""Findings of the same fault on several joints, made one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from gapscope.diagnosis.setup_faults.found_fault import FaultParameter, FoundFault


def merged(faults: Iterable[FoundFault]) -> tuple[FoundFault, ...]:
    """Faults with the same name and variant as one, joints in order; swaps stay apart, and keep all others apart."""
    faults = tuple(faults)
    # after a swap, joint numbers mean something else
    if any(f.name == "joint_swap" for f in faults):
        return faults
    out: dict[tuple[str, str, tuple[str, ...], bool], FoundFault] = {}
    for fault in faults:
        key = (fault.name, fault.variant, fault.recordings, bool(fault.joints))
        out[key] = _joined(out[key], fault) if key in out and fault.joints else fault
    return tuple(out.values())


def _joined(first: FoundFault, second: FoundFault) -> FoundFault:
    overlap = set(first.joints) & set(second.joints)
    if overlap or first.mapping is None or second.mapping is None:
        return first
    joints = first.joints + second.joints
    order = sorted(range(len(joints)), key=lambda i: joints[i])
    return replace(
        first,
        joints=tuple(joints[i] for i in order),
        parameters={
            name: _concatenated(parameter, second.parameters[name], order)
            for name, parameter in first.parameters.items()
        },
        probability=min(first.probability, second.probability),
        mapping=first.mapping.then(second.mapping),
    )


def _concatenated(
    first: FaultParameter, second: FaultParameter, order: list[int]
) -> FaultParameter:
    """Values of the first joints and of the second, sorted."""
    values = first.value + second.value
    std = None
    if first.std is not None:
        stds = first.std + (second.std or ())
        std = tuple(stds[i] for i in order)
    return FaultParameter(first.unit, tuple(values[i] for i in order), std)
