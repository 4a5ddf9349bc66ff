"""A fault of the joints' zeros: angles counted from another posture than the model's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.reading import Columns, Reading
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault, Look, Values

# Zeros of joints off by large angles: starts of the search for one [rad]. (budget)
ZERO_STARTS = tuple(float(a) for a in np.deg2rad((-135, -90, -45, 45, 90, 135, 180)))


@dataclass(frozen=True)
class ZeroOffset(Fault):
    """Angles of joints counted from another zero than the model's: recorded q = q + offset.

    As between an arm's Denavit-Hartenberg parameters and its URDF. Angles of a few degrees are no matter of convention:
    they are the effect ``encoder_offset``.

    Attributes:
        joints: from 1.
        offset: recorded less true angle [rad], one for all joints or one for each.
    """

    name = "zero_offset"
    scope = "joint"
    looks_like = (
        "gravity torque as if a joint and what hangs on it were turned by a large angle"
    )
    reference = "siciliano2009"
    parameters = (
        Parameter("offset", "delta", "rad", (-np.pi, np.pi), (-np.pi / 2, np.pi / 2)),
    )
    joints: tuple[int, ...]
    offset: Values

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> ZeroOffset:
        """One joint, by a quarter of a turn either way or by half a turn."""
        joint = int(rng.integers(n_joints)) + 1
        return cls((joint,), float(rng.choice([-1, 1, 2])) * np.pi / 2)

    @classmethod
    def candidates(cls, look: Look) -> list[Fault]:
        """Each joint by eighths of a turn."""
        return [cls((j,), a) for j in range(1, look.n + 1) for a in ZERO_STARTS]

    def reading(self, n: int) -> Reading:
        """Positions and their references counted from the model's zero."""
        offset = self.per_joint("offset", len(self.columns(n)))
        back = self.of_joints(n, -offset, usual=0.0)
        return Reading.identity(n, motion=replace(Columns.identity(n), offset=back))
