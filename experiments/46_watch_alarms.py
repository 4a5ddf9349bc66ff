"""False alarms of a watch per 24 h, what it names and how late, and what it costs.

    .venv/bin/python experiments/46_watch_alarms.py --out out/watch [--hours 4] [--arms 12] [--jobs 2] [--training]

Parts, each a JSON file per arm in ``--out`` so that a rerun goes on, and a table on standard output:

healthy   arms at work (``watched_arms.py``: laws, heat and noise of another form than the model's) without any change,
          ``--hours`` each: programs that change, speeds, half of them started cold. Alarms, misfits, and slow drifts
          noted.
changes   the same arms; after three minutes a load, friction, an offset, an encoder's zero, a delay or a force changes,
          and the watch goes on for two minutes: named right, misnamed, missed, how late, how far off.
real      recordings of real arms, ``--hours`` each: stretches of 5 to 15 s at random places and in random order; those
          of the last 40 % of each recording come only when what is normal was learnt from the others. A stretch that
          comes again has the same noise: that is fewer different motions than the hours say. Then with loads and
          friction added to the torque from some moment on, which is a recovery check.
speed     processor time of a watch per second of a recording of seven joints at 1 kHz, from file to state.

``--training`` takes other arms: those on which the numbers of ``gapscope/watching/thresholds.py`` were set by hand.
"""

from __future__ import annotations

import argparse
import copy
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.watch import READ, WATCH, shares
from joblib import Parallel, delayed
from scipy.stats import chi2
from threadpoolctl import threadpool_limits
from watched_arms import Change, WorkingArm

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.watching.alarm import ALARM, DRIFT, MISFIT, Event
from gapscope.watching.detector import Detector

CASES = Path(__file__).parent / "cases"
REAL = ("ur10", "panda", "kuka_med7", "unitree_z1")
"""Real arms with a recording of 15 s or more."""
TRAINING = 1000
"""Added to the seeds of arms on which thresholds were set."""
BEFORE, AFTER = 180.0, 120.0
"""Work before and after a change [s]."""
LOADS = (0.03, 0.1, 0.3)
"""Loads over the largest that the arm carries [1]."""
FRICTION = (0.15, 0.3, 0.6, 1.0)
"""Rise of a joint's friction [1]."""
OFFSETS = (0.1, 0.3, 1.0)
"""Torque offsets over the joint's friction at half a radian per second [1]."""
ZEROS = (0.5, 1.0, 3.0)
"""Encoder offsets [deg]."""
FOUND = (ALARM, MISFIT)
"""Events that say that something has changed."""


def feed(watched: Detector, parts: Iterable[Recording]) -> Iterator[Event]:
    """Events of some parts of recordings."""
    for part in parts:
        yield from watched.add(part)


def fork(watched: Detector) -> Detector:
    """A detector in the same state that goes on by itself."""
    other, state = copy.copy(watched), watched.state
    other.stream = copy.copy(watched.stream)
    other.state = replace(
        state,
        drift=state.drift.copy(),
        said=state.said.copy(),
        now=list(state.now),
        known=dict(state.known),
        free=dict(state.free),
    )
    return other


def healthy(seed: int, hours: float) -> dict[str, Any]:
    """Alarms of an arm without a change."""
    arm = WorkingArm(seed, start_cold=seed % 2 == 0)
    watched = Detector(CorrectedArm(arm.nominal))
    begin = time.process_time()
    events = list(feed(watched, arm.chunks(3600 * hours)))
    return {
        "robot": arm.kind,
        "noise": arm.colour,
        "cold": arm.start_cold,
        "hours": hours,
        "alarms": [e.sentence for e in events if e.event == ALARM],
        "effects": [e.effect for e in events if e.event == ALARM],
        "misfits": sum(e.event == MISFIT for e in events),
        "drifts": [e.sentence for e in events if e.event == DRIFT],
        "cpu": (time.process_time() - begin) / (3600 * hours),
    }


def draws(arm: WorkingArm) -> Iterator[Change]:
    """Changes of all kinds and sizes on an arm; joints by turns."""
    n, turn = arm.sheet.n, arm.seed
    for share in LOADS:
        mass = share * arm.sheet.payload
        yield Change("payload", f"load, {share:.0%} of the largest", None, mass)
    for k, share in enumerate(FRICTION):
        joint = (turn + k) % n
        size = share * arm.friction_level(joint)
        yield Change("friction", f"friction +{share:.0%}", joint + 1, size)
    for k, share in enumerate(OFFSETS):
        joint = (turn + k) % n
        size = share * arm.friction_level(joint)
        label = f"offset of {share:.0%} of the friction"
        yield Change("torque_offset", label, joint + 1, size)
    for k, degrees in enumerate(ZEROS):
        # no gravity tells of the last joint's zero, nor of that of an upright first one
        joint = 1 + (turn + k) % max(n - 2, 1)
        label = f"encoder zero off by {degrees:g} deg"
        yield Change("encoder_offset", label, joint + 1, float(np.deg2rad(degrees)))
    yield Change("other", "delay of 20 ms", None, 0.02)
    force = 0.3 * 9.81 * arm.sheet.payload
    yield Change("other", "force on the tip that stays, 30 % of a load", None, force)


def changes(seed: int) -> list[dict[str, Any]]:
    """Every change on one arm, each from the same state before it."""
    arm = WorkingArm(seed)
    watched = Detector(CorrectedArm(arm.nominal))
    events = feed(watched, arm.chunks(BEFORE))
    before = [e.sentence for e in events if e.event == ALARM]
    rows = []
    for change in draws(arm):
        own = copy.copy(arm)
        own.rng = np.random.default_rng([seed, 2])
        own.c, own.b, own.load = arm.c.copy(), arm.b.copy(), arm.load.copy()
        own.offset, own.zero = arm.offset.copy(), arm.zero.copy()
        own._queue, own._filters = list(arm._queue), dict(arm._filters)
        own.change(change)
        told = feed(fork(watched), own.chunks(AFTER))
        events = [e for e in told if e.event in FOUND]
        rows.append(judged(change, events, own.t - AFTER))
    return [{"robot": arm.kind, "before": before, **row} for row in rows]


def judged(change: Change, events: list[Event], moment: float) -> dict[str, Any]:
    """What became of a change: the first alarm or misfit counts, later ones are counted."""
    row: dict[str, Any] = {
        "effect": change.effect,
        "label": change.label,
        "joint": change.joint,
        "size": change.size,
        "sentences": [e.sentence for e in events],
        "outcome": "missed",
        "further": max(len(events) - 1, 0),
    }
    if not events:
        return row
    first = events[0]
    joints = [] if change.joint is None else [change.joint]
    # a misfit has the effect ``other``, and so has a change without a name
    same = first.effect == change.effect and (
        change.effect == "other" or list(first.joints) == joints
    )
    row["outcome"] = "right" if same else f"called {first.effect}"
    row["delay"] = first.detected - moment
    if same and first.sizes:
        size = next(iter(first.sizes.values()))
        row["error"] = size.value / change.size - 1.0
    return row


def real(name: str, hours: float) -> dict[str, Any]:
    """Alarms of stretches of a real arm's recordings, and of changes that are added to them."""
    case = load_case(CASES / f"{name}.yaml", any_unit=True)
    recordings = [r for r in case.recordings if r.tau is not None]
    watched = Detector(CorrectedArm(case.arm))
    rng = np.random.default_rng([46, REAL.index(name)])
    begin = time.process_time()
    events = list(feed(watched, stretches(recordings, 120.0, rng, (0.0, 0.6))))
    rest = 3600 * hours - 120.0
    events += feed(watched, stretches(recordings, rest, rng, (0.0, 1.0)))
    used = time.process_time() - begin
    alarms = [e for e in events if e.event == ALARM]
    rows = []
    body = RigidBody(case.arm)
    for change in real_changes(recordings, case.arm.n_joints):
        changed = [with_change(r, change, body) for r in recordings]
        parts = stretches(changed, AFTER, np.random.default_rng(1), (0.0, 1.0))
        found = [e for e in feed(fork(watched), parts) if e.event in FOUND]
        row = judged(change, found, float("nan"))
        row["delay"] = None
        rows.append(row)
    return {
        "robot": name,
        "hours": hours,
        "alarms": [e.sentence for e in alarms],
        "effects": [e.effect for e in alarms],
        "misfits": sum(e.event == MISFIT for e in events),
        "changes": rows,
        "cpu": used / (3600 * hours),
    }


def stretches(
    recordings: list[Recording],
    seconds: float,
    rng: np.random.Generator,
    within: tuple[float, float],
) -> Iterator[Recording]:
    """Pieces of recordings between two shares of their length, at random, until they last for a time [s]."""
    total, number = 0.0, 0
    while total < seconds:
        recording = recordings[int(rng.integers(len(recordings)))]
        span = recording.duration
        first, last = (recording.t[0] + share * span for share in within)
        length = min(rng.uniform(5.0, 15.0), last - first)
        start = first + rng.uniform() * (last - first - length)
        rows = (recording.t >= start) & (recording.t <= start + length)
        number += 1
        total += length
        yield recording.part(rows, name=f"{recording.name} {number}")


def real_changes(recordings: list[Recording], n: int) -> Iterator[Change]:
    """Loads and Coulomb friction that are added to real recordings."""
    torque = np.concatenate([np.asarray(r.tau) for r in recordings])
    power = np.sqrt((torque**2).mean(axis=0))
    for mass in (0.25, 0.5, 1.0, 2.0):
        yield Change("payload", f"load of {mass:g} kg", None, mass)
    for k, share in enumerate((0.05, 0.1, 0.2)):
        joint = k % n
        label = f"Coulomb friction, {share:.0%} of the joint's torque"
        yield Change("friction", label, joint + 1, share * float(power[joint]))


def with_change(recording: Recording, change: Change, body: RigidBody) -> Recording:
    """A recording with the torque of a load 5 cm along the last link's axis, or of Coulomb friction, added."""
    width = max(1, round(0.1 * recording.rate))
    window = np.hanning(width + 2)[1:-1]
    window /= window.sum()

    def smooth(series: np.ndarray) -> np.ndarray:
        columns = [np.convolve(x, window, mode="same") for x in series.T]
        return np.stack(columns, axis=1)

    q = smooth(recording.q)
    dq = smooth(np.gradient(q, recording.t, axis=0))
    ddq = smooth(np.gradient(dq, recording.t, axis=0))
    if change.effect == "payload":
        one = change.size * np.r_[1.0, 0.0, 0.0, 0.05, np.zeros(6)]
        added = body.last_link_regressor(q, dq, ddq) @ one
    else:
        assert change.joint is not None
        added = np.zeros_like(q)
        sign = np.tanh(dq[:, change.joint - 1] / 0.01)
        added[:, change.joint - 1] = change.size * sign
    # convolution bends the ends
    inner = slice(2 * width, -2 * width)
    changed = replace(recording, tau=np.asarray(recording.tau) + added)
    return changed.part(inner)


def per_day(count: int, hours: float) -> str:
    """Rate per 24 h with its 95 % interval of Poisson's distribution."""
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    high = chi2.ppf(0.975, 2 * count + 2) / 2
    scale = 24 / hours
    return f"{count * scale:.2g} ({low * scale:.2g} .. {high * scale:.2g})"


def rows_of_healthy(found: list[dict[str, Any]]) -> list[str]:
    """Table of false alarms."""
    lines = [
        "| arms | hours | alarms | per 24 h (95 %) | as | misfits | per 24 h | drifts noted |",
        "|" + "---|" * 8,
    ]
    groups = {
        "all": found,
        "started warm": [f for f in found if not f.get("cold")],
        "started cold": [f for f in found if f.get("cold")],
        **{
            n: [f for f in found if f.get("noise") == n]
            for n in ("white", "red", "long")
        },
    }
    for label, own in groups.items():
        hours = sum(f["hours"] for f in own)
        if not own:
            continue
        effects = [e for f in own for e in f["effects"]]
        names = ", ".join(f"{effects.count(e)} {e}" for e in dict.fromkeys(effects))
        drifts = sum(len(f.get("drifts", ())) for f in own)
        rate = per_day(len(effects), hours)
        misfits = sum(f["misfits"] for f in own)
        cells = [
            f"{label}, {len(own)}",
            f"{hours:g}",
            len(effects),
            rate,
            names,
            misfits,
            per_day(misfits, hours),
            drifts,
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def rows_of_changes(rows: list[dict[str, Any]]) -> list[str]:
    """Table of what became of changes."""
    lines = [
        "| change | cases | named right | called otherwise | missed | known after (median, s) | size off by (median) |",
        "|" + "---|" * 7,
    ]
    for label in dict.fromkeys(row["label"] for row in rows):
        own = [row for row in rows if row["label"] == label]
        right = [row for row in own if row["outcome"] == "right"]
        wrong = [
            row["outcome"].removeprefix("called ")
            for row in own
            if row["outcome"].startswith("called")
        ]
        names = ", ".join(f"{wrong.count(w)} {w}" for w in dict.fromkeys(wrong))
        delays = [row["delay"] for row in own if row.get("delay") is not None]
        errors = [abs(row["error"]) for row in right if "error" in row]
        late = f"{np.median(delays):.0f}" if delays else ""
        off = f"{np.median(errors):.0%}" if errors else ""
        missed = sum(row["outcome"] == "missed" for row in own)
        lines.append(
            f"| {label} | {len(own)} | {len(right)} | {names or 0} | {missed} | {late} | {off} |"
        )
    return lines


def kept(file: Path, make: Any, *arguments: Any) -> Any:
    """A result from its file, or made and written."""
    if not file.is_file():
        with threadpool_limits(1):
            write_json(make(*arguments), file)
        print(f"  {file.name}", flush=True)
    return read_json(file, "delete it")


def main() -> None:
    """Run the parts that are asked for, and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/watch"))
    parser.add_argument("--parts", default="healthy,changes,real,speed")
    parser.add_argument("--arms", type=int, default=12)
    parser.add_argument("--hours", type=float, default=4.0, help="of each healthy arm")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--training", action="store_true")
    options = parser.parse_args()
    first = TRAINING if options.training else 0
    seeds = range(first, first + options.arms)
    out, hours, parts = options.out, options.hours, options.parts.split(",")
    run = Parallel(n_jobs=options.jobs)
    if "healthy" in parts:
        files = [out / f"healthy_{seed}_{hours:g}h.json" for seed in seeds]
        jobs = zip(files, seeds, strict=True)
        found = run(delayed(kept)(file, healthy, seed, hours) for file, seed in jobs)
        print("\n".join(["", "Healthy arms at work", "", *rows_of_healthy(found)]))
        for entry in found:
            print(*(f"  {entry['robot']}: {s}" for s in entry["alarms"]), sep="\n")
        print(f"processor time per second: {np.median([f['cpu'] for f in found]):.1%}")
    if "changes" in parts:
        jobs = [(out / f"changes_{seed}.json", changes, seed) for seed in seeds]
        rows = [
            row for part in run(delayed(kept)(*job) for job in jobs) for row in part
        ]
        print("\n".join(["", "Changes on arms at work", "", *rows_of_changes(rows)]))
        print(
            f"further alarms and misfits after the first: {sum(r['further'] for r in rows)}"
        )
    if "real" in parts:
        jobs = [
            (out / f"real_{name}_{hours:g}h.json", real, name, hours) for name in REAL
        ]
        found = run(delayed(kept)(*job) for job in jobs)
        print("\n".join(["", "Real arms", ""]))
        for entry in found:
            count, misfits = len(entry["alarms"]), entry["misfits"]
            rate = per_day(count, entry["hours"])
            print(
                f"{entry['robot']}: {entry['hours']:g} h, {count} alarms, {rate} per 24 h, {misfits} misfits"
            )
            print(*(f"  {s}" for s in entry["alarms"][:10]), sep="\n")
        rows = [row for entry in found for row in entry["changes"]]
        print("\n".join(["", *rows_of_changes(rows)]))
    if "speed" in parts:
        with threadpool_limits(1):
            found = shares(1000.0)
        print(
            f"\n7 joints at 1 kHz: {found[WATCH]:.1%} of a core, of which reading {found[READ]:.1%}"
        )


if __name__ == "__main__":
    main()
