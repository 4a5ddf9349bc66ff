"""False alarms of a watch per 24 h on arms at work and real ones, and what it names of changes put into recordings.

    .venv/bin/python experiments/46_watch_alarms.py --out out/watch [--parts healthy,real] [--hours 4] [--arms 12]

Each arm is a JSON file in ``--out``, so that a rerun goes on; tables on standard output:

healthy   arms at work (laws, heat and noise of another form than the model's) without any change,
          ``--hours`` each: programs that change, speeds, half of them started cold. Alarms, misfits, and slow drifts
          noted.
real      recordings of real arms, ``--hours`` each: stretches of 5 to 15 s at random places and in random order; those
          of the last 40 % of each recording come only when what is normal was learnt from the others. A stretch that
          comes again has the same noise: that is fewer different motions than the hours say. Then with loads and
          friction added to the torque from some moment on, which is a recovery check.

The arms' torque comes from inverse dynamics of bodies that are off the nominal ones, with laws that the filter does not
have: friction by an arctangent with a slow bend at low speed, a power of the speed, a difference between the directions
and a share of the load; it warms up with the power that it turns into heat. Gears ripple, current is quantised, and the
noise has the colour of its kind of arm. Nothing of this is shared with ``gapscope.effects`` but the equation of motion.
"""

from __future__ import annotations

import copy
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import CASES, command_line, markdown, run_missing
from scipy.signal import lfilter
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.arm.root_mean_square import rms
from gapscope.blind_check.generator.arms import (
    SHEETS,
    Arm,
    draw_arm,
    perturb_inertials,
    text_of,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.watching.detector import ALARM, DRIFT, MISFIT, Detector, Event

# Arms at work

ROBOTS = (*SHEETS, "drawn")
"""Kinds of arms, by turns."""
CHUNK = 20.0
"""Samples are made in parts of this length [s]."""
RATE = 100.0
"""Of the recordings [Hz]."""
NOISES = {"white": (), "red": (0.95,), "long": (0.9, 0.99, 0.999)}
"""Colours of the torque's noise: coefficients of the first-order filters whose sum it is."""


class Change(NamedTuple):
    """What changes on an arm, n joints.

    Attributes:
        effect: as an alarm calls it, or ``other``.
        label: for the table.
        joint: from 1; ``None`` for the whole arm.
        size: in the unit of the alarm's first size.
    """

    effect: str
    label: str
    joint: int | None
    size: float


@dataclass
class WorkingArm:
    """An arm that works through programs of moves.

    Args:
        seed: decides on everything.
        start_cold: whether friction warms up from the start.
    """

    seed: int
    start_cold: bool = False
    t: float = 0.0

    def __post_init__(self) -> None:
        """Draw the arm, its true values and its programs."""
        self.rng = np.random.default_rng([46, self.seed])
        self.kind = ROBOTS[self.seed % len(ROBOTS)]
        self.sheet = draw_arm(self.kind, self.rng)
        self._folder = tempfile.TemporaryDirectory()
        self.nominal, self.body = _bodies(self.sheet, self.rng, Path(self._folder.name))
        n, uniform = self.sheet.n, self.rng.uniform
        self.c = self.sheet.coulomb * uniform(0.7, 1.3, n)
        self.b = self.sheet.viscous * uniform(0.7, 1.3, n)
        self.armature = self.sheet.armature * uniform(0.9, 1.1, n)
        self.knee, self.rise = uniform(0.03, 0.2, n), uniform(0.0, 0.4, n)
        self.smooth, self.power = uniform(0.004, 0.02, n), uniform(0.75, 1.0, n)
        self.uneven, self.by_load = uniform(-0.08, 0.08, n), uniform(0.0, 0.04, n)
        self.ripple, self.teeth = uniform(0.0, 0.05, n), self.rng.integers(20, 120, n)
        self.phase, self.lag = uniform(0.0, 2 * np.pi, n), uniform(0.0, 0.003)
        self.gain = uniform(0.2, 0.6)
        self.warmth = np.zeros(n) if self.start_cold else np.ones(n)
        self.warm_up = uniform(900.0, 2400.0)
        self.colour = tuple(NOISES)[self.seed % len(NOISES)]
        self.noise = uniform(0.02, 0.15) * self.c + 0.02
        self.encoder = uniform(2e-6, 3e-5)
        self._filters = {a: np.zeros((1, n)) for a in NOISES[self.colour]}
        self._heat = (self.c + self.b * 0.4) * 0.4
        self._programs = [self._points() for _ in range(4)]
        self._until, self._choice, self._speed = 0.0, 0, 1.0
        self._ahead = np.zeros((3, 0, n))
        self._place = self.sheet.home.copy()
        self._step, self._stops = 0, 0

    def chunks(self, seconds: float) -> Iterator[Recording]:
        """The next seconds of work, in parts."""
        count = round(CHUNK * RATE)
        for _ in range(round(seconds / CHUNK)):
            while self._ahead.shape[1] < count:
                self._ahead = np.concatenate([self._ahead, self._move()], axis=1)
            (q, dq, ddq), self._ahead = np.split(self._ahead, [count], axis=1)
            t = self.t + np.arange(count) / RATE
            self.t += count / RATE
            # the torque that is recorded belongs to a moment before the positions
            torque = self._torque(q - dq * self.lag, dq - ddq * self.lag, ddq)
            q = q + self.encoder * self.rng.standard_normal(q.shape)
            yield Recording("shift", t, q, tau=torque)

    def _torque(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        rigid = self.body.inverse_dynamics(q, dq, ddq)
        speed = np.abs(dq)
        bend = 1.0 + self.rise * np.exp(-np.sqrt(speed / self.knee))
        dry = self.c * bend + self.by_load * np.abs(rigid)
        sign = 2 / np.pi * np.arctan(dq / self.smooth)
        friction = dry * (sign + self.uneven * sign**2)
        friction += self.b * np.sign(dq) * speed**self.power
        friction *= self._warm(friction * dq)
        wave = self.ripple * self.c * np.sin(self.teeth * q + self.phase)
        needed = rigid + self.armature * ddq + friction + wave
        step = 1e-3 * np.maximum(self.c, 0.1)
        return np.round((needed + self._coloured(len(q))) / step) * step

    def _warm(self, heat: np.ndarray) -> np.ndarray:
        """Factor of the friction [1], (N, n), and the temperature after these samples."""
        share = 1.0 - np.exp(-len(heat) / RATE / self.warm_up)
        before = self.warmth
        reached = np.minimum(np.abs(heat).mean(axis=0) / self._heat, 1.5)
        self.warmth = before + share * (reached - before)
        between = np.linspace(0, 1, len(heat))[:, None]
        now = before + between * (self.warmth - before)
        return 1.0 + self.gain * (1.0 - now)

    def _coloured(self, count: int) -> np.ndarray:
        """Noise of the torque [N m], (N, n), of the colour of this arm."""
        white = self.rng.standard_normal((count, self.sheet.n))
        total = white
        for a in self._filters:
            drive = self.rng.standard_normal(white.shape) * np.sqrt(1 - a**2)
            slow, self._filters[a] = lfilter(
                [1.0], [1.0, -a], drive, axis=0, zi=self._filters[a]
            )
            total = total + slow
        return self.noise * total

    def _points(self) -> list[np.ndarray]:
        """A program: points to move through."""
        count = int(self.rng.integers(5, 10))
        span = self.rng.uniform(0.3, 1.0) * self.sheet.half
        points = self.rng.uniform(-1, 1, (count, self.sheet.n))
        return list(self.sheet.home + span * points)

    def _move(self) -> np.ndarray:
        """The next move of the program and the dwell after it, (3, N, n); another program now and then."""
        if self.t >= self._until:
            self._until = self.t + self.rng.uniform(300.0, 1200.0)
            self._choice = int(self.rng.integers(len(self._programs)))
            self._speed = self.rng.uniform(0.5, 1.0)
            self._stops = int(self.rng.integers(2))
        points = self._programs[self._choice]
        self._step = (self._step + 1) % len(points)
        target, start = points[self._step], self._place
        self._place = target
        fastest = self._speed * 1.6
        time = max(1.875 * np.abs(target - start).max() / fastest, 0.4)
        s = np.arange(round(time * RATE)) / (time * RATE)
        shape = s**3 * (10 - 15 * s + 6 * s**2)
        rate = 30 * s**2 * (1 - s) ** 2 / time
        bend = 60 * s * (1 - s) * (1 - 2 * s) / time**2
        way = target - start
        moved = np.stack([shape, rate, bend])[..., None] * way
        dwell = round(self._stops * self.rng.uniform(0.0, 1.0) * RATE)
        held = np.zeros((3, dwell, len(way)))
        moved[0] += start
        held[0] += target
        return np.concatenate([moved, held], axis=1)


def _bodies(
    sheet: Arm, rng: np.random.Generator, folder: Path
) -> tuple[NominalArm, RigidBody]:
    """The nominal arm with its data sheet, and the true bodies, whose inertials are up to 5 % off."""
    values = {
        "armature": sheet.armature.tolist(),
        "coulomb": sheet.coulomb.tolist(),
        "viscous": sheet.viscous.tolist(),
    }
    (folder / "robot.urdf").write_text(sheet.urdf, encoding="utf-8")
    root = sheet.root
    perturb_inertials(root, 0.05, rng)
    (folder / "true.urdf").write_text(text_of(root), encoding="utf-8")
    nominal = load_nominal_arm(folder / "robot.urdf", sheet=values)
    return nominal, RigidBody(load_nominal_arm(folder / "true.urdf"), 2**20)


# What a watch says of them

REAL = ("ur10", "panda", "kuka_med7", "unitree_z1")
"""Real arms with a recording of 15 s or more."""
AFTER = 120.0
"""Stretches of a recording with a change that are watched [s]."""
LIMIT = 36000.0
"""Longest processor time of an arm [s]."""
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
        over=dict(state.over),
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


def judged(change: Change, events: list[Event]) -> dict[str, Any]:
    """What became of a change: the first alarm or misfit counts."""
    row = {"label": change.label, "outcome": "missed"}
    if events:
        first = events[0]
        joints = [] if change.joint is None else [change.joint]
        same = first.effect == change.effect and list(first.joints) == joints
        row["outcome"] = "right" if same else f"called {first.effect}"
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
        rows.append(judged(change, found))
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
    torque = np.concatenate([r.tau for r in recordings])
    power = rms(torque)
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
        added = body.link_regressor(body.last_link, q, dq, ddq) @ one
    else:
        added = np.zeros_like(q)
        sign = np.tanh(dq[:, change.joint - 1] / 0.01)
        added[:, change.joint - 1] = change.size * sign
    # convolution bends the ends
    inner = slice(2 * width, -2 * width)
    changed = replace(recording, tau=recording.tau + added)
    return changed.part(inner)


def per_day(count: int, hours: float) -> str:
    """Rate per 24 h with its 95 % interval of Poisson's distribution."""
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    high = chi2.ppf(0.975, 2 * count + 2) / 2
    scale = 24 / hours
    return f"{count * scale:.2g} ({low * scale:.2g} .. {high * scale:.2g})"


def table_of_alarms(found: list[dict[str, Any]]) -> str:
    """Table of false alarms."""
    head = ("arms", "hours", "alarms", "per 24 h (95 %)", "as", "misfits", "per 24 h")
    groups = {"all": found}
    starts = {True: "started cold", False: "started warm"}
    for one in found:
        for label in (starts.get(one.get("cold")), one.get("noise"), one["robot"]):
            groups.setdefault(label or "", []).append(one)
    groups.pop("", None)
    rows = []
    for label, own in groups.items():
        hours, misfits = (sum(f[key] for f in own) for key in ("hours", "misfits"))
        effects = Counter(e for f in own for e in f["effects"])
        names = ", ".join(f"{count} {e}" for e, count in effects.items())
        alarms, drifts = effects.total(), sum(len(f.get("drifts", ())) for f in own)
        cells = (f"{label}, {len(own)}", f"{hours:g}", alarms, per_day(alarms, hours))
        rows.append((*cells, names, misfits, per_day(misfits, hours), drifts))
    return markdown((*head, "drifts noted"), rows)


def table_of_changes(rows: list[dict[str, Any]]) -> str:
    """Table of what became of changes."""
    head = ("change", "cases", "named right", "called otherwise", "missed")
    lines = []
    for label in dict.fromkeys(row["label"] for row in rows):
        own = [row for row in rows if row["label"] == label]
        ends = Counter(row["outcome"].removeprefix("called ") for row in own)
        right, missed = ends.pop("right", 0), ends.pop("missed", 0)
        names = ", ".join(f"{count} {name}" for name, count in ends.items())
        errors = [abs(row["error"]) for row in own if "error" in row]
        off = f"{np.median(errors):.0%}" if errors else ""
        lines.append([label, len(own), right, names or 0, missed, off])
    return markdown((*head, "size off by (median)"), lines)


def main() -> None:
    """Run the parts that are asked for, and print their tables."""
    options = command_line(
        __doc__,
        out=Path("out/watch"),
        parts="healthy,real",
        arms=12,
        jobs=1,
        hours=(4.0, "of each arm"),
        seed=(0, "of the first arm"),
    ).parse_args()
    out, hours, parts = options.out, options.hours, options.parts.split(",")
    threadpool_limits(1)
    members = {
        "healthy": range(options.seed, options.seed + options.arms),
        "real": REAL,
    }
    for part, watch in {"healthy": healthy, "real": real}.items():
        if part not in parts:
            continue
        files = {out / f"{part}_{x}_{hours:g}h.json": x for x in members[part]}
        hear = partial(watch, hours=hours)
        found = run_missing(hear, files, options.jobs, LIMIT)
        print("\n".join(["", f"{part.capitalize()} arms", "", table_of_alarms(found)]))
        for entry in found:
            print(*(f"  {entry['robot']}: {s}" for s in entry["alarms"][:10]), sep="\n")
        print(f"processor time per second: {np.median([f['cpu'] for f in found]):.1%}")
        rows = [row for entry in found for row in entry.get("changes", ())]
        if rows:
            print("\n".join(["", table_of_changes(rows)]))


if __name__ == "__main__":
    main()
