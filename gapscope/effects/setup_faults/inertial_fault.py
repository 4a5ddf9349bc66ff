"""A fault of the nominal arm's file: inertials on the neighbouring link."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.reading import Reading
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault, Look


@dataclass(frozen=True)
class ShiftedInertials(Fault):
    """The inertials of the nominal arm's URDF assigned to the neighbouring link.

    Attributes:
        by: how many links further [1].
        moved_only: whether links that no joint moves, such as the base, kept theirs.
    """

    name = "shifted_inertials"
    scope = "arm"
    looks_like = "gravity torque of every joint off by that of a link"
    reference = "hollerbach2008"
    parameters = (Parameter("by", "k", "1", (-6.0, 6.0), (-1.0, 1.0)),)
    by: int = 1
    moved_only: bool = False

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> ShiftedInertials:
        """One link up or down the chain."""
        return cls(int(rng.choice([-1, 1])), bool(rng.integers(2)))

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """One link off."""
        return [*cls.one_link_off()]

    @classmethod
    def one_link_off(cls) -> list[ShiftedInertials]:
        """Either way, among all links or among those that a joint moves."""
        return [cls(by, moved) for moved in (False, True) for by in (1, -1)]

    def reading(self, n: int) -> Reading:
        """With the inertials back where they belong."""
        return Reading.identity(n, link_shift=-self.by, moved_only=self.moved_only)
