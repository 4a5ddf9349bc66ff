"""How recordings may need to be read: which column is whose, with which sign, unit and time scale."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class ChannelMapping:
    """What the joints' true motion and torque are, in terms of what was recorded; n joints, arrays of shape (n,).

    q_j = motion_factor_j recorded q_motion_source_j + motion_offset_j, likewise references, and derivatives without the
    offset; true time step = time_factor times the recorded one; the nominal inertials belong ``link_shift`` links
    further, in file order.

    tau_j(t) = torque_factor_j recorded tau_torque_source_j(t + torque_delay), plus the nominal arm's gravity torque
    g_j(q(t)) if that was left out. It is added last, whatever else is wrong with the torque.

    Attributes:
        motion_source, torque_source: column, from 0, that holds a joint's motion and its torque.
        motion_factor, torque_factor: what they must be multiplied with [1].
        motion_offset: what then has to be added to positions [rad].
        time_factor: true over recorded period [1].
        link_shift: links by which the inertials of the URDF have to move...
        moved_only: ...among those that a joint moves, or among all.
        turn: roll and pitch by which the base is turned against the nominal arm's gravity [rad].
        torque_delay: by which the torque is late against the motion, in recorded time [s].
        without_gravity: whether gravity was left out of the torque.
    """

    motion_source: tuple[int, ...]
    motion_factor: tuple[float, ...]
    torque_source: tuple[int, ...]
    torque_factor: tuple[float, ...]
    motion_offset: tuple[float, ...]
    time_factor: float = 1.0
    link_shift: int = 0
    moved_only: bool = False
    turn: tuple[float, float] = (0.0, 0.0)
    torque_delay: float = 0.0
    without_gravity: bool = False

    @classmethod
    def identity(cls, n: int) -> ChannelMapping:
        """Everything as it is recorded, for n joints."""
        columns, ones, zeros = tuple(range(n)), (1.0,) * n, (0.0,) * n
        return cls(columns, ones, columns, ones, zeros)

    @property
    def equation_key(self) -> tuple[object, ...]:
        """What the predicted torque, and the time of the recorded one, depend on."""
        return (
            self.motion_source,
            self.motion_factor,
            self.motion_offset,
            self.time_factor,
            self.link_shift,
            self.moved_only,
            self.turn,
            self.torque_delay,
        )

    def then(self, other: ChannelMapping) -> ChannelMapping:
        """The mapping that applies this one first and ``other`` to its result."""
        return ChannelMapping(
            tuple(self.motion_source[s] for s in other.motion_source),
            _composed(other.motion_source, other.motion_factor, self.motion_factor),
            tuple(self.torque_source[s] for s in other.torque_source),
            _composed(other.torque_source, other.torque_factor, self.torque_factor),
            self._offset_then(other),
            self.time_factor * other.time_factor,
            self.link_shift + other.link_shift,
            self.moved_only or other.moved_only,
            # a base is turned once
            other.turn if any(other.turn) else self.turn,
            self.torque_delay + other.torque_delay,
            self.without_gravity or other.without_gravity,
        )

    def _offset_then(self, other: ChannelMapping) -> tuple[float, ...]:
        """Offset of this mapping read by ``other``, and that of ``other``."""
        own = np.array(self.motion_offset)[list(other.motion_source)]
        offset = own * np.array(other.motion_factor) + np.array(other.motion_offset)
        return tuple(offset.tolist())

    def motion(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True q [rad], dq [rad/s], ddq [rad/s^2] of recorded ones, (N, n) each."""
        source = list(self.motion_source)
        factor = np.array(self.motion_factor)
        speed_factor = factor / self.time_factor
        acceleration_factor = factor / self.time_factor**2
        return (
            q[:, source] * factor + np.array(self.motion_offset),
            dq[:, source] * speed_factor,
            ddq[:, source] * acceleration_factor,
        )

    def torque(self, tau: np.ndarray) -> np.ndarray:
        """Torque [N m] of the recorded one, (N, n), before its delay and gravity are put right."""
        return tau[:, list(self.torque_source)] * np.array(self.torque_factor)


def _composed(
    source: tuple[int, ...], outer: tuple[float, ...], inner: tuple[float, ...]
) -> tuple[float, ...]:
    """Factors of one mapping times those of the columns on which it acts."""
    return tuple(factor * inner[s] for s, factor in zip(source, outer, strict=True))


def flipped(n: int, joint: int, channel: str) -> ChannelMapping:
    """Joint ``joint``, from 0, with the sign of its ``torque``, its ``position`` or both (``joint``) turned."""
    signs = tuple(-1.0 if j == joint else 1.0 for j in range(n))
    mapping = ChannelMapping.identity(n)
    if channel != "torque":
        mapping = replace(mapping, motion_factor=signs)
    if channel != "position":
        mapping = replace(mapping, torque_factor=signs)
    return mapping


def swapped(n: int, pair: tuple[int, int], channel: str) -> ChannelMapping:
    """Two joints, from 0, with their ``torque`` or all their columns (``joint``) exchanged."""
    first, second = pair
    columns = list(range(n))
    columns[first], columns[second] = second, first
    mapping = replace(ChannelMapping.identity(n), torque_source=tuple(columns))
    if channel == "torque":
        return mapping
    return replace(mapping, motion_source=tuple(columns))


def scaled(n: int, joints: tuple[int, ...], factor: float) -> ChannelMapping:
    """Joints, from 0, with positions in another unit: what they must be multiplied with [1]."""
    factors = tuple(factor if j in joints else 1.0 for j in range(n))
    return replace(ChannelMapping.identity(n), motion_factor=factors)


def offset_by(n: int, joint: int, angle: float) -> ChannelMapping:
    """Joint ``joint``, from 0, with an angle added to its positions [rad]."""
    offsets = tuple(angle if j == joint else 0.0 for j in range(n))
    return replace(ChannelMapping.identity(n), motion_offset=offsets)


def timed(n: int, factor: float) -> ChannelMapping:
    """Another time scale: true over recorded period."""
    return replace(ChannelMapping.identity(n), time_factor=factor)


def shifted(n: int, links: int, moved_only: bool = False) -> ChannelMapping:
    """The URDF's inertials moved by ``links`` links."""
    return replace(ChannelMapping.identity(n), link_shift=links, moved_only=moved_only)


def turned(n: int, roll: float, pitch: float) -> ChannelMapping:
    """The base turned by roll and pitch [rad] against the nominal arm's gravity."""
    return replace(ChannelMapping.identity(n), turn=(roll, pitch))


def rescaled(
    n: int, joints: tuple[int, ...], factors: tuple[float, ...]
) -> ChannelMapping:
    """Joints, from 0, with torques in another unit: what each must be multiplied with [1]."""
    by_joint = dict(zip(joints, factors, strict=True))
    torque_factor = tuple(by_joint.get(j, 1.0) for j in range(n))
    return replace(ChannelMapping.identity(n), torque_factor=torque_factor)


def late(n: int, delay: float) -> ChannelMapping:
    """All torques late by ``delay`` [s]."""
    return replace(ChannelMapping.identity(n), torque_delay=delay)


def without_gravity(n: int) -> ChannelMapping:
    """Gravity left out of all torques."""
    return replace(ChannelMapping.identity(n), without_gravity=True)
