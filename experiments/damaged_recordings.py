"""Recordings as loggers leave them: what is done to sound recordings of a case, for ``52_data_as_it_is.py``.

A recording is a mapping of its columns, ``t`` of shape (N,) and channels of shape (N, n). A damage takes all recordings
of a case and gives back damaged copies; ranges and deviations are those of a joint over all recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

Columns = dict[str, np.ndarray]
Change = Callable[[list[Columns], np.random.Generator], list[Columns]]

USUAL_RATE = 500
"""Rate of a sound recording [Hz]."""
ROBOTS = ("small", "xarm6", "ur5_like")
CHANNELS = ("q", "dq", "tau", "q_ref", "dq_ref")


@dataclass(frozen=True)
class Length:
    """Which cases are made, and how long they are recorded.

    Attributes:
        seconds: length of each recording [s].
        rate: at which it is made [Hz].
        recordings: number of them in a case.
        cases: number of cases at most.
        effects, robots: names of those drawn from; no effects: all of the catalogue.
    """

    seconds: float
    rate: int = 1000
    recordings: int = 3
    cases: int = 30
    effects: tuple[str, ...] = ()
    robots: tuple[str, ...] = ROBOTS


USUAL, SHORT, LONG = Length(8.0), Length(5.0), Length(60.0, cases=12)
HOUR = Length(1800.0, 100, 2, 1, ("payload",), ("small",))


@dataclass(frozen=True)
class Damage:
    """What is done to the recordings of a case.

    Attributes:
        name: short, a file name too.
        text: what it is, with figures.
        change: does it, to recordings at ``rate``.
        rate: at which the sound recordings are sampled before [Hz].
        fault: set-up fault that it is and that may be named, or ``""``.
        length: of the recordings.
    """

    name: str
    text: str
    change: Change = lambda recordings, rng: recordings
    rate: int = USUAL_RATE
    fault: str = ""
    length: Length = USUAL


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


def _dropped(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    return _rows(r, rng.random(len(r["t"])) >= share)


def _gap(r: Columns, rng: np.random.Generator, seconds: float) -> Columns:
    t = r["t"]
    begin = rng.uniform(t[0] + 1.5, t[-1] - 1.5 - seconds)
    return _rows(r, (t < begin) | (t >= begin + seconds))


def _same_stamp(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """The clock was read before it had moved on: the stamp before once more."""
    source = np.arange(len(r["t"])) - (rng.random(len(r["t"])) < share)
    return {**r, "t": r["t"][np.maximum(source, 0)]}


def _stored_twice(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """The measurement before once more, with a new stamp."""
    source = np.arange(len(r["t"])) - (rng.random(len(r["t"])) < share)
    return {**_rows(r, np.maximum(source, 0)), "t": r["t"]}


def _jitter(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """Stamps off by a normal error, in order."""
    t, step = r["t"], r["t"][1] - r["t"][0]
    late = t + share * step * rng.standard_normal(len(t))
    ahead = 0.01 * step * np.arange(len(t))  # a step lasts a hundredth at least
    return {**r, "t": np.maximum.accumulate(late - ahead) + ahead}


def _slow_torque(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """The torque's clock loses against the arm's: what is stored at t was measured before."""
    t = r["t"]
    measured = t[0] + (t - t[0]) * (1 - share)
    return {**r, "tau": make_interp_spline(t, r["tau"], k=1)(measured)}


def _slow_clock(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    t = r["t"]
    return {**r, "t": t[0] + (t - t[0]) * (1 - share)}


# --- values


def _stacked(recordings: Iterable[Columns], channel: str) -> np.ndarray:
    return np.vstack([r[channel] for r in recordings])


def _clipped(
    recordings: list[Columns], rng: np.random.Generator, share: float
) -> list[Columns]:
    most = share * np.abs(_stacked(recordings, "tau")).max(axis=0)
    return [{**r, "tau": np.clip(r["tau"], -most, most)} for r in recordings]


def _quantised(
    recordings: list[Columns], rng: np.random.Generator, share: float
) -> list[Columns]:
    step = share * np.ptp(_stacked(recordings, "tau"), axis=0)
    return [{**r, "tau": step * np.round(r["tau"] / step)} for r in recordings]


def _spikes(
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


def _stuck(
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


def _without_velocity(r: Columns, rng: np.random.Generator) -> Columns:
    return {name: series for name, series in r.items() if name != "dq"}


STAMPS = "time_stamps"
DAMAGES = (
    Damage("clean", f"as recorded, {USUAL_RATE} Hz, 8 s"),
    Damage("dropped_2", "2 % of the rows lost", of_each(partial(_dropped, share=0.02))),
    Damage(
        "dropped_10", "10 % of the rows lost", of_each(partial(_dropped, share=0.1))
    ),
    Damage("gap", "0.5 s lost", of_each(partial(_gap, seconds=0.5)), fault=STAMPS),
    Damage(
        "same_stamp",
        "5 % of the stamps repeat the one before",
        of_each(partial(_same_stamp, share=0.05)),
        fault=STAMPS,
    ),
    Damage(
        "stored_twice",
        "5 % of the rows repeat the one before",
        of_each(partial(_stored_twice, share=0.05)),
        fault=STAMPS,
    ),
    Damage(
        "jitter_20",
        "stamps off by 20 % of a step",
        of_each(partial(_jitter, share=0.2)),
        fault=STAMPS,
    ),
    Damage(
        "jitter_50",
        "stamps off by 50 % of a step",
        of_each(partial(_jitter, share=0.5)),
        fault=STAMPS,
    ),
    Damage(
        "slow_torque",
        "clock of the torque 0.5 % slow",
        of_each(partial(_slow_torque, share=0.005)),
        fault=STAMPS,
    ),
    Damage(
        "slow_clock",
        "clock of everything 1 % slow",
        of_each(partial(_slow_clock, share=0.01)),
        fault=STAMPS,
    ),
    Damage(
        "clipped", "torque clipped at 60 % of its peak", partial(_clipped, share=0.6)
    ),
    Damage(
        "torque_spikes",
        "0.5 % of the torques off by 10 deviations",
        partial(_spikes, channel="tau", share=0.005, size=10.0),
    ),
    Damage(
        "position_spikes",
        "0.5 % of the positions off by 10 deviations",
        partial(_spikes, channel="q", share=0.005, size=10.0),
    ),
    Damage(
        "small_position_spikes",
        "0.5 % of the positions off by 0.1 deviations",
        partial(_spikes, channel="q", share=0.005, size=0.1),
    ),
    Damage(
        "stuck_torque",
        "a joint's torque stands for 20 % of the time",
        partial(_stuck, channel="tau", share=0.2, seconds=0.0),
    ),
    Damage(
        "stuck_position",
        "a joint's position stands for 1 s",
        partial(_stuck, channel="q", share=0.0, seconds=1.0),
    ),
    Damage("no_velocity", "no velocity", of_each(_without_velocity)),
    Damage(
        "coarse_1",
        "torque in steps of 1 % of its range",
        partial(_quantised, share=0.01),
    ),
    Damage(
        "coarse_3",
        "torque in steps of 3 % of its range",
        partial(_quantised, share=0.03),
    ),
    Damage("rate_30", "30 Hz", rate=30),
    Damage("rate_100", "100 Hz", rate=100),
    Damage("rate_1000", "1 kHz", rate=1000),
    Damage("rate_5000", "5 kHz", rate=5000),
    Damage("length_5", "recordings of 5 s", length=SHORT),
    Damage("length_60", "recordings of 60 s", length=LONG),
    Damage("hour", "two recordings of 30 min, 100 Hz", rate=100, length=HOUR),
)
"""All damages, the sound recordings first."""
