"""What is drawn of a log: positions, velocities, torques and their spectra, one panel each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from gapscope.inspection.inspection import Inspection
from gapscope.inspection.units import LARGEST

POINTS = 3000
"""Most points of a curve."""
CHANNELS_DRAWN = {
    "q": "position",
    "q_ref": "reference",
    "dq": "velocity",
    "tau": "torque",
    "tau_sensor": "torque sensor",
}
"""Channels that are drawn over time, and their names."""


@dataclass(frozen=True)
class Panel:
    """One panel: a curve for each joint.

    Attributes:
        title: of the ordinate, with its unit.
        x: abscissa: time [s] or frequency [Hz], (M,).
        curves: (M, n).
        spectrum: whether the abscissa is a frequency; both axes are then logarithmic.
    """

    title: str
    x: np.ndarray
    curves: np.ndarray
    spectrum: bool = False


def panels_of(found: Inspection, number: int) -> list[Panel]:
    """Panels of one recording.

    Args:
        found: what is in the logs.
        number: of the recording, from 0.
    """
    return [*_over_time(found, number), *_spectra(found, number)]


def _series(
    found: Inspection, number: int, channel: str
) -> tuple[np.ndarray, np.ndarray, str] | None:
    """Time [s], values in the unit of the log, and that unit; ``None`` if the log has no such channel."""
    if channel not in found.chosen:
        return None
    label, _ = found.chosen[channel]
    table = found.entries[number][label]
    guess = table.best(channel)
    if guess is None:
        return None
    return table.time.seconds, guess.group.values, guess.unit


def _over_time(found: Inspection, number: int) -> Iterator[Panel]:
    for channel, name in CHANNELS_DRAWN.items():
        series = _series(found, number, channel)
        if series is not None:
            t, values, unit = series
            step = -(-len(t) // POINTS)
            drawn = np.where(np.abs(values) < LARGEST, values, np.nan)
            yield Panel(f"{name} [{unit}]", t[::step], drawn[::step])


def _spectra(found: Inspection, number: int) -> Iterator[Panel]:
    """Amplitude spectral densities of what moves and of the torque."""
    for channel, name in (("q", "position"), ("tau", "torque")):
        series = _series(found, number, channel)
        if series is None or not (np.abs(series[1]) < LARGEST).all():
            continue
        t, values, unit = series
        rate = 1.0 / float(np.median(np.diff(t)))
        frequency, power = welch(values, rate, nperseg=min(len(t), 1024), axis=0)
        yield Panel(
            f"spectrum of {name} [{unit}/√Hz]",
            frequency[1:],
            np.sqrt(power[1:]),
            spectrum=True,
        )
