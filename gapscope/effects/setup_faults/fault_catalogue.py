"""The setup faults by name."""

from __future__ import annotations

from gapscope.effects.setup_faults.channel_faults import (
    JointSwap,
    SignFlip,
    UnitMismatch,
    ZeroOffset,
)
from gapscope.effects.setup_faults.controller_faults import (
    GainMismatch,
    UnmeasuredTorque,
)
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.inertial_fault import ShiftedInertials
from gapscope.effects.setup_faults.reference_faults import (
    CoarseReference,
    IgnoredVelocityReference,
    SpeedScaling,
    VelocityOfReference,
)
from gapscope.effects.setup_faults.time_stamp_fault import TimeStamps
from gapscope.effects.setup_faults.torque_faults import (
    GravityCompensatedTorque,
    LateTorque,
    TorqueUnit,
)

FAULTS: dict[str, type[Fault]] = {
    fault.name: fault
    for fault in (
        SignFlip,
        JointSwap,
        UnitMismatch,
        ShiftedInertials,
        TimeStamps,
        GravityCompensatedTorque,
        TorqueUnit,
        LateTorque,
        ZeroOffset,
        IgnoredVelocityReference,
        VelocityOfReference,
        SpeedScaling,
        CoarseReference,
        GainMismatch,
        UnmeasuredTorque,
    )
}
"""The setup faults by name."""
