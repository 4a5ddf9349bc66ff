"""Setup faults: what is wrong with the set-up, not with the arm; tested before any physics, since they look like it.

A fault is found in recordings and made in them: ``apply`` gives the recording that a set-up with this fault would have
written. ``ShiftedInertials`` is the exception: it spoils the nominal arm's URDF, not the recording.

In files of the form of ``corrected.yaml`` a fault is an entry of ``effects`` with its ``joints``, ``variant`` and
``parameters``, as ``diagnosis.json`` has it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter

POSITIONS = ("q", "dq", "q_ref", "dq_ref")
TORQUES = ("tau", "tau_sensor")


@dataclass(frozen=True)
class Fault(ABC):
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
        """Check variant and values; raises ``InputError`` if they do not exist or lie out of bounds."""
        if self.variants:
            variant = getattr(self, "variant")  # noqa: B009 (a field of the subclass)
            check_known("variant", variant, self.variants, where=self.name)
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

    @classmethod
    @abstractmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> Fault:
        """A fault as real set-ups have it, on an arm with n joints."""

    @abstractmethod
    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """The recording as a set-up with this fault would have written it.

        Args:
            recording: a right one.
            rng: source of random numbers.
            arm: the nominal arm, which is also the vendor's model in the driver.

        Raises:
            InputError: the fault names a joint that the recording does not have.
        """

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


def columns_of(recording: Recording, joints: tuple[int, ...], name: str) -> np.ndarray:
    """Columns of joints that count from 1."""
    if not joints or min(joints) < 1 or max(joints) > recording.n_joints:
        raise InputError(
            f"joints {list(joints)} of an arm with {recording.n_joints} joints",
            f"joints count from 1 to {recording.n_joints} in the case's order",
            where=name,
        )
    return np.array(joints) - 1


def scaled(
    recording: Recording, channels: tuple[str, ...], columns: np.ndarray, factor: float
) -> Recording:
    """The recording with some columns of some channels times a factor."""
    changed: dict[str, Any] = {}
    for channel in channels:
        series = getattr(recording, channel)
        if series is not None:
            changed[channel] = np.array(series)
            changed[channel][:, columns] *= factor
    return replace(recording, **changed)
