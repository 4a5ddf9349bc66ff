"""What was written is read back and checked at finer steps than it holds, as a controller would carry it out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.sampled import Sampled
from gapscope.ident.excitation.limits import Checker, Margin

CHECKED_RATE = 1000.0
"""Samples per second at which a file is checked, at full speed [Hz]; as many along the path of a slow one."""
REST = 1e-6
"""Share of the limits of velocity and acceleration that counts as rest [1]."""


def check_written(
    written: Sampled, checker: Checker, path: Path, speed: float = 1.0
) -> None:
    """Check a trajectory read back from a file, quintic between its samples, against all limits.

    Position, velocity, acceleration, jerk, nominal torque, singular poses and distances at 1 kHz, and rest at both
    ends.

    Args:
        written: the trajectory.
        checker: of the limits.
        path: of the file, for the message.
        speed: of a slower version, as a share of the full speed [1].

    Raises:
        GapscopeError: a limit does not hold; names limit, joint, time and by how much.
    """
    count = int(np.ceil(written.duration * CHECKED_RATE * speed)) + 1
    t = np.linspace(0.0, written.duration, count)
    motion = Motion(
        t, written.position(t), written.velocity(t), written.acceleration(t)
    )
    _check_rest(motion, checker, path)
    for margin in checker.margins(motion, checker.torque(motion)):
        if not margin.kept:
            raise _refusal(margin, path)


def _check_rest(motion: Motion, checker: Checker, path: Path) -> None:
    """Check that a motion starts and ends at rest; raises ``GapscopeError``."""
    limits, ends = checker.allowed.motion, [0, -1]
    for name, values, limit in (
        ("velocity", motion.dq, limits.velocity),
        ("acceleration", motion.ddq, limits.acceleration),
    ):
        share = np.abs(values[ends]) / limit
        if (share > REST).any():
            end, joint = np.unravel_index(int(share.argmax()), share.shape)
            raise GapscopeError(
                f"{path}: not written: joint {joint + 1} does not rest at {motion.t[ends[end]]:.3f} s, its {name} is "
                f"{100 * share[end, joint]:.3g} % of its limit",
                "report this: what is designed starts and ends at rest",
            )


def _refusal(margin: Margin, path: Path) -> GapscopeError:
    """What to say of a limit that does not hold."""
    place, excess = "the arm", -float(np.min(margin.margin))
    if margin.limit.ndim:
        joint = int((margin.margin / margin.limit).argmin())
        place, excess = f"joint {joint + 1}", -float(margin.margin[joint])
    unit = "" if margin.unit == "1" else f" {margin.unit}"
    return GapscopeError(
        f"{path}: not written: {place} breaks its limit of {margin.name} by {excess:.3g}{unit} at {margin.at:.3f} s",
        "raise --rate, or design it with lower limits",
    )
