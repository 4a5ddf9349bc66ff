"""How a log must be read: what stands in its columns, against what an arm and its set-up have.

A reading is data. It is applied to a recording; composed with another; inverted, which makes the log that a set-up at
fault would have written; and written as the ``mend:`` part of an import section. Faults of the set-up are readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.arm.control import PD
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.plausibility import even_stamps, repeated_rows
from gapscope.arm.io.table import GAP_STEPS
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording, set_points
from gapscope.arm.robots import shifted_arm

PARTS = ("motion", "torque", "sensor")
"""Attributes of a reading that are columns."""
COLUMNS = {"tau": "torque", "tau_sensor": "sensor"}
"""Which columns of a reading are those of a channel; of all others the motion's."""

IN_MEND = {
    ("time", "scale"): "time_factor",
    ("torque", "delay"): "torque_delay",
    ("reference", "lead"): "lead",
    ("reference", "pace"): "pace",
}
"""Numbers of a reading in the ``mend:`` part of an import section."""


@dataclass(frozen=True)
class Columns:
    """Series of n joints out of those that were read: x_j = factor_j read x_source_j + offset_j.

    Attributes:
        source: joint, from 0, whose column holds this joint.
        factor: [1].
        offset: of positions [rad].
    """

    source: tuple[int, ...]
    factor: tuple[float, ...]
    offset: tuple[float, ...]

    @classmethod
    def identity(cls, n: int) -> Columns:
        """As they were read."""
        return cls(tuple(range(n)), (1.0,) * n, (0.0,) * n)

    @classmethod
    def from_mend(cls, entry: Mapping[str, Any], n: int) -> Columns:
        """From an entry of ``mend:``."""

        def per_joint(name: str, default: float | range) -> np.ndarray:
            # a list has one value for each joint, a number stands for all
            return np.full(n, entry.get(name, default), dtype=float)

        # numbers count from 1 in a case and from 0 here
        source = per_joint("columns", range(1, n + 1)).astype(int) - 1
        return cls.of(source, per_joint("scale", 1.0), per_joint("offset", 0.0))

    @classmethod
    def of(cls, *parts: np.ndarray) -> Columns:
        """Of source, factor and offset as arrays, (n,)."""
        return cls(*(tuple(part.tolist()) for part in parts))

    def to_mend(self) -> dict[str, Any]:
        """As an entry of ``mend:``, without what changes nothing."""
        entry: dict[str, Any] = {}
        same = Columns.identity(len(self.source))
        if self.source != same.source:
            entry["columns"] = [source + 1 for source in self.source]
        for key, values, nothing in (
            ("scale", self.factor, same.factor),
            ("offset", self.offset, same.offset),
        ):
            if values != nothing:
                # one number stands for all joints
                entry[key] = values[0] if len(set(values)) == 1 else list(values)
        return entry

    def __call__(self, series: np.ndarray, *, position: bool = False) -> np.ndarray:
        """The series of the joints, (N, n); the offset is that of positions alone."""
        source = list(self.source)
        # most readings keep the order: no copy is made
        in_order = source == list(range(series.shape[1]))
        out = (series if in_order else series[:, source]) * np.array(self.factor)
        return out + np.array(self.offset) if position else out

    def then(self, other: Columns) -> Columns:
        """These first, and ``other`` of the result."""
        # other(self(x)): the factor and offset of the column that other takes
        before = list(other.source)
        factor, offset = np.array(other.factor), np.array(other.offset)
        return Columns.of(
            np.array(self.source)[before],
            factor * np.array(self.factor)[before],
            np.array(self.offset)[before] * factor + offset,
        )

    def inverse(self) -> Columns:
        """The columns that were read, of the series of the joints."""
        # x_j = f_j r_s(j) + o_j, so that r_k = (x_j - o_j) / f_j with k = s(j)
        place = np.argsort(self.source)
        factor, offset = np.array(self.factor), np.array(self.offset)
        # 0.0 - x, for no offset is 0 and not -0
        back = 0.0 - offset / factor
        return Columns.of(place, 1.0 / factor[place], back[place])


@dataclass(frozen=True)
class Reading:
    """What an arm of n joints did, in terms of what was recorded.

    Attributes:
        motion: of q, dq and their references; temperatures follow its columns.
        torque, sensor: of tau and of tau_sensor.
        time_factor: true over recorded period [1], ...
        files: ...of the files of these names; of all if empty. Recorded velocities do not depend on the stamps.
        torque_delay: d, by which tau is late against the motion, in true time [s], ...
        torque_drift: ...and the share s of its time by which it is late as well [1].
        gravity: how often the nominal arm's gravity torque is to be added to tau; 1 where it was left out. It is added
            last, whatever else is wrong with the torque.
        lead: kd / kp of a controller that ignores the velocity's reference [s]; 0: it does not.
        pace: the arm's speed over that of the reference [1].
        kp_factor, kd_factor: gains at work over the declared ones [1], (n,).
        law: kp and kd at work of each joint whose torque they gave, ``None`` for one that was measured; empty if all
            were.
        own_velocity: whether dq is the arm's; otherwise that of the reference, and not read.
        smooth_reference: whether the controller followed a smooth motion through the set points recorded.
        even: whether samples were taken evenly, whatever their stamps.
        once: whether rows that repeat the measurement before them are to be left out.
        link_shift: links by which the inertials of the URDF have to move, in file order, ...
        moved_only: ...among those that a joint moves, or among all.
        turn: roll and pitch by which the base is turned against the nominal arm's gravity [rad].
    """

    motion: Columns
    torque: Columns
    sensor: Columns
    kp_factor: tuple[float, ...]
    kd_factor: tuple[float, ...]
    time_factor: float = 1.0
    files: tuple[str, ...] = ()
    torque_delay: float = 0.0
    torque_drift: float = 0.0
    gravity: int = 0
    lead: float = 0.0
    pace: float = 1.0
    law: tuple[tuple[float, float] | None, ...] = ()
    own_velocity: bool = True
    smooth_reference: bool = False
    even: bool = False
    once: bool = False
    link_shift: int = 0
    moved_only: bool = False
    turn: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def identity(cls, n: int, **changed: Any) -> Reading:
        """Everything as it is recorded, but for what is given."""
        usual: dict[str, Any] = dict.fromkeys(PARTS, Columns.identity(n))
        usual |= dict.fromkeys(("kp_factor", "kd_factor"), (1.0,) * n)
        return cls(**(usual | changed))

    def differs(self, *names: str) -> bool:
        """Whether any of some attributes changes anything."""
        same = Reading.identity(len(self.kp_factor))
        return any(getattr(self, name) != getattr(same, name) for name in names)

    @property
    def equation_key(self) -> tuple[object, ...]:
        """What the predicted torque, and the time of the recorded one, depend on."""
        shift = self.link_shift, self.moved_only, self.turn
        return self.motion, self.time_factor, self.torque_delay, *shift

    @property
    def recorded_delay(self) -> float:
        """By which the torque is late against the motion, in recorded time [s]."""
        return self.torque_delay / self.time_factor

    # --- as a group

    def then(self, other: Reading) -> Reading:
        """The reading that applies this one first and ``other`` to its result.

        With u(t) = (1 + s) t + d the time at which tau was recorded, u = u_1 u_2; q_ref - T dq_ref at pace s, of
        another lead and pace, has the lead T_1 + s_1 T_2.
        """
        # slope of the time at which the torque was recorded, 1 + s
        drift = 1.0 + self.torque_drift
        return Reading(
            self.motion.then(other.motion),
            self.torque.then(other.torque),
            self.sensor.then(other.sensor),
            _product(self.kp_factor, other.kp_factor),
            _product(self.kd_factor, other.kd_factor),
            self.time_factor * other.time_factor,
            other.files or self.files,
            other.time_factor * self.torque_delay + drift * other.torque_delay,
            self.torque_drift + drift * other.torque_drift,
            self.gravity + other.gravity,
            self.lead + self.pace * other.lead,
            self.pace * other.pace,
            # the later one stands: gains are those at work, not a share of others
            other.law or self.law,
            self.own_velocity and other.own_velocity,
            self.smooth_reference or other.smooth_reference,
            self.even or other.even,
            self.once or other.once,
            self.link_shift + other.link_shift,
            self.moved_only or other.moved_only,
            # a base is turned once
            other.turn if any(other.turn) else self.turn,
        )

    def inverse(self) -> Reading:
        """What makes of a right recording the one that has to be read so, but for what no reading brings back.

        That is rows and stamps, a velocity, a torque that gains gave, a coarse reference, and a turned base.
        """
        drift = 1.0 + self.torque_drift
        return Reading(
            self.motion.inverse(),
            self.torque.inverse(),
            self.sensor.inverse(),
            tuple(1.0 / factor for factor in self.kp_factor),
            tuple(1.0 / factor for factor in self.kd_factor),
            1.0 / self.time_factor,
            self.files,
            0.0 - self.torque_delay / (drift * self.time_factor),
            1.0 / drift - 1.0,
            -self.gravity,
            0.0 - self.lead / self.pace,
            1.0 / self.pace,
            link_shift=-self.link_shift,
            moved_only=self.moved_only,
        )

    # --- as the mend: part of an import section

    @classmethod
    def from_mend(cls, section: Mapping[str, Any], n: int) -> Reading:
        """From the ``mend:`` part of an import section that has passed the case schema, for n joints."""
        columns = {key: Columns.from_mend(section.get(key, {}), n) for key in PARTS}
        numbers = {
            name: float(section[key][entry])
            for (key, entry), name in IN_MEND.items()
            if entry in section.get(key, {})
        }
        return cls.identity(
            n,
            **columns,
            **numbers,
            files=tuple(section.get("time", {}).get("files", ())),
            gravity=int(section.get("torque", {}).get("gravity") == "left_out"),
        )

    def to_mend(self) -> dict[str, Any]:
        """As the ``mend:`` part of an import section, without what changes nothing or cannot be said there."""
        columns = {key: getattr(self, key).to_mend() for key in PARTS}
        said: dict[str, dict[str, Any]] = {"time": {}, **columns, "reference": {}}
        for (key, entry), name in IN_MEND.items():
            if self.differs(name):
                said[key][entry] = getattr(self, name)
        if said["time"] and self.files:
            said["time"]["files"] = list(self.files)
        if self.gravity:
            said["torque"]["gravity"] = "left_out"
        return {key: entries for key, entries in said.items() if entries}

    # --- of arrays

    def true_motion(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True q [rad], dq [rad/s], ddq [rad/s^2] of those that the recorded positions and stamps give, (N, n) each."""
        source, factor = list(self.motion.source), np.array(self.motion.factor)
        # speed and acceleration count in true time, their columns as positions
        speed, acceleration = factor / self.time_factor, factor / self.time_factor**2
        return (
            self.motion(q, position=True),
            dq[:, source] * speed,
            ddq[:, source] * acceleration,
        )

    def of_channels(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Those of some channels, by name, (N, n) each, whose columns, factors or offsets change."""
        changed = {}
        for name, series in values.items():
            columns: Columns = getattr(self, COLUMNS.get(name, "motion"))
            # a sign, a scale or an offset is no matter of a temperature, its column is
            if name == "temperature":
                columns = replace(columns, factor=(1.0,) * len(columns.source))
            if columns != Columns.identity(len(columns.source)):
                changed[name] = columns(series, position=name in ("q", "q_ref"))
        return changed

    # --- of a recording, an arm and a controller

    def __call__(
        self, recording: Recording, arm: NominalArm | None = None
    ) -> Recording:
        """The recording as a right set-up would have written it; the same object if nothing is changed.

        Args:
            recording: with its known load.
            arm: the nominal arm, whose gravity torque is added; needed where it was left out.

        Raises:
            InputError: the recording is not longer than the delay of its torque.
        """
        # rows and their stamps
        if self.once:
            repeated, notes = repeated_rows(recording.t, recording.channels)
            if repeated.any():
                notes = recording.notes + notes
                recording = recording.part(~repeated, notes=notes)
        t = even_stamps(recording.t) if self.even else recording.t
        # about the first stamp: a recording that goes on from another keeps its start
        if self.differs("time_factor"):
            t = t[0] + (t - t[0]) * self.time_factor
        changed: dict[str, Any] = {} if t is recording.t else {"t": t}
        # columns, factors and offsets
        changed |= self.of_channels(recording.channels)
        # a velocity that is that of the references: that of the positions takes its place
        if recording.q_ref is not None and not self.own_velocity:
            changed["dq"] = None
        recording = replace(recording, **changed) if changed else recording
        recording = at_pace(without_lead(recording, self.lead), self.pace)
        points = set_points(recording) if self.smooth_reference else None
        recording = recording if points is None else points.smooth(recording)
        recording = advanced(recording, self.torque_delay, self.torque_drift)
        # kp (q_ref - q) + kd (dq_ref - dq) as the torque of joints whose gains gave it
        known = {"q_ref", "dq", "tau"} <= recording.channels.keys()
        if any(self.law) and known:
            q_ref, dq_ref = references(recording, "unmeasured_torque")
            error, rate = q_ref - recording.q, dq_ref - recording.dq
            tau = np.array(recording.tau)
            for j, gains in enumerate(self.law):
                # only of joints whose recorded torque was none
                if gains is not None:
                    tau[:, j] = gains[0] * error[:, j] + gains[1] * rate[:, j]
            recording = replace(recording, tau=tau)
        # last: a gravity torque is added to what is right already
        if not self.gravity or recording.tau is None:
            return recording
        # of a torque without gravity, as UR's ``actual_current_as_torque``
        assert arm is not None
        weight = RigidBody(arm).carrying(recording.payload).gravity_torque(recording.q)
        return replace(recording, tau=recording.tau + self.gravity * weight)

    def arm(self, arm: NominalArm) -> NominalArm:
        """The nominal arm with its inertials where they belong."""
        return shifted_arm(arm, self.link_shift, self.moved_only)

    def controller(self, controller: Controller | None) -> Controller | None:
        """The controller with the gains at work; unchanged if it is no PD controller."""
        if not isinstance(controller, PD) or not self.differs("kp_factor", "kd_factor"):
            return controller
        kp = np.array(controller.kp) * self.kp_factor
        return replace(controller, kp=kp, kd=np.array(controller.kd) * self.kd_factor)


def _product(one: tuple[float, ...], other: tuple[float, ...]) -> tuple[float, ...]:
    return tuple((np.array(one) * other).tolist())


def advanced(recording: Recording, delay: float, drift: float = 0.0) -> Recording:
    """A recording whose torque is late by ``delay`` [s] and a share ``drift`` [1] of its time, put right.

    tau(t) = recorded tau(t + delay + drift (t - t_0)), linear between samples, constant before the first. Rows whose
    torque was not recorded, at the end and before gaps, are left out; unchanged without a torque.

    Raises:
        InputError: the recording is not longer than the delay.
    """
    if recording.tau is None or (delay == 0.0 and drift == 0.0):
        return recording
    t = recording.t
    due = t + delay + drift * (t - t[0])
    # a due time that is a sample's but for rounding is that sample's
    inside = due - 1e-9 <= t[-1]
    after = np.clip(np.searchsorted(t, due - 1e-9), 1, len(t) - 1)
    # a step over a gap was not recorded: nothing is interpolated in it
    inside &= t[after] - t[after - 1] <= GAP_STEPS / recording.rate
    if inside.sum() < 2:
        raise InputError(
            f"lasts {recording.duration:.3g} s, no longer than the delay of {due[0] - t[0]:.3g} s of its torque",
            "check the delay under import.mend.torque, in s",
            file=recording.name,
        )
    tau = interpolated(due[inside], t, recording.tau)
    return replace(recording.part(inside), tau=tau)


def interpolated(at: np.ndarray, t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """A series (N, n) of times t at other times [s], (M,), linear between samples and constant beyond; (M, n)."""
    return np.column_stack([np.interp(at, t, column) for column in series.T])


def references(recording: Recording, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Reference positions [rad] and velocities [rad/s] of a recording, (N, n) each.

    Velocities that were not recorded are the derivative of the positions.

    Args:
        recording: the recording.
        name: of the fault that asks, for the message.

    Raises:
        InputError: no reference was recorded.
    """
    if recording.q_ref is None:
        raise InputError(
            "has no reference q_ref, of which this is a fault",
            "record under a position controller",
            file=recording.name,
            where=name,
        )
    if recording.dq_ref is not None:
        return recording.q_ref, recording.dq_ref
    return recording.q_ref, np.gradient(recording.q_ref, recording.t, axis=0)


def without_lead(recording: Recording, lead: float) -> Recording:
    """The recording with q_ref - (kd / kp) dq_ref as its reference position, which ``lead`` = kd / kp [s] is.

    Under gains kp and kd a controller that ignores its velocity reference commands what one does that uses it and is
    given this position: kp (q_ref - T dq_ref - q) + kd (dq_ref - dq) = kp (q_ref - q) - kd dq. The velocity's reference
    stays, for a feedforward; unchanged without a reference.
    """
    if recording.q_ref is None or lead == 0.0:
        return recording
    q_ref, dq_ref = references(recording, "lead")
    return replace(recording, q_ref=q_ref - lead * dq_ref, dq_ref=dq_ref)


def at_pace(recording: Recording, factor: float) -> Recording:
    """The recording with its reference at the arm's pace, q_ref(t0 + s (t - t0)); rows beyond its end are left out.

    Args:
        recording: unchanged without a reference.
        factor: s, the arm's speed over that of the recorded reference [1].
    """
    if recording.q_ref is None or factor == 1.0:
        return recording
    t = recording.t
    reached = t[0] + (t - t[0]) * factor
    inside = reached <= t[-1]
    changed: dict[str, Any] = {}
    # chain rule: at pace s the velocity is s times that of the reference
    for channel, times in (("q_ref", 1.0), ("dq_ref", factor)):
        series = getattr(recording, channel)
        if series is not None:
            changed[channel] = times * interpolated(reached[inside], t, series)
    return replace(recording.part(inside), **changed)
