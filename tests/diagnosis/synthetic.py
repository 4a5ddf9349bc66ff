"""Recordings of a three-joint arm by pinocchio and formulas written out here: no simulator, nothing of ``effects``.

The motion is analytic, so that a torque that acts late is evaluated late, without interpolation. ``examined`` and
``diagnosed`` keep what was found: all tests that ask about the same arm share one diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pinocchio as pin
from arms import Link, urdf
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Fourier, Limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose import SheetComparison, examine
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.result import Diagnosis

N = 3
ARMATURE = np.array([1.0, 1.0, 0.4])
COULOMB = np.array([2.0, 3.0, 1.0])
VISCOUS = np.array([2.0, 3.0, 1.0])
NOISE = np.array([0.1, 0.15, 0.05])
"""White noise of the recorded torque, standard deviation [N m]."""
SKEW = 3e-4
"""A healthy arm's recorded torque is ahead of the motion by this much: held, it acts half a tick late [s]."""
ENCODER_STEP = 2 * np.pi / 2**19
RATE = 250.0

_LINKS = (
    ("0 0 1", "0 0 0.2", 6, "0.02 0.01 0.05", "0.05 0.05 0.04"),
    ("0 1 0", "0 0.05 0.1", 5, "0.2 0.02 0.01", "0.02 0.1 0.1"),
    ("0 1 0", "0.45 0 0", 3, "0.15 0.03 0.02", "0.01 0.04 0.04"),
)
_CHAIN = (
    Link(f"joint_{j}", f"link_{j}", *link, limit="-2.5 2.5 200 3")
    for j, link in enumerate(_LINKS, 1)
)
URDF = urdf("yaw_pitch_pitch", *_CHAIN)


def _written(text: str, name: str, **sheet: np.ndarray) -> NominalArm:
    """An arm, whose URDF lies in a temporary folder."""
    path = Path(mkdtemp(prefix="gapscope-tests-")) / "robot.urdf"
    path.write_text(text)
    joints = ("joint_1", "joint_2", "joint_3")
    known = {"armature": ARMATURE, "encoder_step": ENCODER_STEP}
    return NominalArm(name, path, joints, **known, **sheet)


@cache
def arm() -> NominalArm:
    """The nominal arm."""
    return _written(URDF, "yaw_pitch_pitch", coulomb=COULOMB, viscous=VISCOUS)


@cache
def vendor() -> NominalArm:
    """The arm as a poor URDF has it: masses 15 to 25 % off, a centre of mass 2 cm off, no friction known."""
    text = URDF
    for right, wrong in (
        ('mass value="6"', 'mass value="7"'),
        ('mass value="5"', 'mass value="4"'),
        ('mass value="3"', 'mass value="3.6"'),
        ('xyz="0.15 0.03 0.02"', 'xyz="0.13 0.03 0.02"'),
    ):
        assert text.count(right) == 1
        text = text.replace(right, wrong)
    return _written(text, "vendor")


@cache
def body() -> RigidBody:
    """Dynamics of the nominal arm."""
    return RigidBody(arm())


Joints = tuple[float, ...]
NOTHING: Joints = (0.0,) * N


@dataclass(frozen=True)
class Truth:
    """What the recorded arm has beyond the nominal one; zeros and a torque of zero by default.

    Attributes:
        coulomb, viscous, load, armature, scale, offset, delay, lag, encoder: one value per joint, SI.
        stribeck, stribeck_speed: torque per joint [N m], and the speed at which it has fallen to 1 / e [rad/s].
        saturation, saturation_speed: friction at high speed [N m], and the speed at which it is tanh 1 of that [rad/s].
        drift, drift_time: share per joint by which friction is larger at first, and its time constant [s].
        ripple, cycles, phase: amplitude per joint [N m], periods per revolution, phase [rad].
        spring, rest: stiffness per joint [N m/rad], and where it rests [rad].
        limit: per joint [N m], 0 for none; only of simulated recordings.
        stiffness, damping, play: of the transmission per joint [N m/rad], [N m s/rad], [rad], 0 for a rigid one; only
            of simulated recordings.
        mass, com: point mass on the last link [kg], [m].
        link, link_mass, link_com: the link, from 1, that is heavier by so much [kg] and its centre off by so much [m].
        tilt: roll and pitch of the base [rad].
        force, window: force on the last link's centre of mass [N], world frame, from start to end [s].
        extra: torque beyond the catalogue of (t, q, dq), shape (N, n).
    """

    coulomb: Joints = NOTHING
    viscous: Joints = NOTHING
    load: Joints = NOTHING
    armature: Joints = NOTHING
    scale: Joints = NOTHING
    offset: Joints = NOTHING
    delay: Joints = NOTHING
    lag: Joints = NOTHING
    encoder: Joints = NOTHING
    stribeck: Joints = NOTHING
    stribeck_speed: float = 0.2
    saturation: Joints = NOTHING
    saturation_speed: float = 0.3
    drift: Joints = NOTHING
    drift_time: float = 3.0
    ripple: Joints = NOTHING
    cycles: float = 16.0
    phase: float = 0.7
    spring: Joints = NOTHING
    rest: float = 0.3
    limit: Joints = NOTHING
    stiffness: Joints = NOTHING
    damping: Joints = NOTHING
    play: Joints = NOTHING
    mass: float = 0.0
    com: tuple[float, ...] = (0.0, 0.0, 0.0)
    link: int = 1
    link_mass: float = 0.0
    link_com: tuple[float, ...] = (0.0, 0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    force: tuple[float, ...] = (0.0, 0.0, 0.0)
    window: tuple[float, float] = (0.0, 0.0)
    extra: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] = field(
        default=lambda t, q, dq: np.zeros_like(q), repr=False
    )


def model(truth: Truth) -> pin.Model:
    """Bodies of the recorded arm: load welded on, one link off, base tilted; frame ``hand`` at the last centre."""
    out = pin.buildModelFromUrdf(str(arm().urdf))
    centre = pin.SE3(np.eye(3), out.inertias[N].lever)
    out.addFrame(pin.Frame("hand", N, 0, centre, pin.FrameType.OP_FRAME))
    own = out.inertias[truth.link]
    grown = own.mass + truth.link_mass
    lever, inertia = own.lever + truth.link_com, own.inertia * grown / own.mass
    out.inertias[truth.link] = pin.Inertia(grown, lever, inertia)
    load = pin.Inertia(truth.mass, np.array(truth.com), np.zeros((3, 3)))
    out.appendBodyToJoint(N, load, pin.SE3.Identity())
    out.gravity.linear = pin.rpy.rpyToMatrix(*truth.tilt, 0.0).T @ [0.0, 0.0, -9.81]
    return out


def pushed(truth: Truth, t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """J^T f on the last link's centre of mass [N m], (N, n), while it acts; f is given in the world's frame."""
    out, of = np.zeros_like(q), model(truth)
    data, hand = of.createData(), of.getFrameId("hand")
    force = pin.rpy.rpyToMatrix(*truth.tilt, 0.0).T @ truth.force
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for i in np.flatnonzero((t >= truth.window[0]) & (t < truth.window[1])):
        jacobian = pin.computeFrameJacobian(of, data, q[i], hand, axes)
        out[i] = jacobian[:3].T @ force
    return out


def of_bodies(truth: Truth, *motion: np.ndarray) -> np.ndarray:
    """Inverse dynamics of the bodies alone [N m], (N, n), for position, velocity and acceleration."""
    of = model(truth)
    data = of.createData()
    return np.array([pin.rnea(of, data, *row) for row in zip(*motion, strict=True)])


def needed(truth: Truth, motion: Fourier, t: np.ndarray) -> np.ndarray:
    """Torque that must reach the joints at times t [N m], (N, n), by pinocchio."""
    q, dq, ddq = motion.position(t), motion.velocity(t), motion.acceleration(t)
    torque = of_bodies(truth, q, dq, ddq)
    torque += (ARMATURE + np.array(truth.armature)) * ddq
    torque += np.array(truth.spring) * (q - truth.rest)
    torque += truth.extra(t, q, dq) - (pushed(truth, t, q) if any(truth.force) else 0.0)
    warm = 1.0 + np.array(truth.drift) * np.exp(-t / truth.drift_time)[:, None]
    torque += warm * friction(truth, dq)
    motor, grip = torque, warm * np.array(truth.load) * np.tanh(dq / 0.005)
    for _ in range(60 if any(truth.load) else 0):  # tau = torque + mu |tau| sgn v
        motor = torque + grip * np.abs(motor)
    return motor


def friction(truth: Truth, dq: np.ndarray) -> np.ndarray:
    """Coulomb, Stribeck, saturating and viscous friction [N m], of the shape of dq [rad/s]."""
    dry = COULOMB + np.array(truth.coulomb)
    dry = dry + np.array(truth.stribeck) * np.exp(-((dq / truth.stribeck_speed) ** 2))
    level = np.array(truth.saturation) * np.tanh(dq / truth.saturation_speed)
    return dry * np.tanh(dq / 0.005) + level + (VISCOUS + np.array(truth.viscous)) * dq


def recording(
    truth: Truth,
    motion: Fourier,
    rng: np.random.Generator,
    name: str,
    rate: float = RATE,
) -> Recording:
    """What would be logged: u behind a lag and late, (1 + s) u(t) + offset + ripple, is what is needed; and noise."""
    t = np.arange(round(motion.duration * rate) + 1) / rate
    if any((*truth.limit, *truth.stiffness, *truth.play)):
        q, tau = simulated(truth, motion, t)
    else:
        q, tau = motion.position(t), np.empty((len(t), N))
        for j in range(N):
            late = t + SKEW + truth.delay[j]
            angle = truth.cycles * motion.position(late)[:, j] + truth.phase
            torque = _undone(truth, motion, late, j) - truth.ripple[j] * np.sin(angle)
            tau[:, j] = (torque - truth.offset[j]) / (1.0 + truth.scale[j])
    q = np.round((q + np.array(truth.encoder)) / ENCODER_STEP) * ENCODER_STEP
    return Recording(name, t, q, tau + NOISE * rng.standard_normal(tau.shape))


def _undone(truth: Truth, motion: Fourier, t: np.ndarray, j: int) -> np.ndarray:
    """Joint j's torque before a lag [N m], (N,): y + T dy / dt of the torque y behind it."""
    torque, h = needed(truth, motion, t)[:, j], 1e-3
    if truth.lag[j]:
        ahead, behind = (needed(truth, motion, t + dt)[:, j] for dt in (h, -h))
        torque = torque + truth.lag[j] * (ahead - behind) / (2 * h)
    return torque


def simulated(
    truth: Truth, motion: Fourier, t: np.ndarray, step: float = 5e-4
) -> tuple[np.ndarray, np.ndarray]:
    """Motors' positions and commanded torques at times t, (N, n), of an arm that follows a motion under PD control.

    Motors with joints of their own are joined to the links by springs with free play; semi-implicit Euler steps.
    """
    of, every = model(truth), round((t[1] - t[0]) / step)
    data, grid = of.createData(), np.arange((len(t) - 1) * every + 1) * step
    wanted, speed = motion.position(grid), motion.velocity(grid)
    ahead, half = needed(Truth(), motion, grid), 0.5 * np.array(truth.play)
    k, d = np.array(truth.stiffness), np.array(truth.damping)
    soft = (k > 0) | (half > 0)
    k, d = np.where(soft & (k == 0), 3e4, k), np.where(soft & (k == 0), 30.0, d)
    limit = np.where(np.array(truth.limit) > 0, truth.limit, np.inf)
    rotor = ARMATURE + np.array(truth.armature)
    theta, q, dtheta, dq = wanted[0].copy(), wanted[0].copy(), np.zeros(N), np.zeros(N)
    seen, command = np.empty_like(wanted), np.empty_like(wanted)
    for i in range(len(grid)):
        pull = 800.0 * (wanted[i] - theta) + 40.0 * (speed[i] - dtheta)
        u = ahead[i] + rotor * pull
        seen[i], command[i] = theta, u
        pushes = np.clip(u, -limit, limit) - friction(truth, dtheta)
        twist = theta - q
        beyond = twist - np.clip(twist, -half, half)
        through = np.where(beyond != 0, k * beyond + d * (dtheta - dq), 0.0)
        mass = pin.crba(of, data, q) + np.diag(np.where(soft, 0.0, rotor))
        bias = pin.nonLinearEffects(of, data, q, dq)
        dq = dq + step * np.linalg.solve(mass, np.where(soft, through, pushes) - bias)
        dtheta = np.where(soft, dtheta + step * (pushes - through) / rotor, dq)
        q, theta = q + step * dq, np.where(soft, theta + step * dtheta, q + step * dq)
    return seen[::every], command[::every]


def motion(seed: int, frequency: float = 0.2, duration: float = 10.0) -> Fourier:
    """A smooth motion of all joints."""
    limits = Limits(*(np.full(N, most) for most in (-1.6, 1.6, 1.6, 7.0)))
    how: dict[str, Any] = {"duration": duration, "frequency": frequency}
    how["centre"] = np.array([0.0, -0.4, 0.5])
    return Fourier.random(np.random.default_rng(seed), limits, **how)


def held(moved: Fourier, joint: int) -> Fourier:
    """The motion with one joint, from 1, held still."""
    moving = np.arange(1, N + 1) != joint
    return replace(moved, sine=moved.sine * moving, cosine=moved.cosine * moving)


@cache
def recordings(
    truth: Truth, seed: int = 0, *, duration: float = 8.0, rate: float = RATE
) -> tuple[Recording, ...]:
    """Three recordings, slow to fast."""
    rng = np.random.default_rng(1000 + seed)
    moved = [motion(10 * seed + k, f, duration) for k, f in enumerate((0.1, 0.2, 0.3))]
    return tuple(
        recording(truth, one, rng, f"recording_{k}.csv", rate)
        for k, one in enumerate(moved)
    )


@cache
def case(
    truth: Truth = Truth(),
    seed: int = 0,
    *,
    judged: bool = False,
    duration: float = 8.0,
) -> Case:
    """A case of three recordings, and where ``judged`` a fourth that is set aside."""
    fitted = recordings(truth, seed, duration=duration)
    rng = np.random.default_rng(2000 + seed)
    moved = [motion(500 + seed, 0.25, 8.0)] if judged else []
    aside = tuple(recording(truth, one, rng, "judged.csv") for one in moved)
    return Case("synthetic", arm().urdf.parent, arm(), fitted, aside)


@cache
def examined(truth: Truth = Truth(), seed: int = 1, **how: Any) -> SheetComparison:
    """What is found in a case; the same case is examined once for all tests."""
    with threadpool_limits(1):
        return examine(case(truth, seed, **how))


@cache
def diagnosed(truth: Truth = Truth(), seed: int = 1, **how: Any) -> Diagnosis:
    """The diagnosis of a case, once for all tests; its document keeps to the schema."""
    found = examined(truth, seed, **how).diagnosis()
    validate(found.document)
    return found


def named(result: Diagnosis) -> list[tuple[str, tuple[int, ...]]]:
    """Effects that are named, with their joints, in alphabetical order."""
    entries = result.document["effects"]
    return sorted((entry["effect"], tuple(entry["joints"])) for entry in entries)
