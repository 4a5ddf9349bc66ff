"""Arms at work that a watch follows: programs of moves, friction that warms up, drives and noise of another form.

Torque comes from inverse dynamics of bodies that are off the nominal ones, with laws that the filter does not have:
friction by an arctangent with a slow bend at low speed, a power of the speed, a difference between the directions and a
share of the load; it warms up with the power that it turns into heat. Gears ripple, current is quantised, and the noise
has the colour of its kind of arm. Nothing of this is shared with ``gapscope.effects`` but the equation of motion.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.arms import SHEETS, Arm, draw_arm
from gapscope.blind_check.generator.urdf import perturb_inertials, text_of

ROBOTS = (*SHEETS, "drawn")
"""Kinds of arms, by turns."""
CHUNK = 20.0
"""Samples are made in parts of this length [s]."""
RATE = 100.0
"""Of the recordings [Hz]."""
NOISES = {"white": (), "red": (0.95,), "long": (0.9, 0.99, 0.999)}
"""Colours of the torque's noise: coefficients of the first-order filters whose sum it is."""


@dataclass(frozen=True)
class Change:
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
    _program: list[np.ndarray] = field(default_factory=list)

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
        self.load, self.offset = np.zeros(10), np.zeros(n)
        self.zero, self.late, self.push = np.zeros(n), 0.0, np.zeros(3)
        self._programs = [self._points() for _ in range(4)]
        self._until, self._choice, self._speed = 0.0, 0, 1.0
        self._queue: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._place = self.sheet.home.copy()
        self._step, self._stops = 0, 0

    def change(self, change: Change) -> None:
        """Put a change in, from now on."""
        j = None if change.joint is None else change.joint - 1
        if change.effect == "payload":
            centre = self.rng.uniform([-0.05, -0.05, 0.02], [0.05, 0.05, 0.12])
            self.load[:4] += change.size * np.r_[1.0, centre]
            self.load[[4, 6, 9]] += change.size * 2e-3
        elif change.effect == "friction":
            share = change.size / self.friction_level(j)
            self.c[j] *= 1.0 + share
            self.b[j] *= 1.0 + share
        elif change.effect == "torque_offset":
            # the catalogue: what is applied is the recorded torque and the offset
            self.offset[j] -= change.size
        elif change.effect == "encoder_offset":
            self.zero[j] += change.size
        elif change.label.startswith("delay"):
            self.late += change.size
        else:
            way = self.rng.standard_normal(3)
            self.push = change.size * way / np.linalg.norm(way)

    def friction_level(self, joint: int) -> float:
        """Friction of a joint at half a radian per second, warm [N m]."""
        return float(self.c[joint] + self.b[joint] * 0.5 ** self.power[joint])

    def chunks(self, seconds: float) -> Iterator[Recording]:
        """The next seconds of work, in parts."""
        for _ in range(round(seconds / CHUNK)):
            yield self._chunk()

    def _chunk(self) -> Recording:
        count = round(CHUNK * RATE)
        while sum(len(q) for q, _, _ in self._queue) < count:
            self._queue.append(self._move())
        q, dq, ddq = (np.concatenate(x) for x in zip(*self._queue, strict=True))
        self._queue = [(q[count:], dq[count:], ddq[count:])]
        q, dq, ddq = q[:count], dq[:count], ddq[:count]
        t = self.t + np.arange(count) / RATE
        self.t += count / RATE
        late = self.late + self.lag
        # the torque that is recorded belongs to a moment before the positions
        torque = self._torque(q - dq * late, dq - ddq * late, ddq)
        q = q + self.zero + self.encoder * self.rng.standard_normal(q.shape)
        return Recording("shift", t, q, tau=torque)

    def _torque(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        rigid = self.body.inverse_dynamics(q, dq, ddq)
        if self.load.any():
            rigid += self.body.last_link_regressor(q, dq, ddq) @ self.load
        if self.push.any():
            rigid -= self.body.force_torque(q, self.push)
        speed = np.abs(dq)
        bend = 1.0 + self.rise * np.exp(-np.sqrt(speed / self.knee))
        dry = self.c * bend + self.by_load * np.abs(rigid)
        sign = 2 / np.pi * np.arctan(dq / self.smooth)
        friction = dry * (sign + self.uneven * sign**2)
        friction += self.b * np.sign(dq) * speed**self.power
        friction *= self._warm(friction * dq)
        wave = self.ripple * self.c * np.sin(self.teeth * q + self.phase)
        needed = rigid + self.armature * ddq + friction + wave + self.offset
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

    def _move(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The next move of the program and the dwell after it; another program now and then."""
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
        moved = [start + shape[:, None] * way, rate[:, None] * way, bend[:, None] * way]
        dwell = round(self._stops * self.rng.uniform(0.0, 1.0) * RATE)
        still = np.zeros((dwell, len(way)))
        held = [target + still, still, still]
        q, dq, ddq = (np.concatenate(x) for x in zip(moved, held, strict=True))
        return q, dq, ddq


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
