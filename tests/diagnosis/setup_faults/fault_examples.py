"""Faults of the set-up of the arm with three joints, one or more of every kind that a torque tells."""

from __future__ import annotations

import numpy as np

from gapscope.effects.setup_faults import (
    Fault,
    GravityCompensatedTorque,
    JointSwap,
    LateTorque,
    ShiftedInertials,
    SignFlip,
    TimeStamps,
    TorqueUnit,
    UnitMismatch,
    ZeroOffset,
)

FAULTS: dict[str, Fault] = {
    "torque turned": SignFlip((2,)),
    "torque of the last joint turned": SignFlip((3,)),
    "torques turned": SignFlip((2, 3)),
    "all torques turned": SignFlip((1, 2, 3)),
    "position turned": SignFlip((2,), "position"),
    "joint turned": SignFlip((3,), "joint"),
    "torques exchanged": JointSwap((1, 3)),
    "joints exchanged": JointSwap((2, 3), "joint"),
    "a joint in degrees": UnitMismatch("degrees", (2,)),
    "degrees": UnitMismatch("degrees"),
    "revolutions": UnitMismatch("revolutions"),
    "milliseconds": UnitMismatch("milliseconds"),
    "a joint on the motor's side": UnitMismatch("motor_side", (2,), 80.0),
    "motor side": UnitMismatch("motor_side", (), 50.0),
    "inertials shifted": ShiftedInertials(1),
    "inertials shifted back": ShiftedInertials(-1),
    "zero a quarter of a turn off": ZeroOffset((2,), np.pi / 2),
    "zero off by 60 degrees": ZeroOffset((2,), -np.pi / 3),
    "gravity left out": GravityCompensatedTorque(),
    "currents": TorqueUnit("current", factor=(12.0, 12.0, 8.0)),
    "a command times four": TorqueUnit("command_scale", (2,), (0.25,)),
    "torque late": LateTorque("delay", 0.06),
    "half the rate": TimeStamps("wrong_rate", 2.0),
    "torque's own clock": TimeStamps("torque_clock", 1.01),
    "repeats": TimeStamps("repeats", 0.06),
    "jitter": TimeStamps("jitter", 0.15),
    "gaps": TimeStamps("gaps", 0.06),
}
OF_EVERY_JOINT = ("degrees", "revolutions", "motor side", "currents")
"""Faults of the arm that are found as faults of each of its joints."""


def found_as(label: str) -> tuple[str, str, tuple[int, ...]]:
    """Name, variant and joints of the finding of a fault."""
    name, variant, joints = FAULTS[label].kind
    return name, variant, (1, 2, 3) if label in OF_EVERY_JOINT else joints
