"""Domain randomisation: other effects in every episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from arm.errors import InputError
from arm.nearest import check_known
from arm.nominal import NominalArm
from effects.applied import AppliedEffect
from effects.catalogue import CATALOGUE, effect
from effects.corrected import CorrectedArm
from effects.effect import Parameter, Transmission

STRONG = 300.0
"""Torque limit of the joints that typical values belong to [N m]; on a weaker joint they are smaller in proportion."""
SCALED = ("N m", "N m s/rad", "N m/rad", "kg m^2", "kg", "N")
"""Units of parameters that belong to the strength of a joint."""
REVERSED = {("torque_saturation", "limit"), ("joint_elasticity", "stiffness"), ("joint_elasticity", "damping")}
"""Parameters that are the more severe the smaller they are."""
EITHER_SIGN = {
    *(("torque_offset", "torque"), ("torque_scale", "scale"), ("encoder_offset", "offset")),
    *(("base_tilt", "roll"), ("base_tilt", "pitch")),
}
"""Parameters that occur with both signs."""
INCIDENTAL = {
    *(("payload", "com"), ("torque_ripple", "cycles"), ("torque_ripple", "phase"), ("parallel_spring", "rest")),
    *(("stribeck_friction", "velocity"), ("friction_drift", "time_constant")),
    *(("external_force", "start"), ("external_force", "end"), ("link_inertia", "com")),
}
"""Parameters that say where or when, not how severe: drawn evenly from the typical range."""
RANGES = {("torque_saturation", "limit"): (0.3 * STRONG, STRONG)}
"""Ranges in place of the typical one, which here spans arms of all sizes."""


@dataclass(frozen=True)
class Randomisation:
    """Which effects are drawn at a reset, where, and how severe.

    Severity 0 to 1 spans the typical range of a parameter on real arms, in equal ratios where the range lies above
    zero. Torques, friction, rotors, stiffness and masses are those of joints with ``STRONG`` N m; on weaker joints they
    are smaller in proportion to the torque limit.

    Attributes:
        names: effects of the catalogue to draw from.
        joints: joints that may be affected, counted from 1; all where ``None``.
        count: fewest and most effects in an episode.
        joint_count: fewest and most joints of one effect.
        severity: lowest and highest severity [1].

    Raises:
        InputError: an unknown effect, a joint below 1, or a range that is not one.
    """

    names: Sequence[str]
    joints: Sequence[int] | None = None
    count: tuple[int, int] = (1, 1)
    joint_count: tuple[int, int] = (1, 2)
    severity: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        """Check names and ranges."""
        for name in self.names:
            check_known("effect", name, sorted(CATALOGUE), where="randomisation.names")
        if not self.names or (self.joints is not None and (not self.joints or min(self.joints) < 1)):
            raise InputError(
                "there is nothing to draw", "name effects, and joints from 1 on or None", where="randomisation"
            )
        for label, (low, high), least, most in (
            ("count", self.count, 0, len(self.names)),
            ("joint_count", self.joint_count, 1, np.inf),
            ("severity", self.severity, 0, 1),
        ):
            if not least <= low <= high <= most:
                raise InputError(
                    f"{low} .. {high} is no range within {least} .. {most}", where=f"randomisation.{label}"
                )


def draw_effects(
    rng: np.random.Generator,
    arm: NominalArm,
    wanted: Randomisation,
    limit: np.ndarray,
    given: tuple[AppliedEffect, ...] = (),
) -> tuple[AppliedEffect, ...]:
    """Effects with values, each of the catalogue at most once, and none of those given.

    A joint that becomes elastic or gets play needs a rotor: where neither the data sheet nor the effects have one, an
    ``armature`` of middling size comes with it.

    Args:
        rng: source of the effects; the same state gives the same effects, bit by bit.
        arm: the nominal arm.
        wanted: what to draw.
        limit: torque limit of each joint [N m], shape (n,); infinite where there is none.
        given: effects that the arm has anyway.

    Raises:
        InputError: a joint that the arm does not have.
    """
    joints = np.arange(1, arm.n_joints + 1) if wanted.joints is None else np.array(sorted(set(wanted.joints)))
    if joints.max() > arm.n_joints:
        raise InputError(
            f"joint {joints.max()} of an arm with {arm.n_joints} joints",
            f"use joints from 1 to {arm.n_joints}",
            where="randomisation.joints",
        )
    strength = np.minimum(limit / STRONG, 1.0)
    count = int(rng.integers(wanted.count[0], wanted.count[1], endpoint=True))
    names = [str(name) for name in rng.choice(sorted(set(wanted.names)), size=count, replace=False)]
    drawn = tuple(_draw(rng, name, joints, wanted, strength) for name in sorted(names))
    drawn = tuple(applied for applied in drawn if applied.name not in {other.name for other in given})
    return drawn + _rotors(arm, (*given, *drawn), strength)


def _rotors(arm: NominalArm, effects: tuple[AppliedEffect, ...], strength: np.ndarray) -> tuple[AppliedEffect, ...]:
    """Armature for joints with play or elasticity that have none."""
    flexible = {joint for applied in effects if isinstance(applied.effect, Transmission) for joint in applied.joints}
    inertia = CorrectedArm(arm, effects).value("armature", "inertia") + arm.armature
    bare = tuple(joint for joint in sorted(flexible) if inertia[joint - 1] <= 0)
    if not bare:
        return ()
    middling = np.sqrt(np.prod(effect("armature").parameter("inertia").typical))
    return (AppliedEffect("armature", bare, {"inertia": middling * strength[np.array(bare) - 1]}),)


def _draw(
    rng: np.random.Generator, name: str, joints: np.ndarray, wanted: Randomisation, strength: np.ndarray
) -> AppliedEffect:
    """One effect: its joints or its link, one severity, and values of all parameters."""
    definition, some = effect(name), np.array([], dtype=int)
    severity = float(rng.uniform(*wanted.severity))
    if definition.scope == "joint":
        low, high = (min(number, len(joints)) for number in wanted.joint_count)
        some = np.sort(rng.choice(joints, size=int(rng.integers(low, high, endpoint=True)), replace=False))
        strength = strength[some - 1]
    values = {p.name: _value(rng, name, p, severity, strength) for p in definition.parameters}
    if definition.scope != "joint":
        values = {p.name: _of_arm(rng, p, values[p.name]) for p in definition.parameters}
    if definition.scope == "link":
        values["link"] = np.array(float(rng.choice(joints)))
    return AppliedEffect(name, tuple(int(joint) for joint in some), values)


def _value(
    rng: np.random.Generator, name: str, parameter: Parameter, severity: float, strength: np.ndarray
) -> np.ndarray:
    """Value of a parameter per joint, shape of ``strength``, in its unit."""
    key = (name, parameter.name)
    low, high = RANGES.get(key, parameter.typical)
    share = 1.0 - severity if key in REVERSED else severity
    if key in INCIDENTAL:
        return rng.uniform(low, high, np.shape(strength))
    value = np.full(np.shape(strength), low * (high / low) ** share if low > 0 else high * share)
    if key in EITHER_SIGN:
        value = value * rng.choice([-1.0, 1.0], np.shape(strength))
    return value * strength if parameter.unit in SCALED else value


def _of_arm(rng: np.random.Generator, parameter: Parameter, values: np.ndarray) -> np.ndarray:
    """A number for the arm, that of its strongest joint; a vector of this length in a random direction."""
    value = values[np.abs(values).argmax()]
    if parameter.size == 1:
        return np.array(value)
    direction = rng.standard_normal(parameter.size)
    return abs(value) * direction / np.linalg.norm(direction)


class RandomiseEffects(gymnasium.Wrapper):
    """Draws other effects at every reset of an ``ArmTracking`` environment.

    The draw uses the environment's own ``np_random``: one seed gives the same episodes, motions and effects alike.
    """

    def __init__(self, env: gymnasium.Env, randomisation: Randomisation) -> None:
        super().__init__(env)
        self._randomisation = randomisation

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset with effects drawn anew; ``options`` go before."""
        return self.env.reset(seed=seed, options={"randomisation": self._randomisation} | (options or {}))
