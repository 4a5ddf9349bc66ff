"""Joints of a robot file beside the arm's: where they are locked, and those that follow a joint of the arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.description import SEVERAL, Description, Joint, Mimic
from gapscope.arm.dynamics.robot_file import arm_model
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import nearest

NAMED = 6
"""Joints that a note names; the others are counted."""


@dataclass(frozen=True)
class LockedJoints:
    """What becomes of the joints that are none of the arm's.

    Attributes:
        positions: where those stand that do not stand at zero, and those that follow one of the arm's [rad or m].
        armature: inertia that joints which follow the arm's add to these [kg m^2 or kg], shape (n,).
        notes: what was assumed, a sentence each.
    """

    positions: dict[str, float]
    armature: np.ndarray
    notes: tuple[str, ...]


def lock(
    tree: Description, joints: Sequence[str], given: Mapping[str, float]
) -> LockedJoints:
    """Lock all joints of a file but the arm's.

    A joint that follows another one is locked where that one puts it. If it follows a joint of the arm, it is locked
    where that joint's zero puts it, and its inertia counts on that joint as armature, m^2 M_ff + 2 m M_fj with the
    multiplier m and the mass matrix M at zero; the change of its gravity torque is left out.

    Args:
        tree: joints of the file.
        joints: names of the arm's joints.
        given: positions of locked joints [rad or m].

    Raises:
        InputError: a position is given of a joint that does not exist, or that is one of the arm's.
    """
    single = tree.single
    for name in given:
        _check_name(name, single, joints, tree.file)
    positions = {
        name: float(given[name]) if name in given else _followed(name, single, given)
        for name in single
        if name not in joints
    }
    followers = _followers(single, joints, given)
    positions = {
        name: value
        for name, value in positions.items()
        if value != 0 or name in followers
    }
    armature = _reflected(tree.file, joints, positions, followers)
    notes = (*_notes(tree, joints, given), *_follower_notes(followers, tree.file))
    return LockedJoints(positions, armature, notes)


def _check_name(
    name: str, single: Mapping[str, Joint], joints: Sequence[str], path: Path
) -> None:
    if name in joints:
        raise InputError(
            f"{name} is one of the arm's joints, and locked",
            "take it out of locked:, or out of joints: or chain:",
            file=path,
            where="field locked",
        )
    if name not in single:
        raise InputError(
            f"has no movable joint {name!r}",
            f"{nearest(name, single)}it has {', '.join(single)}",
            file=path,
            where="field locked",
        )


def _chain_of_masters(name: str, single: Mapping[str, Joint]) -> Mimic:
    """The joint that one follows at last, with the multiplier and the offset of all between; itself if it does not."""
    last, multiplier, offset = name, 1.0, 0.0
    for _ in single:
        joint = single.get(last)
        if joint is None or joint.mimic is None:
            break
        offset += multiplier * joint.mimic.offset
        multiplier *= joint.mimic.multiplier
        last = joint.mimic.master
    return Mimic(last, multiplier, offset)


def _followed(
    name: str, single: Mapping[str, Joint], given: Mapping[str, float]
) -> float:
    """Position [rad or m] of a joint that is not given: where its master puts it, which stands at zero if not given."""
    rule = _chain_of_masters(name, single)
    return rule.multiplier * float(given.get(rule.master, 0.0)) + rule.offset


def _followers(
    single: Mapping[str, Joint], joints: Sequence[str], given: Mapping[str, float]
) -> dict[str, Mimic]:
    """Joints that follow a joint of the arm, unless they are one, or a position is given of them."""
    free = [name for name in single if name not in joints and name not in given]
    rules = {name: _chain_of_masters(name, single) for name in free}
    return {name: rule for name, rule in rules.items() if rule.master in joints}


def _reflected(
    path: Path,
    joints: Sequence[str],
    positions: Mapping[str, float],
    followers: Mapping[str, Mimic],
) -> np.ndarray:
    """Inertia of the followers on their masters [kg m^2 or kg], shape (n,)."""
    added = np.zeros(len(joints))
    if not followers:
        return added
    model = arm_model(path, (*joints, *followers), np.zeros(3), positions)
    posture = pin.neutral(model)
    for name in followers:
        posture[model.joints[model.getJointId(name)].idx_q] = positions[name]
    mass = pin.crba(model, model.createData(), posture)
    mass = np.triu(mass) + np.triu(mass, 1).T
    column = {name: model.joints[model.getJointId(name)].idx_v for name in model.names}
    for name, rule in followers.items():
        own, master = column[name], column[rule.master]
        m = rule.multiplier
        added[list(joints).index(rule.master)] += (
            m**2 * mass[own, own] + 2 * m * mass[own, master]
        )
    return np.maximum(added, 0.0)


def _notes(
    tree: Description, joints: Sequence[str], given: Mapping[str, float]
) -> tuple[str, ...]:
    """Joints locked at zero that count: those that the arm carries, and those that carry the arm."""
    moved, carriers = tree.moved(joints), tree.carriers(joints)
    silent, fixed = [], []
    for joint in tree.joints:
        # a slide that carries the arm moves it without turning it against gravity
        mounts = joint.name in carriers and joint.kind != "prismatic"
        if joint.name in joints or not (joint.child in moved or mounts):
            continue
        if joint.kind in SEVERAL:
            fixed.append(joint.name or f"the joint of {joint.child}")
        elif joint.moves and joint.name not in given:
            silent.append(joint.name)
    notes = []
    if silent:
        notes.append(
            f"{tree.file}: locked at zero: {_listed(silent)}; if one stood elsewhere, say so in locked: of the case"
        )
    if fixed:
        notes.append(
            f"{tree.file}: fixed as the file draws it, for it has several degrees of freedom: {_listed(fixed)}"
        )
    return tuple(notes)


def _listed(names: Sequence[str]) -> str:
    """Names, the first few if there are many."""
    rest = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {rest} more" if rest > 0 else "")


def _follower_notes(followers: Mapping[str, Mimic], path: Path) -> tuple[str, ...]:
    return tuple(
        f"{path}: {name} follows {rule.master}: its inertia counts there as armature, its change of gravity torque "
        "is left out"
        for name, rule in followers.items()
    )
