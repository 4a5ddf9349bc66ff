"""What a snippet is written from: the values of each joint and body, and the ends between which they may lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.controller import Controller
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.effect_ranges import EffectRange, EffectRanges
from gapscope.envs.export.joint_drive import joint_drives
from gapscope.envs.export.plain_arm import PlainArm

LEAST_SHARE = 0.01
"""Share of a link's mass that remains at the lower end of a range [1]."""


@dataclass(frozen=True)
class JointValues:
    """What acts on one joint, nominal values and effects together, joint side.

    Attributes:
        name: name of the joint.
        damping: viscous friction [N m s/rad].
        friction: Coulomb friction [N m].
        static_friction: friction at rest, with the Stribeck torque [N m].
        armature: rotor inertia [kg m^2].
        spring_stiffness, spring_rest: of the parallel spring [N m/rad], [rad] of what the encoder reads.
        effort: limit of the commanded torque [N m], infinite if none is known.
        velocity: limit of the velocity [rad/s], infinite if none is known.
        kp, kd: gains of the commanded torque [N m/rad], [N m s/rad]; 0 if the controller is no PD law.
        torque_gain: torque that reaches the joint over the one commanded [1].
        torque_offset: torque that arrives beside it [N m].
        delay: time from a command to its torque [s].
        encoder_offset: what the encoder reads beyond the true position [rad].
    """

    name: str
    damping: float
    friction: float
    static_friction: float
    armature: float
    spring_stiffness: float
    spring_rest: float
    effort: float
    velocity: float
    kp: float
    kd: float
    torque_gain: float
    torque_offset: float
    delay: float
    encoder_offset: float

    @property
    def applied_kp(self) -> float:
        """Torque that reaches the joint over the position's error [N m/rad]."""
        return self.torque_gain * self.kp

    @property
    def applied_kd(self) -> float:
        """Torque that reaches the joint over the velocity's error [N m s/rad]."""
        return self.torque_gain * self.kd

    @property
    def applied_effort(self) -> float:
        """Limit of the torque that reaches the joint [N m]."""
        return self.torque_gain * self.effort


@dataclass(frozen=True)
class BodyRange:
    """How far a moving body may differ from the exported one.

    Attributes:
        name: name of the body.
        mass: lowest and highest mass to be added [kg].
        com: lowest and highest shift of its centre of mass along x, y, z of the link [m], (3, 2).
    """

    name: str
    mass: tuple[float, float]
    com: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class SnippetArm:
    """An arm for a snippet.

    Attributes:
        plain: its bodies and drives.
        joints: its joints, in the order of the case.
        low, high: the same at the ends of the ranges, or ``None`` without ranges.
        bodies: bodies that have a range.
        ranges: what both come from, or ``None``.
    """

    plain: PlainArm
    joints: tuple[JointValues, ...]
    low: tuple[JointValues, ...] | None = None
    high: tuple[JointValues, ...] | None = None
    bodies: tuple[BodyRange, ...] = ()
    ranges: EffectRanges | None = None

    def varies(self, name: str) -> bool:
        """Whether a value of any joint has a range."""
        return any(low < high for low, high in self.ends(name).values())

    def ends(self, name: str) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each joint, by its name; twice the value without ranges."""
        low, high = self.low or self.joints, self.high or self.joints
        return {
            a.name: (getattr(a, name), getattr(b, name))
            for a, b in zip(low, high, strict=True)
        }


def snippet_arm(
    plain: PlainArm, controller: Controller | None, ranges: EffectRanges | None
) -> SnippetArm:
    """The values of an arm, and their ends.

    Args:
        plain: the arm.
        controller: that of the case; its gains if it is a PD law.
        ranges: of the effects, within what the data sheet allows, or ``None``.

    Raises:
        InputError: friction or armature is negative in total.
    """
    corrected = plain.corrected
    joints = _joints(plain, corrected, controller)
    if ranges is None:
        return SnippetArm(plain, joints)
    low, high = (
        _joints(plain, _moved(corrected, ranges, side), controller)
        for side in ("low", "high")
    )
    return SnippetArm(plain, joints, low, high, _bodies(plain, ranges), ranges)


def _joints(
    plain: PlainArm, corrected: CorrectedArm, controller: Controller | None
) -> tuple[JointValues, ...]:
    """The values of the joints with the effects of an arm."""
    drives = joint_drives(corrected, plain.body)
    pd = controller is not None and controller.kind == "pd"
    gains = [getattr(controller, x) if pd else np.zeros(len(drives)) for x in _GAINS]
    joints = []
    for j, (name, drive) in enumerate(drives.items()):
        kp, kd = (float(values[j]) for values in gains)
        joints.append(
            JointValues(
                name=name,
                damping=drive.damping,
                friction=drive.friction,
                static_friction=drive.friction + drive.stribeck.torque,
                armature=drive.armature,
                spring_stiffness=drive.stiffness,
                spring_rest=drive.rest,
                effort=np.inf if drive.effort is None else drive.effort,
                velocity=np.inf if drive.velocity is None else drive.velocity,
                kp=kp,
                kd=kd,
                torque_gain=1.0 + drive.scale,
                torque_offset=drive.offset,
                delay=drive.delay,
                encoder_offset=drive.zero,
            )
        )
    return tuple(joints)


_GAINS = ("kp", "kd")
"""Gains of a PD law."""


def _moved(
    corrected: CorrectedArm,
    ranges: EffectRanges,
    side: str,
    only: Sequence[str] | None = None,
) -> CorrectedArm:
    """The arm with the effects at one side of their ranges, all parameters or only some."""
    ends = {item.key: getattr(item, side) for item in ranges.ranges}
    kept = [e for e in corrected.effects if _key(e) not in ends]
    moved = list(ends.values())
    if only is not None:
        own = {_key(e): e.parameters for e in corrected.effects}
        moved = [
            AppliedEffect(
                end.name,
                end.joints,
                {k: end.parameters[k] if k in only else v for k, v in own[key].items()},
            )
            for key, end in ends.items()
            if key in own
        ]
    return replace(corrected, effects=(*kept, *moved), residual=None)


def _key(applied: AppliedEffect) -> tuple[str, int]:
    return EffectRange(applied, applied).key


def _bodies(plain: PlainArm, ranges: EffectRanges) -> tuple[BodyRange, ...]:
    """The bodies that payload and link errors leave open."""
    changes = tuple(r for r in ranges.ranges if r.low.name in _OF_BODIES)
    if not changes:
        return ()
    ranges = EffectRanges(changes)
    mass, moment = _moments(plain, plain.corrected)
    ends = ("low", "high")
    heavier = [_moments(plain, _moved(plain.corrected, ranges, x))[0] for x in ends]
    shifted = [
        _moments(plain, _moved(plain.corrected, ranges, x, only=("com",)))[1]
        for x in ends
    ]
    added = np.sort(np.array(heavier) - mass, axis=0)
    added = np.maximum(added, (LEAST_SHARE - 1.0) * mass)
    centres = np.sort((np.array(shifted) - moment) / mass[:, None], axis=0)
    return tuple(
        BodyRange(
            plain.body_name(joint),
            (float(added[0, j]), float(added[1, j])),
            tuple((float(a), float(b)) for a, b in centres[:, j].T),
        )
        for j, joint in enumerate(plain.corrected.arm.joints)
        if np.ptp(added[:, j]) > 0 or np.ptp(centres[:, j], axis=0).any()
    )


_OF_BODIES = ("payload", "link_inertia")
"""Effects that change bodies."""


def _moments(plain: PlainArm, corrected: CorrectedArm) -> tuple[np.ndarray, np.ndarray]:
    """Mass [kg], (n,), and first moment [kg m], (n, 3), of what each joint moves."""
    own = plain.nominal.inertial_parameters().reshape(-1, 10)
    total = own + corrected.inertial_increments(plain.nominal)
    return total[:, 0], total[:, 1:4]
