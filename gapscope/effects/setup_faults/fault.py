"""Setup faults: what is wrong with the set-up, not with the arm; tested before any physics, since they look like it.

A fault is a reading: the one that puts right what a set-up with the fault has recorded. A diagnosis looks for it among
candidates, which are faults with values; recordings with the fault are made by the inverse of its reading. What no
reading brings back, such as stamps off at random, has an ``apply`` of its own.

In files of the form of ``corrected.yaml`` a fault is an entry of ``effects`` with its ``joints``, ``variant`` and
``parameters``, as ``diagnosis.json`` has it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Columns, Reading
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter

Values = float | tuple[float, ...]
"""One value for all joints of a fault, or one for each."""


@dataclass(frozen=True)
class Look:
    """What a case shows under a reading, from which faults tell where they may be, n joints; joints count from 0.

    Attributes:
        reading: how the case is read.
        turning: joints that turn; others slide.
        beyond: joints that travel farther than they can.
        factor: nominal torque over the torque read, (n,) [1], ...
        known: ...and of which joints it is known, (n,).
        has_weight: whether gravity moves any joint of the arm.
        rate_is_known: whether recorded velocities, or a rate put right, settle the clock's rate.
    """

    reading: Reading
    turning: tuple[int, ...]
    beyond: tuple[int, ...]
    factor: np.ndarray
    known: np.ndarray
    has_weight: bool
    rate_is_known: bool

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.factor)


@dataclass(frozen=True)
class Fault:
    """One fault with its values.

    Attributes:
        name: name of the fault.
        scope: ``joint`` or ``arm``.
        looks_like: what gives it away in data.
        reference: source of the convention that the set-up breaks; a key of ``docs/references.md``.
        variants: its kinds, which the field ``variant`` names; empty if there is one only.
        parameters: its parameters, which are fields of the same name.
    """

    name: ClassVar[str]
    scope: ClassVar[str]
    looks_like: ClassVar[str]
    reference: ClassVar[str]
    variants: ClassVar[tuple[str, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = ()

    def __post_init__(self) -> None:
        """Lists of values become tuples; raises ``InputError`` if the variant does not exist."""
        for parameter in self.parameters:
            value = getattr(self, parameter.name)
            if np.ndim(value):
                object.__setattr__(self, parameter.name, tuple(map(float, value)))
        if self.variants:
            variant = getattr(self, "variant")  # noqa: B009 (a field of the subclass)
            check_known("variant", variant, self.variants, where=self.name)

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> Fault:
        """A fault as real set-ups have it, on an arm with n joints."""
        raise NotImplementedError(f"{cls.name} is not drawn")

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """The faults of this kind that may be in a case, continuous values at some starts; none if others find it."""
        return []

    def reading(self, n: int) -> Reading:
        """How recordings with the fault must be read, of n joints; as they are, if nothing brings back what is lost.

        Raises:
            InputError: the fault names a joint that the arm does not have, or has neither one value nor one per joint.
        """
        return Reading.identity(n)

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """The recording as a set-up with this fault would have written it.

        Args:
            recording: a right one.
            rng: source of random numbers.
            arm: the nominal arm, which is also the vendor's model in the driver.

        Raises:
            InputError: the fault names a joint that the recording does not have, or a value is out of bounds.
        """
        self.check()
        return self.reading(recording.n_joints).inverse()(recording, arm)

    def in_case(self, case: Case, rng: np.random.Generator, vendor: NominalArm) -> Case:
        """The case as a set-up with this fault would have written it: recordings, nominal arm and controller.

        Args:
            case: a right one.
            rng: source of random numbers.
            vendor: the arm of the driver's model, which no fault spoils.
        """
        self.check()
        spoil = self.reading(case.arm.n_joints).inverse()
        return replace(
            case,
            recordings=tuple(self.apply(r, rng, vendor) for r in case.recordings),
            arm=spoil.arm(case.arm),
            controller=spoil.controller(case.controller),
        )

    def check(self) -> None:
        """Raise ``InputError`` if a value lies out of bounds; that of a fault which was found may lie anywhere."""
        for parameter in self.parameters:
            value = getattr(self, parameter.name)
            low, high = parameter.bounds
            least, most = parameter.typical
            values = np.atleast_1d(value)
            # written so that nan is refused too
            if not ((values >= low) & (values <= high)).all():
                raise InputError(
                    f"value {value} outside {low:g} .. {high:g}",
                    f"real set-ups have {least:g} .. {most:g}",
                    where=f"{self.name}.{parameter.name}",
                )

    @property
    def kind(self) -> tuple[str, str, tuple[int, ...]]:
        """Name; variant, empty if there is one only; joints, from 1, empty if they are all or the arm."""
        return self.name, getattr(self, "variant", ""), getattr(self, "joints", ())

    def values(self) -> dict[str, tuple[float, ...]]:
        """Values of its parameters by name, one for each of its joints or one for the arm."""
        count = max(len(self.kind[2]), 1)
        named = (parameter.name for parameter in self.parameters)
        return {name: tuple(self.per_joint(name, count).tolist()) for name in named}

    def joined(self, other: Fault) -> Fault:
        """The same fault on its own joints and those of another, in order."""
        joints = np.array(self.kind[2] + other.kind[2])
        order = np.argsort(joints)
        changed: dict[str, Any] = {"joints": tuple(joints[order].tolist())}
        theirs = other.values()
        for name, own in self.values().items():
            changed[name] = tuple(np.array(own + theirs[name])[order].tolist())
        return replace(self, **changed)

    def columns(self, n: int) -> np.ndarray:
        """Columns, from 0, of its joints, all n if it names none; raises ``InputError`` for joints that are not."""
        joints = self.kind[2] or tuple(range(1, n + 1))
        if min(joints) < 1 or max(joints) > n:
            raise InputError(
                f"joints {list(joints)} of an arm with {n} joints",
                f"joints count from 1 to {n} in the case's order",
                where=self.name,
            )
        return np.array(joints) - 1

    def per_joint(self, name: str, count: int) -> np.ndarray:
        """A parameter for each of ``count`` joints, (count,); one value stands for all.

        Raises:
            InputError: there are neither one nor ``count`` values.
        """
        values = np.atleast_1d(getattr(self, name)).astype(float)
        if len(values) not in (1, count):
            raise InputError(
                f"{len(values)} values for {count} joints",
                "give one value, or one for each joint",
                where=f"{self.name}.{name}",
            )
        return np.broadcast_to(values, (count,))

    def of_joints(
        self, n: int, values: np.ndarray | float, usual: float = 1.0
    ) -> tuple[float, ...]:
        """Values of its joints, and the usual one of all others, (n,)."""
        out = np.full(n, usual)
        out[self.columns(n)] = values
        return tuple(out.tolist())


def factors(n: int, factor: tuple[float, ...]) -> Columns:
    """Columns of n joints times factors [1]."""
    return replace(Columns.identity(n), factor=factor)
