"""A law of the generator: how a cause is drawn, sized, put into the true arm and written into the label."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gapscope.blind_check.generator.arms import Arm
from gapscope.blind_check.generator.true_arm import TrueArm

LawValues = dict[str, Any]
"""Values of a law by name, arrays once they are those of a cause."""


@dataclass(frozen=True)
class LawContext:
    """What a law may use when it draws, n joints.

    Attributes:
        arm: the arm.
        deviation, peak: standard deviation and largest size of the nominal torque on the held-out motion [N m], (n,).
        speed: RMS speed on it [rad/s], (n,).
        inertia: mean diagonal of the mass matrix, link side [kg m^2], (n,).
        swing: range of each joint on it [rad], (n,).
        middle: middle of that range [rad], (n,).
        tip: path of the tip on all motions [m], (M, 3).
        shortest: duration of the shortest recording [s].
        encoder_step: of the data sheet [rad].
    """

    arm: Arm
    deviation: np.ndarray
    peak: np.ndarray
    speed: np.ndarray
    inertia: np.ndarray
    swing: np.ndarray
    middle: np.ndarray
    tip: np.ndarray
    shortest: float
    encoder_step: float


class Draws:
    """What a cause is drawn from, on k joints: what is said of each joint is of those alone, (k,).

    Args:
        rng: source of random numbers.
        whole: the context of all joints.
        joints: from 0, (k,).

    Attributes:
        deviation, peak, speed, inertia, swing, middle: of the context.
        armature, coulomb, viscous: of the data sheet [kg m^2, N m, N m s/rad].
        encoder_step: of the context.
    """

    def __init__(
        self, rng: np.random.Generator, whole: LawContext, joints: np.ndarray
    ) -> None:
        self.rng, self.whole, self.joints, arm = rng, whole, joints, whole.arm
        self.deviation, self.peak = whole.deviation[joints], whole.peak[joints]
        self.speed, self.inertia = whole.speed[joints], whole.inertia[joints]
        self.swing, self.middle = whole.swing[joints], whole.middle[joints]
        self.armature, self.coulomb = arm.armature[joints], arm.coulomb[joints]
        self.viscous = arm.viscous[joints]
        self.encoder_step = whole.encoder_step

    def uniform(self, low: float, high: float) -> np.ndarray:
        """Even between two numbers, of each joint, (k,)."""
        return self.rng.uniform(low, high, len(self.joints))

    def common(self, low: float, high: float) -> np.ndarray:
        """Even between two numbers, the same of all joints, (k,)."""
        return np.full(len(self.joints), self.rng.uniform(low, high))

    def whole_number(self, low: int, high: int) -> np.ndarray:
        """From one whole number to another, of each joint, (k,)."""
        return self.rng.integers(low, high + 1, len(self.joints)).astype(float)

    def angle(self) -> np.ndarray:
        """Even over a turn, of each joint [rad], (k,)."""
        return self.uniform(-np.pi, np.pi)

    def sign(self) -> np.ndarray:
        """Plus or minus one, (k,)."""
        return self.rng.choice([-1.0, 1.0], len(self.joints))


Draw = Callable[[Draws], LawValues]
Act = Callable[[TrueArm, np.ndarray, LawValues], None]


class Law(NamedTuple):
    """One law.

    Attributes:
        name: name of the effect that it generates; outside the catalogue, its own name.
        draw: values at a first guess of the size.
        act: puts the values into the true arm, if more has to be done than filling in fields.
        puts, adds: fields of the joints that become, or grow by, which value.
        units: unit of each value that the label gives.
        powers: of the factor by which a cause is sized, for each value that grows or shrinks with it [1]; by default
            1 for the first value that the label gives.
        joints: ``some``, ``one``, ``inner`` (one, neither the first nor the last two), ``middle`` (some, neither the
            first nor the last), ``pair`` or ``arm``.
        largest: largest size of a value that is believable; the smallest, as a negative number, if it shrinks.
        own: whether each joint's size shows in that joint's torque, so that joints are sized one by one.
        measure: what the severity is read from: ``torque``, ``step`` (over the data sheet's), or ``none``.
        outside: whether the law is outside the catalogue.
        recovery: whether the diagnosis explains it by this very law, as an effect of a user.
        form: one phrase on how its form differs from the catalogue's.
    """

    name: str
    draw: Draw
    act: Act | None = None
    units: Mapping[str, str] = {}
    puts: Mapping[str, str] = {}
    adds: Mapping[str, str] = {}
    powers: Mapping[str, float] | None = None
    joints: str = "some"
    largest: Mapping[str, float] = {}
    own: bool = True
    measure: str = "torque"
    outside: bool = False
    recovery: bool = False
    form: str = ""

    def cause(
        self, rng: np.random.Generator, whole: LawContext, joints: np.ndarray
    ) -> Cause:
        """It at work on some joints, counted from 0, with values that are drawn."""
        drawn = self.draw(Draws(rng, whole, joints)).items()
        return Cause(self, joints, {name: np.asarray(x) for name, x in drawn})


class Cause(NamedTuple):
    """A law with values, at work on some joints.

    Attributes:
        law: the law.
        joints: joints from 0; empty for what acts on the arm.
        values: its values, one per joint or as the law has them.
    """

    law: Law
    joints: np.ndarray
    values: LawValues

    def sized(self, factor: np.ndarray) -> Cause:
        """The same cause with its size times a factor per joint, or, of what belongs to the arm, the largest one."""
        changed, powers = dict(self.values), self.law.powers
        if powers is None:
            powers = dict.fromkeys(list(self.law.units)[:1], 1)
        for name, power in powers.items():
            own = factor if factor.shape == changed[name].shape else factor.max()
            grown = own ** abs(power)
            changed[name] = (
                changed[name] * grown if power > 0 else changed[name] / grown
            )
        return self._replace(values=changed)

    def believable(self) -> bool:
        """Whether every value is within what its law allows."""
        for name, bound in self.law.largest.items():
            size = np.abs(self.values[name])
            too_far = size > bound if bound > 0 else size < -bound
            if too_far.any():
                return False
        return True

    def act(self, plant: TrueArm) -> None:
        """Put it into the true arm."""
        for field, name in self.law.puts.items():
            plant.put(field, self.joints, self.values[name])
        for field, name in self.law.adds.items():
            plant.add(field, self.joints, self.values[name])
        if self.law.act is not None:
            self.law.act(plant, self.joints, self.values)

    def label(self) -> dict[str, Any]:
        """The entry of a label: names and units of the catalogue, joints from 1."""
        parameters = {
            name: {"unit": unit, "value": self.values[name].tolist()}
            for name, unit in self.law.units.items()
        }
        joints = (self.joints + 1).tolist()
        if self.law.outside:
            kind = {"effect": "unknown", "kind": self.law.name}
            return {**kind, "joints": joints, "parameters": parameters}
        label = {"effect": self.law.name, "joints": joints, "parameters": parameters}
        return {**label, "recovery": True} if self.law.recovery else label
