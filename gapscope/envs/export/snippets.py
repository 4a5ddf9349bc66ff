"""The corrected arm in the words of a simulator: joints, actuators and what to draw at random, to be pasted.

A snippet is written from the values of each joint and body, and the ends between which they may lie.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from gapscope.arm.controller import Controller
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import LinkChange
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.export.plain_arm import (
    TARGETS,
    PlainArm,
    joint_drives,
    rendered,
)

MIN_SHARE = 0.01
"""Share of a link's mass that remains at the lower end of a range [1]."""


class BodyRange(NamedTuple):
    """How far a moving body may differ from the exported one.

    Attributes:
        name: name of the body.
        mass: lowest and highest mass to be added [kg].
        com: lowest and highest shift of its centre of mass along x, y, z of the link [m], (3, 2).
    """

    name: str
    mass: tuple[float, float]
    com: tuple[tuple[float, float], ...]


class SnippetArm(NamedTuple):
    """An arm for a snippet.

    Attributes:
        plain: its bodies and drives.
        values: drives of its joints, see ``joint_drives``, with name, gains kp [N m/rad] and kd [N m s/rad] of the
            commanded torque (0 if the controller is no PD law), dry friction at rest [N m], torque that arrives over
            the one commanded (gain), and what arrives of gains and effort.
        low, high: the same at the ends of the ranges; the values themselves without ranges.
        bodies: bodies that have a range.
        ranges: what both come from, or ``None``.
    """

    plain: PlainArm
    values: pd.DataFrame
    low: pd.DataFrame
    high: pd.DataFrame
    bodies: tuple[BodyRange, ...] = ()
    ranges: EffectRanges | None = None

    @property
    def joints(self) -> list[Any]:
        """A record of each joint's values, in the order of the case."""
        return list(self.values.itertuples(index=False))

    def ends(self, name: str) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each joint, by its name; twice the value without ranges."""
        pairs = zip(self.low[name].tolist(), self.high[name].tolist(), strict=True)
        return dict(zip(self.values.index, pairs, strict=True))

    def ranged(self, name: str) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of the joints that have a range."""
        ends = self.ends(name).items()
        return {joint: (low, high) for joint, (low, high) in ends if low < high}

    def table(self, joint: str, names: Mapping[str, str]) -> dict[str, float]:
        """Some values of a joint under other names, those that are finite."""
        row = self.values.loc[joint]
        return {key: row[name] for key, name in names.items() if np.isfinite(row[name])}

    def ranges_of(
        self, names: Mapping[str, str]
    ) -> dict[str, dict[str, tuple[float, float]]]:
        """By joint the ranges of some of its values, under other names."""
        found: dict[str, dict[str, tuple[float, float]]] = {}
        for key, name in names.items():
            for joint, ends in self.ranged(name).items():
                found.setdefault(joint, {})[key] = ends
        return found

    def factors(self, *names: str) -> dict[str, tuple[float, float]]:
        """Lowest and highest factor of some values of each joint together, of the joints that have a range.

        A value that is zero has no factor.
        """
        own = self.values[list(names)]
        # factors about the exported value, where there is one
        sides = [
            (side[own.columns] / own).where(own > 0) for side in (self.low, self.high)
        ]
        # 1 is among them: the exported arm lies within the range
        ratios = pd.concat([*sides, pd.Series(1.0, own.index)], axis=1)
        ends = zip(own.index, ratios.min(axis=1), ratios.max(axis=1), strict=True)
        return {joint: (low, high) for joint, low, high in ends if low < high}

    def column(self, name: str, joints: Sequence[str]) -> dict[str, float]:
        """A value of some joints, if it is finite."""
        values = self.values.loc[list(joints), name]
        return dict(values[np.isfinite(values)])

    def groups(self, name: str) -> dict[tuple[float, float], list[str]]:
        """Joints by the lowest and highest of a value, in the order of the first of each group."""
        groups: dict[tuple[float, float], list[str]] = {}
        for joint, ends in self.ends(name).items():
            groups.setdefault(ends, []).append(joint)
        return groups

    @property
    def added_mass(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest mass to be added by body [kg]."""
        return {body.name: body.mass for body in self.bodies}

    @property
    def gains(self) -> dict[str, float]:
        """Torque that arrives over the one commanded, of joints at which they differ [1]."""
        gain = self.values["gain"]
        return dict(gain[gain != 1.0])


def _joints(
    plain: PlainArm, corrected: CorrectedArm, controller: Controller | None
) -> pd.DataFrame:
    """The values of the joints with the effects of an arm; see ``SnippetArm``."""
    drives = joint_drives(corrected, plain.body)
    # gains of another law have other units: 0 says that there are none
    law = controller is not None and controller.kind == "pd"
    kp, kd = (getattr(controller, x) if law else 0.0 for x in ("kp", "kd"))
    gain = 1.0 + drives["scale"]
    return drives.assign(
        name=drives.index,
        kp=kp,
        kd=kd,
        static_friction=drives["friction"] + drives["breakaway"],
        gain=gain,
        # what arrives, since a simulator with these gains has no scale of the torque
        applied_kp=gain * kp,
        applied_kd=gain * kd,
        applied_effort=gain * drives["effort"],
    )


def _moved(
    corrected: CorrectedArm,
    ranges: EffectRanges,
    side: str,
    only: Sequence[str] | None = None,
) -> CorrectedArm:
    """The arm with the effects at one side of their ranges, all parameters or only some."""
    ends = {item.key: getattr(item, side) for item in ranges.ranges}
    # an effect without a range stays as it is
    kept = [e for e in corrected.effects if e.key not in ends]
    moved = list(ends.values())
    if only is not None:
        own = {e.key: e.parameters for e in corrected.effects}
        # the other parameters at their values: one at a time is moved
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


def _bodies(plain: PlainArm, ranges: EffectRanges) -> tuple[BodyRange, ...]:
    """The bodies that payload and link errors leave open."""
    # changes of links alone: what a drive has is not a body's
    changes = tuple(r for r in ranges.ranges if isinstance(r.low.effect, LinkChange))
    if not changes:
        return ()
    ranges = EffectRanges(changes)
    mass, moment = _moments(plain, plain.corrected)
    ends = ("low", "high")
    heavier = [_moments(plain, _moved(plain.corrected, ranges, x))[0] for x in ends]
    # the mass stays: a shift of the centre is the change of the first moment over it
    shifted = [
        _moments(plain, _moved(plain.corrected, ranges, x, only=("com",)))[1]
        for x in ends
    ]
    # the end with less first, whichever side of the range it came from
    added = np.sort(np.array(heavier) - mass, axis=0)
    # a body keeps some mass, which simulators ask for
    added = np.maximum(added, (MIN_SHARE - 1.0) * mass)
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


def _moments(plain: PlainArm, corrected: CorrectedArm) -> tuple[np.ndarray, np.ndarray]:
    """Mass [kg], (n,), and first moment [kg m], (n, 3), of what each joint moves."""
    own = plain.nominal.inertial_parameters().reshape(-1, 10)
    total = own + corrected.inertial_increments(plain.nominal)
    return total[:, 0], total[:, 1:4]


def snippet(
    plain: PlainArm,
    form: str,
    controller: Controller | None,
    ranges: EffectRanges | None,
) -> str:
    """The snippet of an arm for a simulator, without its head.

    Args:
        plain: the arm.
        form: one of ``TARGETS``.
        controller: that of the case, or ``None``.
        ranges: to be drawn from, or ``None``.

    Raises:
        InputError: friction or armature is negative in total.
    """
    corrected = plain.corrected
    # without ranges both ends are the value
    joints = low = high = _joints(plain, corrected, controller)
    bodies: tuple[BodyRange, ...] = ()
    if ranges is not None:
        low, high = (
            _joints(plain, _moved(corrected, ranges, side), controller)
            for side in ("low", "high")
        )
        # the file of bodies has no ranges: their masses are added on top
        bodies = _bodies(plain, ranges)
    arm = SnippetArm(plain, joints, low, high, bodies, ranges)
    template = f"{form}{'.xml' if TARGETS[form].xml else ''}.j2"
    return rendered(template, arm=arm, joints=arm.joints).lstrip("\n")
