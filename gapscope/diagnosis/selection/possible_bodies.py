"""Whether loads and changes of links that a search fits leave bodies that can be."""

from __future__ import annotations

from collections.abc import Iterable

from gapscope.arm.dynamics.plain_urdf import check_inertia
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm


def feeds_energy(
    arm: NominalArm, body: RigidBody, effects: Iterable[AppliedEffect]
) -> bool:
    """Whether effects turn bodies of positive kinetic energy into bodies that have none, or a negative one.

    A payload below zero takes mass from the last link at a point; with it may go more inertia than the link has.
    """
    changed = CorrectedArm(arm, tuple(effects)).body(body)
    return not _movable(changed) and _movable(body)


def _movable(body: RigidBody) -> bool:
    try:
        check_inertia(body)
    except InputError:
        return False
    return True
