"""A recording: time series of one motion of one arm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import whole_rate

CHANNELS = ("q", "dq", "tau", "q_ref", "dq_ref", "tau_sensor", "temperature")
"""Names of the per-joint channels, in the order in which files hold them."""
USUAL_STEP = 0.01
"""Largest difference of a usual step of time from the median step, over it [1]: the resolution of a clock of dates in
double precision is 0.1 % of the step of a log at 5 kHz."""


@dataclass(frozen=True)
class Recording:
    """Time series of one motion, N samples of an arm with n joints; arrays are read-only.

    Attributes:
        name: file name or label of the recording.
        t: time [s], shape (N,), strictly increasing within a segment; gaps are allowed. Readers count it from the
            first row of the log.
        q: joint positions as the encoders gave them [rad], shape (N, n).
        tau: torque commanded or derived from motor current, joint side [N m], (N, n); ``None`` if no torque
            can be trusted.
        dq: recorded velocity [rad/s], (N, n), or ``None``.
        q_ref, dq_ref: reference position [rad] and velocity [rad/s], (N, n), or ``None``.
        tau_sensor: joint torque sensor [N m], (N, n), or ``None``.
        temperature: joint temperature [deg C], (N, n), or ``None``.
        notes: what was noticed or repaired while reading, for the report.
        payload: known body that was mounted on the last link, or ``None``.
        begun: what the log's own clock showed at t = 0 [s]: time since it was switched on, or a date.

    Raises:
        InputError: a channel's shape does not fit ``t`` and ``q``, or a value is not finite.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray | None = None
    dq: np.ndarray | None = None
    q_ref: np.ndarray | None = None
    dq_ref: np.ndarray | None = None
    tau_sensor: np.ndarray | None = None
    temperature: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    payload: KnownLoad | None = None
    begun: float = 0.0

    def __post_init__(self) -> None:
        """Freeze the arrays and check their shapes."""
        for name in ("t", *CHANNELS):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _frozen(value))
        if self.t.ndim != 1 or self.q.ndim != 2:
            raise InputError(
                "t must have shape (N,) and q shape (N, n)", file=self.name
            )
        for name in CHANNELS:
            value = getattr(self, name)
            if value is not None and value.shape != self.q.shape:
                raise InputError(
                    f"has shape {value.shape}, expected {self.q.shape} as q has",
                    file=self.name,
                    where=f"channel {name}",
                )
        if len(self.t) != len(self.q):
            raise InputError(
                f"t has {len(self.t)} rows, q has {len(self.q)}", file=self.name
            )
        for name in ("t", *CHANNELS):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value).all():
                row, *column = np.argwhere(~np.isfinite(value))[0]
                label = name if not column else f"{name}{column[0] + 1}"
                raise InputError(
                    "is not a finite number",
                    "drop or repair the row; a gap in time is cut, a missing value is never guessed",
                    file=self.name,
                    where=f"row {row + 1}, column {label}",
                )

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return self.q.shape[1]

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]: the inverse of the mean of all steps of t that are usual; nan of a single sample.

        Usual are those that differ from the median by no more than ``USUAL_STEP``; of steps of two kinds, as many of
        each, none does, and the median counts.
        """
        if len(self.t) < 2:
            return float("nan")
        steps = np.diff(self.t)
        median = np.median(steps)
        usual = steps[np.abs(steps - median) <= USUAL_STEP * np.abs(median)]
        step = usual.mean() if len(usual) else median
        return whole_rate(float(1.0 / step))

    @property
    def stamps(self) -> np.ndarray:
        """Time by the log's own clock, to 1e-9 s, shape (N,)."""
        return np.round(self.t + self.begun, 9) if self.begun else self.t

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def channels(self) -> dict[str, np.ndarray]:
        """The channels that it has, by name, (N, n) each."""
        channels = {name: getattr(self, name) for name in CHANNELS}
        return {name: series for name, series in channels.items() if series is not None}

    def part(self, rows: np.ndarray | slice, **changed: Any) -> Recording:
        """The recording with some of its rows, a mask, places or a slice; ``changed`` are other attributes."""
        series = {"t": self.t, **self.channels}
        chosen: dict[str, Any] = {name: x[rows] for name, x in series.items()}
        return replace(self, **chosen, **changed)


def _frozen(value: Any) -> np.ndarray:
    """A read-only array of numbers: the array itself if it is one, as those of another recording are, else a copy."""
    shared = isinstance(value, np.ndarray) and value.dtype == float
    if shared and not value.flags.writeable:
        return value
    array = np.array(value, dtype=float)
    array.setflags(write=False)
    return array
