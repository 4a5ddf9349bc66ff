"""A fault of the joints' zeros: angles counted from another posture than the model's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault, columns_of


@dataclass(frozen=True)
class ZeroOffset(Fault):
    """Angles of joints counted from another zero than the model's: recorded q = q + offset.

    As between an arm's Denavit-Hartenberg parameters and its URDF. Angles of a few degrees are no matter of convention:
    they are the effect ``encoder_offset``.

    Attributes:
        joints: from 1.
        offset: recorded less true angle [rad].
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
    offset: float

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> ZeroOffset:
        """One joint, by a quarter of a turn either way or by half a turn."""
        joint = int(rng.integers(n_joints)) + 1
        return cls((joint,), float(rng.choice([-1, 1, 2])) * np.pi / 2)

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """Count positions and their references from the other zero."""
        columns = columns_of(recording, self.joints, self.name)
        changed: dict[str, Any] = {}
        for channel in ("q", "q_ref"):
            series = getattr(recording, channel)
            if series is not None:
                changed[channel] = np.array(series)
                changed[channel][:, columns] += self.offset
        return replace(recording, **changed)
