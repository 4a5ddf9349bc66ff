"""What loggers do to recordings, done to sound ones: for ``damages.py``.

A recording is a mapping of its columns, ``t`` of shape (N,) and channels of shape (N, n). A damage takes all recordings
of a case and gives back damaged copies; ranges and deviations are those of a joint over all recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

Columns = dict[str, np.ndarray]
Change = Callable[[list[Columns], np.random.Generator], list[Columns]]

CHANNELS = ("q", "dq", "tau", "q_ref", "dq_ref")


def read(path: Path) -> Columns:
    """A recording from CSV."""
    with path.open(encoding="utf-8") as file:
        head = file.readline().strip().split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    out = {"t": table[:, 0]}
    for channel in CHANNELS:
        places = [k for k, x in enumerate(head) if x.rstrip("0123456789") == channel]
        if places:
            out[channel] = table[:, places]
    return out


def write(columns: Columns, path: Path) -> None:
    """A recording to CSV."""
    head = ["t"]
    for name in columns.keys() - {"t"}:
        head += [f"{name}{j + 1}" for j in range(columns[name].shape[1])]
    series = [columns["t"], *(columns[name] for name in columns.keys() - {"t"})]
    text = ",".join(head)
    np.savetxt(
        path,
        np.column_stack(series),
        "%.8g",
        delimiter=",",
        header=text,
        comments="",
    )


def sampled(recording: Columns, rate: float) -> Columns:
    """Every so many-th row of a recording; above its own rate a faster log of the same arm.

    Positions and velocities between the rows by splines, with encoder noise of their own; the torque is held, as the
    controller holds it.
    """
    t = recording["t"]
    own = (len(t) - 1) / (t[-1] - t[0])
    if rate < 1.01 * own:
        return _rows(recording, slice(None, None, round(own / rate)))
    factor = round(rate / own)
    fine = t[0] + np.arange((len(t) - 1) * factor + 1) / rate
    held = np.arange(len(fine)) // factor
    rng = np.random.default_rng(0)
    out = {"t": fine}
    for name in recording.keys() - {"t"}:
        series = recording[name]
        if name == "tau":
            out[name] = series[held]
            continue
        out[name] = make_interp_spline(t, series, k=3)(fine)
        if name == "q":
            out[name] += _noise(series) * rng.standard_normal(out[name].shape)
    return out


def _noise(series: np.ndarray) -> np.ndarray:
    """Deviation of white noise, by third differences, (n,)."""
    third = np.diff(series, n=3, axis=0)
    return np.asarray(np.median(np.abs(third), axis=0) / 0.6745 / np.sqrt(20))


def _rows(recording: Columns, rows: np.ndarray | slice) -> Columns:
    return {name: series[rows] for name, series in recording.items()}


def of_each(
    change: Callable[[Columns, np.random.Generator], Columns],
) -> Change:
    """A damage that is done to each recording by itself."""
    return lambda recordings, rng: [change(r, rng) for r in recordings]


# --- time


def dropped(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """Rows lost at random."""
    return _rows(r, rng.random(len(r["t"])) >= share)


def gap(r: Columns, rng: np.random.Generator, seconds: float) -> Columns:
    """A stretch lost, not at the ends."""
    t = r["t"]
    begin = rng.uniform(t[0] + 1.5, t[-1] - 1.5 - seconds)
    return _rows(r, (t < begin) | (t >= begin + seconds))


def same_stamp(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """The clock was read before it had moved on: the stamp before once more."""
    source = np.arange(len(r["t"])) - (rng.random(len(r["t"])) < share)
    return {**r, "t": r["t"][np.maximum(source, 0)]}


def stored_twice(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """The measurement before once more, with a new stamp."""
    source = np.arange(len(r["t"])) - (rng.random(len(r["t"])) < share)
    return {**_rows(r, np.maximum(source, 0)), "t": r["t"]}


def jitter(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """Stamps off by a normal error, in order."""
    t, step = r["t"], r["t"][1] - r["t"][0]
    late = t + share * step * rng.standard_normal(len(t))
    ahead = 0.01 * step * np.arange(len(t))  # a step lasts a hundredth at least
    return {**r, "t": np.maximum.accumulate(late - ahead) + ahead}


def slow_torque(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """The torque's clock loses against the arm's: what is stored at t was measured before."""
    t = r["t"]
    measured = t[0] + (t - t[0]) * (1 - share)
    return {**r, "tau": make_interp_spline(t, r["tau"], k=1)(measured)}


def slow_clock(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """All stamps count too little time."""
    t = r["t"]
    return {**r, "t": t[0] + (t - t[0]) * (1 - share)}


# --- values


def _stacked(recordings: Iterable[Columns], channel: str) -> np.ndarray:
    return np.vstack([r[channel] for r in recordings])


def clipped(
    recordings: list[Columns], rng: np.random.Generator, share: float
) -> list[Columns]:
    """Torque up to a share of its peak alone."""
    most = share * np.abs(_stacked(recordings, "tau")).max(axis=0)
    return [{**r, "tau": np.clip(r["tau"], -most, most)} for r in recordings]


def quantised(
    recordings: list[Columns], rng: np.random.Generator, share: float
) -> list[Columns]:
    """Torque in steps of a share of its range."""
    step = share * np.ptp(_stacked(recordings, "tau"), axis=0)
    return [{**r, "tau": step * np.round(r["tau"] / step)} for r in recordings]


def spikes(
    recordings: list[Columns],
    rng: np.random.Generator,
    channel: str,
    share: float,
    size: float,
) -> list[Columns]:
    """Single samples of a joint off by so many deviations, to either side."""
    deviation = _stacked(recordings, channel).std(axis=0)

    def spiked(series: np.ndarray) -> np.ndarray:
        hit = rng.random(series.shape) < share
        side = rng.choice([-1.0, 1.0], series.shape)
        return series + hit * side * size * deviation

    return [{**r, channel: spiked(r[channel])} for r in recordings]


def stuck(
    recordings: list[Columns],
    rng: np.random.Generator,
    channel: str,
    share: float,
    seconds: float,
) -> list[Columns]:
    """One joint's channel keeps its value for a share of each recording and so many seconds more."""
    joint = int(rng.integers(recordings[0][channel].shape[1]))
    out = []
    for r in recordings:
        series, rate = r[channel].copy(), 1.0 / (r["t"][1] - r["t"][0])
        length = round(share * len(series) + seconds * rate)
        begin = int(rng.integers(0, len(series) - length))
        series[begin : begin + length, joint] = series[begin, joint]
        out.append({**r, channel: series})
    return out


def without_velocity(r: Columns, rng: np.random.Generator) -> Columns:
    """No velocity was logged."""
    return {name: series for name, series in r.items() if name != "dq"}
