"""How recordings may have to be read: which column is whose, with which sign, unit and time scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ChannelMapping:
    """What the joints' true motion and torque are, in terms of what was recorded; n joints, arrays of shape (n,).

    q_j = motion_factor_j recorded q_motion_source_j, likewise its derivatives and references; torque likewise; true
    time step = time_factor times the recorded one; the nominal inertials belong ``shift`` links further, in file order.

    Attributes:
        motion_source, torque_source: column, from 0, that holds a joint's motion and its torque.
        motion_factor, torque_factor: what they have to be multiplied with [1].
        time_factor: true over recorded period [1].
        shift: links by which the inertials of the URDF have to move...
        moved_only: ...among those that a joint moves, or among all.
    """

    motion_source: tuple[int, ...]
    motion_factor: tuple[float, ...]
    torque_source: tuple[int, ...]
    torque_factor: tuple[float, ...]
    time_factor: float = 1.0
    shift: int = 0
    moved_only: bool = False

    @classmethod
    def plain(cls, n: int) -> ChannelMapping:
        """Everything as it is recorded, for n joints."""
        return cls(tuple(range(n)), (1.0,) * n, tuple(range(n)), (1.0,) * n)

    @property
    def motion_key(self) -> tuple[object, ...]:
        """What the predicted torque depends on."""
        return (
            self.motion_source,
            self.motion_factor,
            self.time_factor,
            self.shift,
            self.moved_only,
        )

    def then(self, other: ChannelMapping) -> ChannelMapping:
        """Another reading of what this one has made."""
        return ChannelMapping(
            tuple(self.motion_source[s] for s in other.motion_source),
            tuple(
                f * self.motion_factor[s]
                for s, f in zip(other.motion_source, other.motion_factor, strict=True)
            ),
            tuple(self.torque_source[s] for s in other.torque_source),
            tuple(
                f * self.torque_factor[s]
                for s, f in zip(other.torque_source, other.torque_factor, strict=True)
            ),
            self.time_factor * other.time_factor,
            self.shift + other.shift,
            self.moved_only or other.moved_only,
        )

    def motion(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True q [rad], dq [rad/s], ddq [rad/s^2] of recorded ones, (N, n) each."""
        source, factor = list(self.motion_source), np.array(self.motion_factor)
        f = self.time_factor
        return (
            q[:, source] * factor,
            dq[:, source] * (factor / f),
            ddq[:, source] * (factor / f**2),
        )

    def torque(self, tau: np.ndarray) -> np.ndarray:
        """True torque [N m] of the recorded one, (N, n)."""
        return tau[:, list(self.torque_source)] * np.array(self.torque_factor)


def flipped(n: int, joint: int, channel: str) -> ChannelMapping:
    """Joint ``joint``, from 0, with the sign of its ``torque``, its ``position`` or both (``joint``) turned."""
    factor = tuple(-1.0 if j == joint else 1.0 for j in range(n))
    ones = (1.0,) * n
    motion, torque = (
        ones if channel == "torque" else factor,
        ones if channel == "position" else factor,
    )
    return ChannelMapping(tuple(range(n)), motion, tuple(range(n)), torque)


def swapped(n: int, pair: tuple[int, int], channel: str) -> ChannelMapping:
    """Two joints, from 0, with their ``torque`` or all their columns (``joint``) exchanged."""
    columns = list(range(n))
    columns[pair[0]], columns[pair[1]] = pair[1], pair[0]
    source = tuple(columns)
    return ChannelMapping(
        tuple(range(n)) if channel == "torque" else source,
        (1.0,) * n,
        source,
        (1.0,) * n,
    )


def scaled(
    n: int, joints: tuple[int, ...], motion: float, torque: float = 1.0
) -> ChannelMapping:
    """Joints, from 0, with motion and torque in another unit: what they have to be multiplied with."""
    inside = [j in joints for j in range(n)]
    columns = tuple(range(n))
    return ChannelMapping(
        columns,
        tuple(motion if i else 1.0 for i in inside),
        columns,
        tuple(torque if i else 1.0 for i in inside),
    )


def timed(n: int, factor: float) -> ChannelMapping:
    """Another time scale: true over recorded period."""
    columns = tuple(range(n))
    return ChannelMapping(columns, (1.0,) * n, columns, (1.0,) * n, time_factor=factor)


def shifted(n: int, links: int, moved_only: bool = False) -> ChannelMapping:
    """The URDF's inertials moved by ``links`` links."""
    columns = tuple(range(n))
    return ChannelMapping(
        columns, (1.0,) * n, columns, (1.0,) * n, shift=links, moved_only=moved_only
    )
