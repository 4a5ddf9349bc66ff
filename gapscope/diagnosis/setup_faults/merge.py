"""Findings of the same fault on several joints, made one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.setup_faults.found_fault import FoundFault


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
    """Both as one; the first if they share a joint."""
    joints = first.joints + second.joints
    if len(set(joints)) < len(joints):
        return first
    order = np.argsort(joints)
    shared = first.std.keys() & second.std.keys()
    both = {name: np.array(first.std[name] + second.std[name]) for name in shared}
    return replace(
        first,
        fault=first.fault.joined(second.fault),
        std={name: tuple(std[order].tolist()) for name, std in both.items()},
        probability=min(first.probability, second.probability),
    )
