"""Recordings as loggers leave them: what ``52_data_as_it_is.py`` does to sound ones, and how long these are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from experiments.damaged_recordings import (
    Change,
    clipped,
    dropped,
    gap,
    jitter,
    of_each,
    quantised,
    same_stamp,
    slow_clock,
    slow_torque,
    spikes,
    stored_twice,
    stuck,
    without_velocity,
)

USUAL_RATE = 500
"""Rate of a sound recording [Hz]."""
ROBOTS = ("small", "xarm6", "ur5_like")


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


STAMPS = "time_stamps"
DAMAGES = (
    Damage("clean", f"as recorded, {USUAL_RATE} Hz, 8 s"),
    Damage("dropped_2", "2 % of the rows lost", of_each(partial(dropped, share=0.02))),
    Damage("dropped_10", "10 % of the rows lost", of_each(partial(dropped, share=0.1))),
    Damage("gap", "0.5 s lost", of_each(partial(gap, seconds=0.5)), fault=STAMPS),
    Damage(
        "same_stamp",
        "5 % of the stamps repeat the one before",
        of_each(partial(same_stamp, share=0.05)),
        fault=STAMPS,
    ),
    Damage(
        "stored_twice",
        "5 % of the rows repeat the one before",
        of_each(partial(stored_twice, share=0.05)),
        fault=STAMPS,
    ),
    Damage(
        "jitter_20",
        "stamps off by 20 % of a step",
        of_each(partial(jitter, share=0.2)),
        fault=STAMPS,
    ),
    Damage(
        "jitter_50",
        "stamps off by 50 % of a step",
        of_each(partial(jitter, share=0.5)),
        fault=STAMPS,
    ),
    Damage(
        "slow_torque",
        "clock of the torque 0.5 % slow",
        of_each(partial(slow_torque, share=0.005)),
        fault=STAMPS,
    ),
    Damage(
        "slow_clock",
        "clock of everything 1 % slow",
        of_each(partial(slow_clock, share=0.01)),
        fault=STAMPS,
    ),
    Damage(
        "clipped", "torque clipped at 60 % of its peak", partial(clipped, share=0.6)
    ),
    Damage(
        "torque_spikes",
        "0.5 % of the torques off by 10 deviations",
        partial(spikes, channel="tau", share=0.005, size=10.0),
    ),
    Damage(
        "position_spikes",
        "0.5 % of the positions off by 10 deviations",
        partial(spikes, channel="q", share=0.005, size=10.0),
    ),
    Damage(
        "small_position_spikes",
        "0.5 % of the positions off by 0.1 deviations",
        partial(spikes, channel="q", share=0.005, size=0.1),
    ),
    Damage(
        "stuck_torque",
        "a joint's torque stands for 20 % of the time",
        partial(stuck, channel="tau", share=0.2, seconds=0.0),
    ),
    Damage(
        "stuck_position",
        "a joint's position stands for 1 s",
        partial(stuck, channel="q", share=0.0, seconds=1.0),
    ),
    Damage("no_velocity", "no velocity", of_each(without_velocity)),
    Damage(
        "coarse_1",
        "torque in steps of 1 % of its range",
        partial(quantised, share=0.01),
    ),
    Damage(
        "coarse_3",
        "torque in steps of 3 % of its range",
        partial(quantised, share=0.03),
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
