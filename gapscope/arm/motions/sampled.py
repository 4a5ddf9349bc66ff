"""A reference motion from samples in a file, such as an exciting trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import BPoly

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion


@dataclass(frozen=True)
class Sampled:
    """A motion through samples of position, velocity and acceleration, quintic in between; it rests before and after.

    Attributes:
        motion: the samples, N of n joints; time starts at 0 [s].

    Raises:
        InputError: fewer than two samples, or a time that does not start at 0 and rise.
    """

    motion: Motion

    def __post_init__(self) -> None:
        """Check the time."""
        t = self.motion.t
        if len(t) < 2 or t[0] != 0 or not (np.diff(t) > 0).all():
            raise InputError(
                "a motion needs two or more samples whose time starts at 0 and rises",
                where="t",
            )

    def slower(self, speed: float) -> Sampled:
        """The same path at ``speed`` times the speed [1]."""
        m = self.motion
        return Sampled(Motion(m.t / speed, m.q, speed * m.dq, speed**2 * m.ddq))

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.motion.t[-1])

    @cached_property
    def _curve(self) -> BPoly:
        # Bernstein coefficients of all steps at once, from both ends inwards
        m, h = self.motion, np.diff(self.motion.t)[:, None]
        speed, bend = m.dq / 5, m.ddq / 20
        start = [
            m.q[:-1],
            m.q[:-1] + h * speed[:-1],
            m.q[:-1] + 2 * h * speed[:-1] + h**2 * bend[:-1],
        ]
        end = [
            m.q[1:] - 2 * h * speed[1:] + h**2 * bend[1:],
            m.q[1:] - h * speed[1:],
            m.q[1:],
        ]
        return BPoly(np.stack(start + end), m.t)

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self._curve(np.clip(t, 0.0, self.duration))

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        return self._inside(t) * self._curve(np.clip(t, 0.0, self.duration), 1)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        return self._inside(t) * self._curve(np.clip(t, 0.0, self.duration), 2)

    def _inside(self, t: np.ndarray) -> np.ndarray:
        return ((np.asarray(t) >= 0) & (np.asarray(t) <= self.duration))[:, None]


def read_sampled(path: Path, n_joints: int) -> Sampled:
    """A reference motion from a CSV with columns ``t``, ``q_ref1..``, ``dq_ref1..`` and ``ddq_ref1..``.

    Raises:
        InputError: the file or a column is missing, or a value is no finite number.
    """
    remedy = "give a file as gapscope excite writes it"
    try:
        table = pd.read_csv(path)
    except FileNotFoundError:
        raise InputError("no such file", remedy, file=path) from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read as CSV ({error})", remedy, file=path
        ) from None
    joints = range(1, n_joints + 1)
    columns = [
        "t",
        *(f"{name}{j}" for name in ("q_ref", "dq_ref", "ddq_ref") for j in joints),
    ]
    missing = [column for column in columns if column not in table]
    if missing:
        raise InputError(f"has no column {', '.join(missing[:4])}", remedy, file=path)
    used = table[columns].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    if not np.isfinite(used).all():
        row = int(np.flatnonzero(~np.isfinite(used).all(axis=1))[0])
        raise InputError(
            "holds a value that is no finite number",
            remedy,
            file=path,
            where=f"line {row + 2}",
        )
    return Sampled(Motion(used[:, 0], *np.split(used[:, 1:], 3, axis=1)))
