"""The generator's simulator: motions, conditions, what is simulated and what is measured of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.errors import extra
from gapscope.arm.motions.motion import Motion
from gapscope.blind_check.generator import joint, true_arm
from gapscope.blind_check.generator.arms import Arm, text_of
from gapscope.blind_check.generator.rigid import (
    inverse_dynamics,
    model_of,
    mujoco,
    tip_body,
)
from gapscope.blind_check.generator.true_arm import Columns, TrueArm

# Motions that excite an arm: sums of sines slow and fast, point to point, crawl; at rest at both ends.


_BANDS = {"slow": (0.09, 0.55, 5), "middle": (0.1, 1.6, 7), "crawl": (0.03, 0.25, 3)}
"""Lowest and highest frequency [Hz] and number of sines per joint."""

Series = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Position [rad], velocity [rad/s] and acceleration [rad/s^2], each (N, n)."""


def draw_motion(
    kind: str, arm: Arm, duration: float, rate: float, rng: np.random.Generator
) -> Motion:
    """A motion of one kind, within the arm's range, sampled at the controller's rate [Hz]."""
    t = np.arange(round(duration * rate)) / rate
    top = rng.uniform(1.2, 1.8) * rng.uniform(0.85, 1.0, arm.n)
    if kind == "point_to_point":
        q, dq, ddq = _points(arm, t, top, rng)
        return Motion(t, arm.home + q, dq, ddq)
    if kind == "fast":
        # slow sines through the range, and fast ones on top of them
        slow = _within(_sines(t, (0.09, 0.5), 4, 0.6 * top, rng), 0.9 * arm.half)
        fast = _sines(t, (3.0, 7.5), 4, 0.4 * top, rng)
        series = slow[0] + fast[0], slow[1] + fast[1], slow[2] + fast[2]
    else:
        low, high, count = _BANDS[kind]
        # drawn for every kind, so that a seed gives the same draws whatever the kind
        slow_share = float(rng.uniform(0.6, 1.0))
        share = {"crawl": 0.2, "slow": slow_share, "middle": 1.0}[kind]
        series = _sines(t, (low, high), count, share * top, rng)
        series = _within(series, arm.half)
    q, dq, ddq = series
    # times an envelope e that rises from 0 and falls back to it within ``RAMP``; product rule
    rise, rise_rate, rise_curve = _quintic(t, RAMP)
    fall, fall_rate, fall_curve = _quintic(t[-1] - t, RAMP)
    e = (rise * fall)[:, None]
    de = (rise_rate * fall - fall_rate * rise)[:, None]
    # the flanks never overlap, so that the mixed term of the product is zero
    dde = (rise_curve * fall + fall_curve * rise)[:, None]
    q, dq, ddq = e * q, de * q + e * dq, dde * q + 2 * de * dq + e * ddq
    return Motion(t, arm.home + q, dq, ddq)


def _sines(
    t: np.ndarray,
    band: tuple[float, float],
    count: int,
    top: np.ndarray,
    rng: np.random.Generator,
) -> Series:
    """Sums of sines whose speed peaks at ``top`` [rad/s]; q, dq, ddq of shape (N, n)."""
    q, dq, ddq = np.empty((3, len(t), len(top)))
    for j, peak in enumerate(top):
        w = 2 * np.pi * np.sort(rng.uniform(*band, count))
        phase = rng.uniform(0, 2 * np.pi, count)
        size = rng.uniform(0.4, 1.0, count)
        angle = np.outer(t, w) + phase
        speed = np.sin(angle) @ size
        scale = peak / np.abs(speed).max()
        q[:, j] = scale * (-(np.cos(angle) / w) @ size)
        dq[:, j] = scale * speed
        ddq[:, j] = scale * ((np.cos(angle) * w) @ size)
    return q, dq, ddq


def _within(series: Series, half: np.ndarray) -> Series:
    """A motion moved to the middle and shrunk to its range [rad]."""
    q, dq, ddq = series
    middle = (q.max(axis=0) + q.min(axis=0)) / 2
    span = np.maximum(np.ptp(q, axis=0), 1e-9)
    shrink = np.minimum(1.0, 2 * half / span)
    return (q - middle) * shrink, dq * shrink, ddq * shrink


RAMP = 1.0
"""Time in which a motion sets in and fades [s]."""


def _quintic(
    t: np.ndarray, duration: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """10 x^3 - 15 x^4 + 6 x^5 with its derivatives by time, x = t / duration in 0..1 [biagiotti2008]."""
    x = np.clip(t / duration, 0.0, 1.0)
    value = x**3 * (10 - 15 * x + 6 * x**2)
    rate = x**2 * (30 - 60 * x + 30 * x**2) / duration
    curve = x * (60 - 180 * x + 120 * x**2) / duration**2
    return value, rate, curve


def _points(
    arm: Arm, t: np.ndarray, top: np.ndarray, rng: np.random.Generator
) -> Series:
    """From posture to posture, with short rests; starts in the home posture."""
    q, dq, ddq = np.zeros((3, len(t), arm.n))
    now, here = 0.2, np.zeros(arm.n)
    while now < t[-1]:
        goal = rng.uniform(-1, 1, arm.n) * arm.half
        way = goal - here
        # 1.875 is the peak speed of the quintic over its mean speed
        takes = max(1.2, float((1.875 * np.abs(way) / top).max()))
        rows = t >= now
        s, ds, dds = _quintic(t[rows] - now, takes)
        q[rows] = here + s[:, None] * way
        dq[rows] = ds[:, None] * way
        ddq[rows] = dds[:, None] * way
        here = goal
        now = now + takes + float(rng.uniform(0.1, 0.5))
    return q, dq, ddq


# Conditions under which a case is recorded, and their allocation over a set of cases.


T = TypeVar("T")

STRONG = ((3.0, 5.0), (5.0, 10.0), (10.0, 20.0))
"""Severity classes of the cases that count: ratio of the effect's own gap to the healthy twin's floor."""
WEAK = ((0.5, 1.0), (1.0, 2.0), (2.0, 3.0))
"""Severity classes of the ladder, for information."""


class Conditions(NamedTuple):
    """Conditions of one case.

    Attributes:
        robot: name of the arm.
        inertials_off: relative width of the errors of the nominal inertials [1].
        noise: factor on the encoders' noise [1].
        bare: whether the controller and its references stay unknown.
        loop_rate, rate: of the controller and of the recordings [Hz].
        recordings: how many may be used.
        duration: shortest and longest recording [s].
    """

    robot: str
    inertials_off: float = 0.0
    noise: float = 1.0
    bare: bool = False
    loop_rate: int = 1000
    rate: int = 500
    recordings: int = 3
    duration: tuple[float, float] = (8.0, 14.0)


class CaseSpec(NamedTuple):
    """What one case is to be.

    Attributes:
        kind: ``single``, ``pair``, ``triple``, ``outside``, ``healthy`` or ``ladder``, or ``recovery``.
        laws: names of the laws at work.
        severity: class that each effect's own gap over the floor is drawn from, or ``None``.
        conditions: its conditions.
    """

    kind: str
    laws: tuple[str, ...]
    severity: tuple[float, float] | None
    conditions: Conditions


def allocate(
    rng: np.random.Generator, count: int, options: Sequence[T], shares: Sequence[float]
) -> list[T]:
    """``count`` draws whose numbers follow the shares (largest remainder), shuffled."""
    exact = np.array(shares) / sum(shares) * count
    numbers = np.floor(exact).astype(int)
    # the largest remainders get one more; equal ones in an order that is drawn
    tie_break = 1e-6 * rng.random(len(exact))
    by_remainder = np.argsort(numbers - exact + tie_break)
    numbers[by_remainder[: count - numbers.sum()]] += 1
    order = rng.permutation(np.repeat(np.arange(len(options)), numbers))
    return [options[k] for k in order]


def draw_conditions(
    rng: np.random.Generator, count: int, options: dict[str, Any]
) -> list[Conditions]:
    """Conditions of ``count`` cases; see ``BlindPlan`` for the options."""
    robots = list(options["robots"])
    off, noisy, bare = (options[key] for key in ("inertials_off", "noisy", "bare"))
    # allocated in this order, so that a seed gives the same set
    robot = allocate(rng, count, robots, [1.0] * len(robots))
    is_off = allocate(rng, count, [True, False], [off, 1 - off])
    noise = allocate(rng, count, [3.0, 1.0], [noisy, 1 - noisy])
    is_bare = allocate(rng, count, [True, False], [bare, 1 - bare])
    loop_rate = allocate(rng, count, [1000, 500], [0.7, 0.3])
    rate = allocate(rng, count, [100, 250, 500, 1000], [0.15, 0.35, 0.3, 0.2])
    recordings = allocate(rng, count, [3, 4], [0.6, 0.4])
    width = rng.uniform(0.01, 0.1, count)
    own_off = np.where(is_off, width, 0.0).tolist()
    own_rate = map(min, rate, loop_rate)
    duration = [tuple(options["duration"])] * count
    drawn = (robot, own_off, noise, is_bare, loop_rate, own_rate, recordings, duration)
    return [Conditions(*each) for each in zip(*drawn, strict=True)]


# The torque gap as the generator measures it: nominal arm against recording, filtered, per joint.


TORQUE_BAND = 12.0
"""Cut-off of the torque [Hz]."""
POSITION_BAND = 30.0
"""Cut-off of the position [Hz]."""
TRIM = 0.3
"""Time that is left out at both ends [s]."""
KNEE = 0.005
"""Speed scale of the nominal arm's smoothed sign [rad/s]."""


def smooth(x: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Zero-phase fourth-order Butterworth over time, cut-off [Hz] at most 0.95 of Nyquist; shape (N, n)."""
    cutoff = min(cutoff, 0.95 * rate / 2)
    sos = butter(4, cutoff, output="sos", fs=rate)
    return sosfiltfilt(sos, x, axis=0, padlen=min(len(x) - 1, int(3 * rate / cutoff)))


def nominal_torque(
    model: Any, sheet: dict[str, np.ndarray], t: np.ndarray, q: np.ndarray
) -> np.ndarray:
    """Torque that the nominal arm needs for a recorded motion [N m], (N, n).

    Args:
        model: MuJoCo model of the nominal arm.
        sheet: armature, coulomb, viscous of the data sheet.
        t: time [s], (N,), evenly spaced.
        q: recorded position [rad], (N, n).
    """
    rate = (len(t) - 1) / (t[-1] - t[0])
    even = np.arange(len(t)) / rate
    spline = make_interp_spline(even, smooth(q, rate, POSITION_BAND), k=5)
    position = spline(even)
    speed = spline.derivative(1)(even)
    acceleration = spline.derivative(2)(even)
    rigid = inverse_dynamics(model, position, speed, acceleration)
    # of rotors and friction by the data sheet
    rotors = sheet["armature"] * acceleration
    dry = sheet["coulomb"] * np.tanh(speed / KNEE)
    return rigid + (rotors + dry + sheet["viscous"] * speed)


def residual(
    torque: np.ndarray, predicted: np.ndarray, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Recorded minus predicted torque, filtered and trimmed [N m], (M, n), and the scale it is measured by, (n,)."""
    cut = round(TRIM * rate)
    recorded = smooth(torque, rate, TORQUE_BAND)[cut:-cut]
    needed = smooth(predicted, rate, TORQUE_BAND)[cut:-cut]
    deviation = recorded.std(axis=0)
    # a joint that hardly moves is measured by a share of the busiest one
    scale = np.maximum(deviation, 0.05 * deviation.max())
    return recorded - needed, scale


# A recording of the true arm: the sampled controller and the joints around MuJoCo's rigid bodies.


SETTLING = 0.4
"""Time after which a command that is clipped counts [s]."""
MAX_ERROR = 0.7
"""Distance from the reference at which a run is given up [rad]."""

Steer = Callable[[int, np.ndarray], np.ndarray]
"""Torque fed forward [N m], (n,), from the number of the tick and the encoders' last reading [rad], (n,)."""


def simulate(
    plant: TrueArm,
    motion: Motion,
    ahead: np.ndarray,
    noise: np.ndarray,
    steer: Steer | None = None,
    later: tuple[float, TrueArm] | None = None,
) -> Columns | None:
    """Run the true arm along a motion; one row per tick of the controller.

    Args:
        plant: the true arm.
        motion: reference, sampled at the controller's rate.
        ahead: feedforward [N m], (N, n).
        noise: of the encoders [rad], (N, n).
        steer: what is fed forward at each tick in place of ``ahead``, such as an agent's torque on top of it.
        later: a time [s], and the arm that goes on in its place from then on, as when a load is picked up.

    Returns:
        t, q, dq, tau, q_ref, dq_ref; ``None`` if the loop is unstable or the controller's limit was reached.

    Raises:
        InputError: numba is not installed.
    """
    with extra("blind", "the blind check's generator"):
        import_module("numba")
    simulation = _Simulation(plant, motion.q[0])
    out = np.zeros((len(motion.t), 3, plant.arm.n))
    change = np.inf if later is None else later[0]
    settled = SETTLING
    given = np.stack([noise, motion.q, motion.dq, ahead], axis=1)
    for k in range(len(motion.t)):
        if steer is not None:
            given[k, 3] = steer(k, motion.q[0] if k == 0 else out[k - 1, 0])
        if later is not None and motion.t[k] >= change:
            simulation = simulation.taken_over_by(later[1])
            change, settled = np.inf, motion.t[k] + SETTLING
        clipped = simulation.command(given[k], out[k])
        if clipped and motion.t[k] > settled:
            return None
        # written so that a position that is not a number counts as lost
        if not np.abs(out[k, 0] - motion.q[k]).max() < MAX_ERROR:
            return None
        simulation.advance(out[k, 2])
    return {
        "t": motion.t,
        "q": out[:, 0],
        "dq": out[:, 1],
        "tau": out[:, 2],
        "q_ref": motion.q,
        "dq_ref": motion.dq,
    }


class _Simulation:
    """Rigid bodies of MuJoCo, the compiled joints and the sampled controller, at rest at the start.

    Args:
        plant: the true arm.
        start: position that the encoders read at the start [rad], (n,).
    """

    def __init__(self, plant: TrueArm, start: np.ndarray) -> None:
        n = plant.arm.n
        self._dt = plant.healthy.step
        self._steps_per_tick = round(1 / plant.loop.rate / self._dt)
        self._steps_done = 0
        self._model = model_of(text_of(plant.root))
        self._model.opt.timestep = self._dt
        self._model.opt.gravity[:] = plant.gravity
        self._data = mujoco.MjData(self._model)
        # views into MuJoCo's memory: what is written there acts in the next step
        self._q, self._dq = self._data.qpos, self._data.qvel
        self._damping = self._model.dof_damping
        self._force = self._data.qfrc_applied
        self._joints = plant.record()
        self._state = np.zeros(1, dtype=joint.STATE)
        # at rest at the encoders' reading: compliant joints deflected by gravity, joints cold
        values = plant.values
        motor, stiffness = start - values["encoder"], values["stiffness"]
        still = np.zeros((1, n))
        gravity = inverse_dynamics(self._model, motor[None], still, still)[0]
        twist = gravity / np.maximum(stiffness, 1e-9)
        twist = twist + values["play"] * np.sign(gravity)
        self._q[:] = motor - np.where(stiffness > 0, twist, 0.0)
        self._state["theta"][0, :n] = motor
        self._state["cold"] = 1.0
        for name in ("first", "second"):
            self._state[name][0, :n] = gravity
        self._memory = np.zeros(1, dtype=true_arm.FILTER)
        self._memory["x1"] = np.nan  # no tick yet
        self._filter = plant.loop.coefficients()
        self._history = np.zeros((joint.HISTORY, n))
        # a compliant joint has its rotor as a mass of its own, a rigid one on the diagonal
        compliant = self._joints["stiffness"][0, :n] > 0
        rotors = self._joints["armature"][0, :n]
        self._model.dof_armature[:] = np.where(compliant, 0.0, rotors)
        self._plant, self._tip = plant, tip_body(self._model)
        self._tip_before = None
        moved = plant.push is not None or plant.shaken is not None
        self._disturbed = moved or bool(plant.resisting)

    def taken_over_by(self, plant: TrueArm) -> _Simulation:
        """Another arm in the state of this one: its motion, joints, controller and clock."""
        other = _Simulation(plant, self._q.copy())
        other._q[:], other._dq[:] = self._q, self._dq
        other._state, other._memory = self._state, self._memory
        other._history, other._steps_done = self._history, self._steps_done
        return other

    def command(self, given: np.ndarray, out: np.ndarray) -> int:
        """One tick of the controller; see ``true_arm.command``."""
        controller = self._joints, self._state, self._memory, self._filter
        return true_arm.command(*controller, self._q, given, out)

    def advance(self, command: np.ndarray) -> None:
        """The steps until the next tick, under a command that is held [N m], (n,)."""
        for _ in range(self._steps_per_tick):
            joint.advance(
                self._joints,
                self._state,
                self._history,
                command,
                self._steps_done,
                self._q,
                self._dq,
                self._damping,
                self._force,
            )
            if self._disturbed:
                self._disturb(self._steps_done * self._dt)
            mujoco.mj_step(self._model, self._data)
            self._steps_done += 1

    def _disturb(self, t: float) -> None:
        """Force on the tip, motion of the base and further torques on the joints in the step that begins at t [s]."""
        plant = self._plant
        drive = self._state["drive"][0, : plant.arm.n]
        for resisting in plant.resisting:
            self._force[:] -= resisting(t, self._q, self._dq, drive)
        if plant.shaken is not None:
            size, frequency, phase = plant.shaken
            swing = np.sin(2 * np.pi * frequency * t + phase)
            self._model.opt.gravity[:] = plant.gravity + size * swing
        if plant.push is not None:
            here = self._data.xipos[self._tip].copy()
            before = here
            if self._tip_before is not None and t != 0.0:
                before = self._tip_before
            self._tip_before = here
            velocity = (here - before) / plant.healthy.step
            self._data.xfrc_applied[self._tip, :3] = plant.push(t, here, velocity)
