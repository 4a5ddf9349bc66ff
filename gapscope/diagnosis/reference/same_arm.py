"""Whether a case and a reference are of the same arm."""

from __future__ import annotations

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.reference.kept_reference import KeptReference
from gapscope.diagnosis.thresholds import SAME_GRAVITY, SAME_JOINT_PLACE


def place_of(reference: Case | KeptReference) -> str:
    """How messages call a reference: by its file, or by its name."""
    return f"--against {reference.file or reference.name}"


def check_same_joints(case: Case, reference: Case | KeptReference) -> None:
    """Check that number, names and order of the joints, coupled motors, and gravity, agree.

    Raises:
        InputError: they do not.
    """
    arm = reference.arm if isinstance(reference, Case) else reference
    place = place_of(reference)
    ours, theirs = list(case.arm.joints), list(arm.joints)
    if len(ours) != len(theirs):
        raise InputError(
            f"has {len(theirs)} joints, {case.name} has {len(ours)}: another robot",
            "give a reference of the same arm",
            where=place,
        )
    if ours != theirs:
        reordered = sorted(ours) == sorted(theirs)
        how = "in another order" if reordered else "with other names"
        raise InputError(
            f"has its joints {how}: {', '.join(theirs)}; {case.name} has {', '.join(ours)}",
            "give a reference of the same arm, with joints: in the order of the case",
            where=place,
        )
    if case.arm.coupled_motors != arm.coupled_motors:
        raise InputError(
            f"has coupled motors {list(arm.coupled_motors)}, {case.name} has {list(case.arm.coupled_motors)}",
            "declare the same coupling in both cases, and identify the reference again",
            where=place,
        )
    if not np.allclose(case.arm.gravity, arm.gravity, atol=SAME_GRAVITY):
        raise InputError(
            f"has gravity {arm.gravity.tolist()}, {case.name} has {case.arm.gravity.tolist()}",
            "give a reference that was recorded in the same mounting, or correct gravity:",
            where=place,
        )


def check_same_places(case: Case, arm: NominalArm, place: str) -> None:
    """Check that the joints of two arms lie in the same places.

    Args:
        case: the case.
        arm: arm of the reference, vendor's or identified; both have the same kinematics.
        place: how messages call the reference.

    Raises:
        InputError: they do not.
    """
    if _joint_distance(case.arm, arm) > SAME_JOINT_PLACE:
        raise InputError(
            "has joints of the same names in other places: another robot, or another version of its URDF",
            "give a reference of the same arm, and both cases the same kinematics",
            where=place,
        )


def check_same_arm(case: Case, reference: Case) -> None:
    """Check that two cases are of the same arm, joint by joint.

    Raises:
        InputError: another number of joints, other names, another order, another gravity, or joints in other places.
    """
    check_same_joints(case, reference)
    check_same_places(case, reference.arm, place_of(reference))


def _joint_distance(one: NominalArm, other: NominalArm) -> float:
    """Largest difference of the joints' places, in any coordinate [m] or entry of the rotation [1]."""
    ours, theirs = RigidBody(one).model, RigidBody(other).model
    largest = 0.0
    for a, b in zip(ours.jointPlacements, theirs.jointPlacements, strict=True):
        moved = np.abs(a.translation - b.translation).max()
        turned = np.abs(a.rotation - b.rotation).max()
        largest = max(largest, float(moved), float(turned))
    return largest
