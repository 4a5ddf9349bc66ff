"""The setup faults that may be in a case: each with the reading of the recordings that puts it right."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.setup_faults.channel_mapping import (
    ChannelMapping,
    flipped,
    scaled,
    shifted,
    swapped,
    timed,
)
from gapscope.diagnosis.setup_faults.fault_samples import Samples
from gapscope.diagnosis.thresholds import FEW_FAR_JOINTS, GEAR_RATIO_STARTS, RATE_STARTS

DEGREE = np.pi / 180
TURN = 2 * np.pi


@dataclass(frozen=True)
class Candidate:
    """A setup fault with its values, and how to read recordings that have it.

    Attributes:
        name: name of the fault, a key of ``gapscope.effects.setup_faults.fault_catalogue.FAULTS``.
        joints: from 1; empty for the whole arm.
        variant: which channel, unit or kind; empty where the fault has only one.
        reading: puts it right.
        values: its continuous parameters by name, one per joint or one for the arm.
    """

    name: str
    joints: tuple[int, ...]
    variant: str
    reading: ChannelMapping
    values: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


def of_torque(n: int) -> list[Candidate]:
    """Faults of the torque alone, which leave the predicted torque as it is.

    Two flips are tried together: each may hide the other, since links share their inertials.
    """
    flips = [_flip(n, j, "torque") for j in range(n)]
    both = [
        Candidate(a.name, a.joints + b.joints, a.variant, a.reading.then(b.reading))
        for a, b in itertools.combinations(flips, 2)
    ]
    swaps = [_swap(n, (i, j), "torque") for j in range(n) for i in range(j)]
    every = tuple(range(1, n + 1))
    columns = tuple(range(n))
    turned = ChannelMapping(columns, (1.0,) * n, columns, (-1.0,) * n)
    return [*flips, *both, *swaps, Candidate("sign_flip", every, "torque", turned)]


def of_motion(n: int) -> list[Candidate]:
    """Flips and swaps of positions, with the torque or without."""
    flips = [
        _flip(n, j, channel) for j in range(n) for channel in ("position", "joint")
    ]
    return [*flips, *(_swap(n, (i, j), "joint") for j in range(n) for i in range(j))]


def of_arm(n: int) -> list[Candidate]:
    """Shifted inertials and wrong rates."""
    return [*of_inertials(n), *(wrong_rate(n, amount) for amount in RATE_STARTS)]


def of_inertials(n: int) -> list[Candidate]:
    """Inertials one link off either way, among all links or among those that a joint moves."""
    return [
        Candidate(
            "shifted_inertials",
            (),
            "",
            shifted(n, -by, moved_only),
            {"by": (float(by),)},
        )
        for moved_only in (False, True)
        for by in (1, -1)
    ]


def of_units(
    arm: NominalArm, samples: Samples, reading: ChannelMapping
) -> list[Candidate]:
    """Degrees on each joint, all, and those that move too far; motor side on the latter, together and alone."""
    n = arm.n_joints
    every = tuple(range(n))
    sets = {every, *((j,) for j in every)}
    far = too_far(arm, samples, reading)
    if far:
        sets.add(far)
    found = [degrees(n, joints) for joints in sorted(sets)]
    for joints in sorted(
        {far, *((j,) for j in far if len(far) < FEW_FAR_JOINTS)} - {()}
    ):
        found += [
            motor_side(n, joints, (ratio,) * len(joints)) for ratio in GEAR_RATIO_STARTS
        ]
    return found


def too_far(
    arm: NominalArm, samples: Samples, reading: ChannelMapping
) -> tuple[int, ...]:
    """Joints, from 0, that travel more than a turn, or farther than their limits in the URDF are apart."""
    travel = np.ptp(reading.motion(samples.q, samples.dq, samples.ddq)[0], axis=0)
    lower, upper = RigidBody(arm).position_limits()
    allowed = np.minimum(upper - lower, 1.05 * TURN)
    return tuple(int(j) for j in np.flatnonzero(travel > allowed))


def degrees(n: int, joints: tuple[int, ...]) -> Candidate:
    """Positions of joints, from 0, in degrees."""
    return Candidate(
        "unit_mismatch",
        tuple(j + 1 for j in joints),
        "degrees",
        scaled(n, joints, DEGREE),
    )


def motor_side(n: int, joints: tuple[int, ...], ratios: tuple[float, ...]) -> Candidate:
    """Positions and torques of joints, from 0, on the motor's side of gears with these ratios [1]."""
    motion, torque = np.ones(n), np.ones(n)
    motion[list(joints)] = 1.0 / np.array(ratios)
    torque[list(joints)] = ratios
    columns = tuple(range(n))
    reading = ChannelMapping(
        columns, tuple(map(float, motion)), columns, tuple(map(float, torque))
    )
    return Candidate(
        "unit_mismatch",
        tuple(j + 1 for j in joints),
        "motor_side",
        reading,
        {"ratio": tuple(ratios)},
    )


def wrong_rate(n: int, amount: float) -> Candidate:
    """Stamps made with ``amount`` times the true period [1]."""
    return Candidate(
        "time_stamps", (), "wrong_rate", timed(n, 1.0 / amount), {"amount": (amount,)}
    )


def _flip(n: int, joint: int, channel: str) -> Candidate:
    return Candidate("sign_flip", (joint + 1,), channel, flipped(n, joint, channel))


def _swap(n: int, pair: tuple[int, int], channel: str) -> Candidate:
    return Candidate(
        "joint_swap", (pair[0] + 1, pair[1] + 1), channel, swapped(n, pair, channel)
    )
