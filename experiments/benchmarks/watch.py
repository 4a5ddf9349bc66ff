"""A watch of seven joints: seconds of the processor per hour of a recording, by its rate, beside reading it alone.

The recording is one CSV file, followed from its start to its end as `gapscope watch --once` does, learning and state
included. 360 s an hour are a tenth of a core.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.corrected import CorrectedArm
from gapscope.watching.detector import WatchSettings
from gapscope.watching.watch import GrowingFile, Reading, Watch

from .measure import Point, Row, Settings, compared, in_turns

WATCH, READ = "watch", "reading the file alone"


@contextmanager
def loops(rate: float, seconds: float) -> Iterator[dict[str, Callable[[], object]]]:
    """A watch of a CSV file of seven joints, and its reading alone.

    Args:
        rate: of the recording [Hz].
        seconds: its length; more than two minutes, so that most of it is after learning.
    """
    arm = load_nominal_arm("kuka_iiwa")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "log.csv"
        write_columns(_columns(rate, seconds), file)

        def watch() -> object:
            with tempfile.TemporaryDirectory() as out:
                settings = WatchSettings(file, Path(out), until_idle=0.0)
                return list(Watch(CorrectedArm(arm), settings).run())

        def read() -> object:
            return sum(
                1 for _ in GrowingFile(file, Reading(arm, None), rest=0.0).poll()
            )

        yield {WATCH: watch, READ: read}


def _columns(rate: float, seconds: float) -> dict[str, np.ndarray]:
    """Time, positions and torque of sums of sines, with friction and noise."""
    rng = np.random.default_rng(46)
    t = np.arange(round(seconds * rate)) / rate
    frequency = 2 * np.pi * rng.uniform(0.05, 0.3, (7, 3))
    amplitude = rng.uniform(0.05, 0.3, (7, 3))
    angle = t[:, None, None] * frequency + np.arange(3)
    q = (amplitude * np.sin(angle)).sum(axis=2)
    dq = (amplitude * frequency * np.cos(angle)).sum(axis=2)
    ddq = -(amplitude * frequency**2 * np.sin(angle)).sum(axis=2)
    body = RigidBody(load_nominal_arm("kuka_iiwa"), 0)
    torque = body.inverse_dynamics(q, dq, ddq) + np.tanh(dq / 0.02)
    torque += 0.1 * rng.standard_normal(q.shape)
    columns = {"t": t}
    columns |= {f"q{j}": x for j, x in enumerate(q.T, start=1)}
    return columns | {f"tau{j}": x for j, x in enumerate(torque.T, start=1)}


RATES = (100.0, 500.0, 1000.0)
"""Of the recordings [Hz]."""
SECONDS, SHORT = 300.0, 130.0
"""Length of the recordings [s]."""


def points(settings: Settings) -> list[Point]:
    """A point for each rate."""
    seconds = SHORT if settings.quick else SECONDS
    rates = RATES[:1] if settings.quick else RATES
    return [
        Point(f"{rate:g} Hz", partial(_measured, rate, seconds, settings.rounds))
        for rate in rates
    ]


def _measured(rate: float, seconds: float, rounds: int) -> list[Row]:
    with threadpool_limits(1), loops(rate, seconds) as each:
        times = in_turns(each, rounds)
    return compared(
        times, READ, "s an hour", seconds / 3600, f"7 joints at {rate:g} Hz"
    )
