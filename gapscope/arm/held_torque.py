"""Torques that were not measured though the log holds a number: a sensor's or converter's limit, or a stuck sensor.

A torque that keeps one value, while its joint moves, for far longer than its values usually last. At its largest or
least value that is a limit that was reached: the joint's torque was larger, by how much is unknown. At any other value,
and for longer, the sensor or its driver was stuck.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gapscope.arm.recording import Recording

STUCK_TIME = 0.2
"""Any value that is kept for less is left as it is [s]: slow updates and coarse steps do that."""
CLIPPED_RATIO = 5.0
"""A limit was reached if the longest time at the largest or least value is so many times as long as usual [1]."""
STUCK_RATIO = 10.0
"""A sensor was stuck if a value lasts so many times as long as usual [1]."""
USUAL_SHARE = 0.95
"""The usual time is that below which values last in this share of all other rows [1]."""
HELD_MOTION = 1e-3
"""Share of its travel by which the joint moves meanwhile at least [1]: at rest a command may stand."""
CLIPPED = "rows not used whose torque stands at a limit of the sensor or the drive, its largest or least value"
STUCK = "rows not used whose torque stands while the joint moves, as of a stuck sensor"
"""Notes on them; the share of each column follows."""


class HeldTorque(NamedTuple):
    """Samples of a torque that were not measured, masks (N, n).

    Attributes:
        clipped: at the largest or least value.
        stuck: at any other.
    """

    clipped: np.ndarray
    stuck: np.ndarray

    @property
    def unknown(self) -> np.ndarray:
        """Both, (N, n)."""
        return self.clipped | self.stuck


def held_torque(t: np.ndarray, q: np.ndarray, tau: np.ndarray) -> HeldTorque:
    """Which samples of a torque were not measured.

    Args:
        t: time [s], (N,).
        q: positions, any unit, (N, n).
        tau: torque, any unit, (N, n).
    """
    clipped, stuck = np.zeros(tau.shape, dtype=bool), np.zeros(tau.shape, dtype=bool)
    for j, series in enumerate(tau.T):
        _mark(t, q[:, j], series, clipped[:, j], stuck[:, j])
    return HeldTorque(clipped, stuck)


def held_notes(recording: Recording) -> tuple[str, ...]:
    """Notes on the joints whose torque was not measured at all times."""
    if recording.tau is None:
        return ()
    held = held_torque(recording.t, recording.q, recording.tau)
    notes = []
    for mask, what in ((held.clipped, CLIPPED), (held.stuck, STUCK)):
        shares = mask.mean(axis=0)
        columns = [f"tau{j + 1} {shares[j]:.1%}" for j in np.flatnonzero(shares)]
        if columns:
            notes.append(f"{what}: {', '.join(columns)}")
    return tuple(notes)


def _mark(
    t: np.ndarray,
    q: np.ndarray,
    series: np.ndarray,
    clipped: np.ndarray,
    stuck: np.ndarray,
) -> None:
    """Mark the samples of one joint's torque, (N,) each, that were not measured."""
    edges = np.flatnonzero(np.diff(series)) + 1
    # most torques never keep a value for three rows
    starts, stops = np.r_[0, edges], np.r_[edges, len(series)]
    lengths = stops - starts
    if lengths.max(initial=0) < 3 or len(lengths) < 3:
        return
    extreme = np.isin(series[starts], (series.min(), series.max()))
    long = t[stops - 1] - t[starts] >= STUCK_TIME
    usual = _usual(lengths[~extreme & ~long])
    least = HELD_MOTION * np.ptp(q)

    def moves(place: int) -> bool:
        return bool(np.ptp(q[starts[place] : stops[place]]) > least)

    for value in (series.min(), series.max()):
        at_limit = np.flatnonzero(series[starts] == value)
        longest = int(at_limit[lengths[at_limit].argmax()])
        if lengths[longest] > CLIPPED_RATIO * usual and moves(longest):
            clipped |= series == value
    for place in np.flatnonzero(long & ~extreme & (lengths > STUCK_RATIO * usual)):
        if moves(place):
            # the first of them was measured
            stuck[starts[place] + 1 : stops[place]] = True


def _usual(lengths: np.ndarray) -> float:
    """Time for which values usually last [rows]: below it they last in most rows; one row if there are none."""
    ordered = np.sort(lengths)
    rows = np.cumsum(ordered)
    if not len(rows):
        return 1.0
    return float(ordered[np.searchsorted(rows, USUAL_SHARE * rows[-1])])
