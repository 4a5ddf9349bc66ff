"""Accuracy on recordings as loggers leave them: rows lost, wrong stamps, spikes, stuck sensors, rates, lengths.

    .venv/bin/python experiments/52_data_as_it_is.py OUT [--only NAME ...] [--cases N] [--robots NAME ...]

Makes a set of cases with the blind check's generator, each recorded at 1 kHz: one of every effect of the catalogue, the
rest healthy. Each damage is done to copies of the recordings, the labels untouched; the cases are read and diagnosed as
a user's are, and scored as ``gapscope blind score`` does. The set-up fault that is what a damage is may be named, and
does not count as an effect. Recordings of other lengths are made from the same seed.

A recording is a mapping of its columns, ``t`` of shape (N,) and channels of shape (N, n). A damage takes all recordings
of a case and gives back damaged copies; ranges and deviations are those of a joint over all recordings.

Resumable: a diagnosis that is in OUT is kept. ``--only`` restricts the damages, ``--cases`` takes the first N of the
cases.
"""

from __future__ import annotations

import shutil
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import yaml
from common import command_line
from generator_arms import make_generated
from scipy.interpolate import make_interp_spline

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.blind_check.check import BlindPlan, allocate_cases
from gapscope.blind_check.generator.laws import INSIDE
from gapscope.blind_check.scoring import Compared, compare
from gapscope.diagnosis.diagnose import diagnose

# What loggers do to recordings

Columns = dict[str, np.ndarray]
Change = Callable[[list[Columns], np.random.Generator], list[Columns]]

CHANNELS = ("q", "dq", "tau", "q_ref", "dq_ref")


def read(path: Path) -> Columns:
    """A recording from CSV."""
    table = pd.read_csv(path, float_precision="round_trip")
    out = {"t": table["t"].to_numpy()}
    for channel in CHANNELS:
        own = table.filter(regex=rf"^{channel}\d+$")
        if not own.empty:
            out[channel] = own.to_numpy()
    return out


def write(columns: Columns, path: Path) -> None:
    """A recording to CSV."""
    series = {"t": columns["t"]}
    for name in columns.keys() - {"t"}:
        series |= {f"{name}{j}": x for j, x in enumerate(columns[name].T, 1)}
    pd.DataFrame(series).to_csv(path, index=False, float_format="%.8g")


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
    return np.median(np.abs(third), axis=0) / 0.6745 / np.sqrt(20)


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


def _before(r: Columns, rng: np.random.Generator, share: float) -> np.ndarray:
    """Numbers of the rows, of a share of them that of the row before."""
    source = np.arange(len(r["t"])) - (rng.random(len(r["t"])) < share)
    return np.maximum(source, 0)


def same_stamp(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """The clock was read before it had moved on: the stamp before once more."""
    return {**r, "t": r["t"][_before(r, rng, share)]}


def stored_twice(r: Columns, rng: np.random.Generator, share: float) -> Columns:
    """The measurement before once more, with a new stamp."""
    return {**_rows(r, _before(r, rng, share)), "t": r["t"]}


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
    size: float = 10.0,
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
    share: float = 0.0,
    seconds: float = 0.0,
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


# Damages and lengths

USUAL_RATE = 500
"""Rate of a sound recording [Hz]."""
ROBOTS = ("small", "xarm6", "ur5_like")


class Length(NamedTuple):
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


class Damage(NamedTuple):
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


def in_time(name: str, text: str, change: Any, **values: float) -> Damage:
    """A damage of the stamps or rows of each recording by itself, which may be named as a fault of the stamps."""
    return Damage(name, text, of_each(partial(change, **values)), fault=STAMPS)


def in_values(name: str, text: str, change: Any, **values: Any) -> Damage:
    """A damage of the values of all recordings."""
    return Damage(name, text, partial(change, **values))


DAMAGES = (
    Damage("clean", f"as recorded, {USUAL_RATE} Hz, 8 s"),
    Damage("dropped_2", "2 % of the rows lost", of_each(partial(dropped, share=0.02))),
    Damage("dropped_10", "10 % of the rows lost", of_each(partial(dropped, share=0.1))),
    in_time("gap", "0.5 s lost", gap, seconds=0.5),
    in_time("same_stamp", "5 % of the stamps repeat the one before", same_stamp, share=0.05),
    in_time("stored_twice", "5 % of the rows repeat the one before", stored_twice, share=0.05),
    in_time("jitter_20", "stamps off by 20 % of a step", jitter, share=0.2),
    in_time("jitter_50", "stamps off by 50 % of a step", jitter, share=0.5),
    in_time("slow_torque", "clock of the torque 0.5 % slow", slow_torque, share=0.005),
    in_time("slow_clock", "clock of everything 1 % slow", slow_clock, share=0.01),
    in_values("clipped", "torque clipped at 60 % of its peak", clipped, share=0.6),
    in_values("torque_spikes", "0.5 % of the torques off by 10 deviations", spikes, channel="tau", share=0.005),
    in_values("position_spikes", "0.5 % of the positions off by 10 deviations", spikes, channel="q", share=0.005),
    in_values("stuck_torque", "a joint's torque stands for 20 % of the time", stuck, channel="tau", share=0.2),
    in_values("stuck_position", "a joint's position stands for 1 s", stuck, channel="q", seconds=1.0),
    Damage("no_velocity", "no velocity", of_each(lambda r, rng: {k: x for k, x in r.items() if k != "dq"})),
    in_values("coarse_1", "torque in steps of 1 % of its range", quantised, share=0.01),
    in_values("coarse_3", "torque in steps of 3 % of its range", quantised, share=0.03),
    Damage("rate_30", "30 Hz", rate=30),
    Damage("rate_100", "100 Hz", rate=100),
    Damage("rate_1000", "1 kHz", rate=1000),
    Damage("rate_5000", "5 kHz", rate=5000),
    Damage("length_5", "recordings of 5 s", length=SHORT),
    Damage("length_60", "recordings of 60 s", length=LONG),
    Damage("hour", "two recordings of 30 min, 100 Hz", rate=100, length=HOUR),
)  # fmt: skip
"""All damages, the sound recordings first."""


# Cases, diagnoses and scores

SEED = 52
HEALTHY = 8
"""Cases without an effect."""
HEAD = "| recordings | cases | first effect right | exact | false alarms | unexplained | refused | told of |"


class Outcome(NamedTuple):
    """What became of one case.

    Attributes:
        compared: the diagnosis beside its label.
        fault: whether the damage was named as a fault of the set-up.
        notes: warnings and notes.
        error: why there is no diagnosis, or ``""``.
    """

    compared: Compared
    fault: bool
    notes: frozenset[str]
    error: str


def made(
    out: Path, length: Length, count: int, robots: Sequence[str]
) -> Iterator[tuple[str, Path, Any]]:
    """Cases of some robots with recordings of a length: name, folder and label; those that are there are kept."""
    effects = length.effects or INSIDE
    plan = BlindPlan(
        singles=len(effects),
        pairs=0,
        triples=0,
        outside=0,
        healthy=0 if length.effects else HEALTHY,
        ladder=0,
        effects=effects,
        robots=length.robots,
        duration=(length.seconds, length.seconds),
    )
    specs = allocate_cases(plan, SEED)[: min(count, length.cases)]
    for k, spec in enumerate(specs):
        if spec.conditions.robot not in robots:
            continue
        conditions = spec.conditions._replace(
            loop_rate=1000, rate=length.rate, recordings=length.recordings
        )
        spec = spec._replace(conditions=conditions)
        name = f"case{k:04d}"
        folder, label = out / name, out / "labels" / f"{name}.json"
        yield name, folder, make_generated(spec, (SEED, 2, k), folder, label)


def damaged(case: Path, damage: Damage, out: Path) -> None:
    """Write the case with damaged recordings into a folder."""
    content = yaml.safe_load((case / "case.yaml").read_text(encoding="utf-8"))
    rng = np.random.default_rng(zlib.crc32(f"{damage.name} {case.name}".encode()))
    recordings = [sampled(read(case / f), damage.rate) for f in content["recordings"]]
    for name, columns in zip(
        content["recordings"], damage.change(recordings, rng), strict=True
    ):
        write(columns, out / name)
    for name in ("case.yaml", "robot.urdf"):
        shutil.copy(case / name, out / name)


def diagnosed(case: Path, damage: Damage, file: Path) -> dict[str, Any]:
    """Diagnosis of a case under a damage, or why there is none; stored in a file."""
    if file.is_file():
        return read_json(file, "remove it")
    begun = time.process_time()
    result = {"error": "", "document": None}
    with tempfile.TemporaryDirectory(prefix="gapscope_damaged_") as folder:
        damaged(case, damage, Path(folder))
        try:
            result["document"] = diagnose(load_case(folder, any_unit=True)).document
        except GapscopeError as error:
            result["error"] = str(error).replace(f"{folder}/", "")
    result["seconds"] = round(time.process_time() - begun, 2)
    write_json(result, file)
    return result


def outcome(
    name: str, label: dict[str, Any], damage: Damage, result: dict[str, Any]
) -> Outcome:
    """A diagnosis beside its label, without the fault that the damage is."""
    document = result["document"]
    if document is None:
        return Outcome(compare(name, label, None), False, frozenset(), result["error"])
    notes = frozenset(document["warnings"])
    effects = [e for e in document["effects"] if e["effect"] != damage.fault]
    named = len(effects) < len(document["effects"])
    if named:
        document = {**document, "effects": effects}
        if document["verdict"] == "effects_found" and not effects:
            document["verdict"] = "no_gap"
    return Outcome(compare(name, label, document), named, notes, "")


def shares(outcomes: list[Outcome], clean: dict[str, Outcome]) -> list[list[bool]]:
    """What is counted under a damage, by case: of single effects, of healthy arms, of all."""

    def known(own: Outcome) -> frozenset[str]:
        """What is said of the sound recordings of a case."""
        name = own.compared.name
        return clean[name].notes if name in clean else frozenset()

    cases = [o.compared for o in outcomes]
    single = [c for c in cases if c.kind == "single"]
    healthy = [c for c in cases if c.kind == "healthy"]
    return [
        [c.top for c in single],
        [c.exact for c in single],
        [c.verdict not in ("no_gap", "failed") for c in healthy],
        [c.verdict == "unexplained" for c in single],
        [c.verdict == "failed" for c in cases],
        [bool(o.fault or o.error or o.notes - known(o)) for o in outcomes],
    ]


def line(damage: Damage, count: int, own: list[list[bool]]) -> str:
    """A row of the table."""
    cells = [f"{100 * sum(x) / len(x):.0f} %" if x else "–" for x in own]
    return f"| {damage.text} | {count} | {' | '.join(cells)} |"


def main() -> None:
    """Make, damage, diagnose, score."""
    options = command_line(
        __doc__,
        "out",
        cases=30,
        only={"nargs": "*", "choices": [d.name for d in DAMAGES]},
        robots={"nargs": "*", "choices": ROBOTS, "default": ROBOTS},
    ).parse_args()
    print(HEAD, "|---" * 8 + "|", sep="\n")
    clean = {}
    for damage in DAMAGES:
        if options.only and damage.name not in (*options.only, "clean"):
            continue
        results = options.out / "results" / damage.name
        folder = options.out / f"cases_{damage.length.seconds:g}s"
        outcomes = [
            outcome(name, label, damage, diagnosed(case, damage, results / f"{name}.json"))
            for name, case, label in made(folder, damage.length, options.cases, options.robots)
        ]  # fmt: skip
        if outcomes:
            clean = clean or {o.compared.name: o for o in outcomes}
            print(line(damage, len(outcomes), shares(outcomes, clean)), flush=True)


if __name__ == "__main__":
    main()
