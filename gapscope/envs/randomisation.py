"""Domain randomisation: other effects in every episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, drives_with
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Transmission
from gapscope.effects.severity import draw
from gapscope.envs.arguments import check_values, record_of
from gapscope.envs.effect_ranges import EffectRanges

GIVE = (
    "give a gapscope.envs.randomisation.Randomisation, or the ranges that "
    "gapscope.envs.effect_ranges.read_effect_ranges reads"
)
"""What to do if something else was given."""


@dataclass(frozen=True)
class Randomisation:
    """Which effects are drawn at a reset, where, and how severe.

    Values are those of ``gapscope.effects.severity``, in proportion to the arm, times a severity: 1 is what real
    arms show.

    Attributes:
        names: effects of the catalogue to draw from, one or several.
        joints: joints that joint effects may act on, counted from 1; all if ``None``. Effects on the arm or a link
            (payload, base tilt, external force, link inertia) have no joints and are drawn all the same: leave them
            out of ``names`` if they are not wanted.
        count: fewest and most effects in an episode.
        joint_count: fewest and most joints of one effect.
        severity: lowest and highest severity [1]; a limit or a stiffness is divided by it.

    Raises:
        InputError: an unknown effect, a joint below 1, or a range that is not one.
    """

    names: Sequence[str] | str
    joints: Sequence[int] | None = None
    count: tuple[int, int] = (1, 1)
    joint_count: tuple[int, int] = (1, 2)
    severity: tuple[float, float] = (0.5, 1.0)

    def __post_init__(self) -> None:
        """Check names and ranges; a name may stand alone."""
        # frozen: a single name turns into a sequence before it is checked
        if isinstance(self.names, str):
            object.__setattr__(self, "names", (self.names,))
        check_values(vars(self), "environment", "randomisation", "randomisation.")
        object.__setattr__(self, "names", tuple(self.names))
        for name in self.names:
            check_known("effect", name, sorted(CATALOGUE), where="randomisation.names")
        for name in ("count", "joint_count", "severity"):
            low, high = getattr(self, name)
            if low > high or (name == "count" and high > len(self.names)):
                raise InputError(
                    f"{[low, high]} is no range of so many effects or joints",
                    "give the lowest number first, and no more than there are effects",
                    where=f"randomisation.{name}",
                )


def checked_randomisation(
    randomisation: Randomisation | EffectRanges | None,
) -> Randomisation | EffectRanges | None:
    """What is to be drawn, or ``None`` for nothing.

    Raises:
        InputError: it is something else.
    """
    if randomisation is None or isinstance(randomisation, EffectRanges):
        return randomisation
    return record_of("randomisation", randomisation, Randomisation, GIVE)


def draw_effects(
    rng: np.random.Generator,
    arm: NominalArm,
    wanted: Randomisation | EffectRanges,
    scale: ArmScale,
    given: tuple[AppliedEffect, ...] = (),
) -> tuple[AppliedEffect, ...]:
    """Effects with values, each of the catalogue at most once, and none of those given.

    A joint that becomes elastic or gets play needs a rotor: if neither the data sheet nor the effects have one, it
    comes with it.

    Args:
        rng: source of the effects; the same state gives the same effects, bit by bit.
        arm: the nominal arm.
        wanted: what to draw.
        scale: what is large on this arm.
        given: effects that the arm has anyway.

    Raises:
        InputError: a joint that the arm does not have.
    """
    if isinstance(wanted, EffectRanges):
        drawn = wanted.draw(rng)
    else:
        joints = (
            np.arange(1, arm.n_joints + 1)
            if wanted.joints is None
            else np.array(sorted(set(wanted.joints)))
        )
        if joints.max() > arm.n_joints:
            raise InputError(
                f"joint {joints.max()} of an arm with {arm.n_joints} joints",
                f"use joints from 1 to {arm.n_joints}",
                where="randomisation.joints",
            )
        count = int(rng.integers(wanted.count[0], wanted.count[1], endpoint=True))
        # sorted, so that the draw does not depend on the order in which names were given
        names = rng.choice(sorted(set(wanted.names)), size=count, replace=False)
        drawn = tuple(
            _draw(rng, name, joints, wanted, scale) for name in sorted(names.tolist())
        )
    known = {other.name for other in given}
    drawn = tuple(applied for applied in drawn if applied.name not in known)
    # with the effects, which may bring rotors or joints that need one
    return drawn + _rotors(arm, (*given, *drawn), scale)


def _draw(
    rng: np.random.Generator,
    name: str,
    joints: np.ndarray,
    wanted: Randomisation,
    scale: ArmScale,
) -> AppliedEffect:
    """One effect of a severity drawn."""
    severity = float(rng.uniform(*wanted.severity))
    # no more joints than there are
    low, high = (min(number, len(joints)) for number in wanted.joint_count)
    some = rng.choice(
        joints, size=int(rng.integers(low, high, endpoint=True)), replace=False
    )
    drawn = draw(name, rng, scale, some.tolist())
    # the power is 1 of a size, -1 of a limit or stiffness, 0 of what is no size
    values = {
        p.name: np.clip(drawn.parameters[p.name] * severity**p.severity, *p.bounds)
        for p in drawn.effect.parameters
    }
    return AppliedEffect(name, drawn.joints, values)


def _rotors(
    arm: NominalArm, effects: tuple[AppliedEffect, ...], scale: ArmScale
) -> tuple[AppliedEffect, ...]:
    """Rotors for joints with play or elasticity that have none."""
    flexible = {
        joint
        for applied in effects
        if isinstance(applied.effect, Transmission)
        for joint in applied.joints
    }
    # what the data sheet has counts as well
    inertia = CorrectedArm(arm, effects).quantity("rotor")
    bare = tuple(joint for joint in sorted(flexible) if inertia[joint - 1] <= 0)
    if not bare:
        return ()
    return (drives_with(bare, rotor=scale.rotor[np.array(bare) - 1]),)


class RandomiseEffects(gymnasium.Wrapper):
    """Draws other effects at every reset of an ``ArmTracking`` environment.

    The draw uses the environment's own ``np_random``: one seed gives the same episodes, motions and effects alike.

    Raises:
        InputError: what is to be drawn is no ``Randomisation``.
    """

    def __init__(
        self, env: gymnasium.Env, randomisation: Randomisation | EffectRanges
    ) -> None:
        super().__init__(env)
        checked = checked_randomisation(randomisation)
        if checked is None:
            raise InputError("there is nothing to draw", GIVE, where="randomisation")
        self._randomisation = checked

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset with effects drawn anew; ``options`` go before."""
        # what is asked for in this reset goes before
        return self.env.reset(
            seed=seed, options={"randomisation": self._randomisation} | (options or {})
        )
