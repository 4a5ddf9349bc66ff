"""The setup faults that may be in a case: each with the mapping of the channels that puts it right."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.setup_faults.channel_mapping import (
    ChannelMapping,
    flipped,
    offset_by,
    scaled,
    shifted,
    swapped,
    timed,
    turned,
)
from gapscope.diagnosis.setup_faults.fault_samples import FaultSamples
from gapscope.diagnosis.thresholds import (
    FEW_FAR_JOINTS,
    GEAR_RATIO_STARTS,
    RATE_STARTS,
    ZERO_STARTS,
)

DEGREE = np.pi / 180
TURN = 2 * np.pi
TURNED_BASE = "base_tilt"
"""Name of the effect that competes with faults."""


@dataclass(frozen=True)
class FaultCandidate:
    """A setup fault with its values, and the mapping that puts recordings with it right.

    Attributes:
        name: name of the fault, a key of ``gapscope.effects.setup_faults.fault_catalogue.FAULTS``.
        joints: from 1; empty for the whole arm.
        variant: which channel, unit or kind; empty if the fault has only one.
        mapping: puts it right.
        values: its continuous parameters by name, one per joint or one for the arm.
    """

    name: str
    joints: tuple[int, ...]
    variant: str
    mapping: ChannelMapping
    values: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


def torque_candidates(n: int) -> list[FaultCandidate]:
    """Faults of the torque alone, which leave the predicted torque as it is.

    Two flips are tried together: each may hide the other, since links share their inertials.
    """
    flips = [_flip(n, j, "torque") for j in range(n)]
    double_flips = [
        replace(a, joints=a.joints + b.joints, mapping=a.mapping.then(b.mapping))
        for a, b in itertools.combinations(flips, 2)
    ]
    swaps = [_swap(n, pair, "torque") for pair in _pairs(n)]
    all_joints = tuple(range(1, n + 1))
    negated = replace(ChannelMapping.identity(n), torque_factor=(-1.0,) * n)
    all_flipped = FaultCandidate("sign_flip", all_joints, "torque", negated)
    return [*flips, *double_flips, *swaps, all_flipped]


def motion_candidates(n: int) -> list[FaultCandidate]:
    """Flips and swaps of positions, with the torque or without, and other zeros."""
    flips = [
        _flip(n, j, channel) for j in range(n) for channel in ("position", "joint")
    ]
    swaps = [_swap(n, pair, "joint") for pair in _pairs(n)]
    zeros = [zero_offset(n, j, start) for j in range(n) for start in ZERO_STARTS]
    return [*flips, *swaps, *zeros]


def arm_candidates(n: int) -> list[FaultCandidate]:
    """Shifted inertials, wrong rates, and bases turned."""
    rates = [wrong_rate(n, amount) for amount in RATE_STARTS]
    return [*inertial_candidates(n), *rates, *turned_bases(n)]


def turned_bases(n: int) -> list[FaultCandidate]:
    """Arms that hang, or are mounted sideways.

    No faults: a turned base is an effect, ``base_tilt``, which the search finds. Here it competes with the faults that
    look like it: all torques turned are gravity turned, but for friction and inertia.
    """
    half, quarter = np.pi, np.pi / 2
    turns = [
        (half, 0.0),
        (quarter, 0.0),
        (-quarter, 0.0),
        (0.0, quarter),
        (0.0, -quarter),
    ]
    return [turned_base(n, *turn) for turn in turns]


def turned_base(n: int, roll: float, pitch: float) -> FaultCandidate:
    """A base turned by roll and pitch [rad]."""
    return FaultCandidate(TURNED_BASE, (), "", turned(n, roll, pitch))


def inertial_candidates(n: int) -> list[FaultCandidate]:
    """Inertials one link off either way, among all links or among those that a joint moves."""
    return [
        FaultCandidate(
            "shifted_inertials",
            (),
            "",
            shifted(n, -by, moved_only),
            {"by": (float(by),)},
        )
        for moved_only in (False, True)
        for by in (1, -1)
    ]


def unit_candidates(
    arm: NominalArm, samples: FaultSamples, mapping: ChannelMapping
) -> list[FaultCandidate]:
    """Degrees on each joint, all, and those that move too far; revolutions on all; motor side on those too far."""
    n = arm.n_joints
    far = joints_beyond_range(arm, samples, mapping)
    turning = tuple(j for j in range(n) if not arm.sliding[j])
    in_degrees = {(j,) for j in turning} | ({turning} if turning else set())
    on_motor_side: set[tuple[int, ...]] = set()
    # joints that travel too far probably share one cause
    if far:
        in_degrees |= {tuple(j for j in far if j in turning)} - {()}
        on_motor_side.add(far)
    if len(far) < FEW_FAR_JOINTS:
        on_motor_side |= {(j,) for j in far}
    found = [degrees(n, joints) for joints in sorted(in_degrees)]
    if turning:
        found.append(revolutions(n, turning))
    for joints in sorted(on_motor_side):
        found += [
            motor_side(n, joints, (ratio,) * len(joints)) for ratio in GEAR_RATIO_STARTS
        ]
    return found


def joints_beyond_range(
    arm: NominalArm, samples: FaultSamples, mapping: ChannelMapping
) -> tuple[int, ...]:
    """Joints, from 0, that travel more than a turn, or farther than their limits in the URDF are apart."""
    q, _, _ = mapping.motion(samples.q, samples.dq, samples.ddq)
    travel = np.ptp(q, axis=0)
    lower, upper = RigidBody(arm).position_limits()
    # a slide may travel as far as its limits allow
    most = np.where(arm.sliding, np.inf, 1.05 * TURN)
    allowed = np.minimum(upper - lower, most)
    return tuple(int(j) for j in np.flatnonzero(travel > allowed))


def degrees(n: int, joints: tuple[int, ...]) -> FaultCandidate:
    """Positions of joints, from 0, in degrees."""
    return FaultCandidate(
        "unit_mismatch", _from_one(joints), "degrees", scaled(n, joints, DEGREE)
    )


def revolutions(n: int, joints: tuple[int, ...]) -> FaultCandidate:
    """Positions of joints, from 0, in revolutions."""
    mapping = scaled(n, joints, TURN)
    return FaultCandidate("unit_mismatch", _from_one(joints), "revolutions", mapping)


def motor_side(
    n: int, joints: tuple[int, ...], ratios: tuple[float, ...]
) -> FaultCandidate:
    """Positions and torques of joints, from 0, on the motor's side of gears with these ratios [1]."""
    motion_factor, torque_factor = [1.0] * n, [1.0] * n
    for joint, ratio in zip(joints, ratios, strict=True):
        motion_factor[joint] = 1.0 / ratio
        torque_factor[joint] = ratio
    mapping = replace(
        ChannelMapping.identity(n),
        motion_factor=tuple(motion_factor),
        torque_factor=tuple(torque_factor),
    )
    values = {"ratio": tuple(ratios)}
    return FaultCandidate(
        "unit_mismatch", _from_one(joints), "motor_side", mapping, values
    )


def zero_offset(n: int, joint: int, offset: float) -> FaultCandidate:
    """Positions of a joint, from 0, recorded with an angle [rad] beyond the true ones."""
    values = {"offset": (offset,)}
    mapping = offset_by(n, joint, -offset)
    return FaultCandidate("zero_offset", (joint + 1,), "", mapping, values)


def wrong_rate(n: int, amount: float) -> FaultCandidate:
    """Stamps made with ``amount`` times the true period [1]."""
    return FaultCandidate(
        "time_stamps", (), "wrong_rate", timed(n, 1.0 / amount), {"amount": (amount,)}
    )


def _pairs(n: int) -> list[tuple[int, int]]:
    """Pairs of joints, from 0, the smaller number first."""
    return [(i, j) for j in range(n) for i in range(j)]


def _from_one(joints: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(j + 1 for j in joints)


def _flip(n: int, joint: int, channel: str) -> FaultCandidate:
    return FaultCandidate(
        "sign_flip", (joint + 1,), channel, flipped(n, joint, channel)
    )


def _swap(n: int, pair: tuple[int, int], channel: str) -> FaultCandidate:
    return FaultCandidate(
        "joint_swap", _from_one(pair), channel, swapped(n, pair, channel)
    )
