"""Recordings of a three-joint arm by pinocchio and formulas written out here: no simulator, nothing of ``effects``.

The motion is analytic, so that a torque that acts late is evaluated late, without interpolation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pinocchio as pin

from arm.case import Case
from arm.dynamics import RigidBody
from arm.nominal import NominalArm
from arm.recording import Recording
from arm.trajectory import Fourier, Limits

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

_LINK = """
  <joint name="joint_{number}" type="revolute">
    <parent link="{parent}"/><child link="link_{number}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>
    <limit lower="-2.5" upper="2.5" effort="200" velocity="3"/>
  </joint>
  <link name="link_{number}"><inertial><mass value="{mass}"/><origin xyz="{com}"/>
    <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
URDF = (
    '<robot name="yaw_pitch_pitch"><link name="base"/>'
    + _LINK.format(
        number=1,
        parent="base",
        origin="0 0 0.2",
        axis="0 0 1",
        mass=6,
        com="0.02 0.01 0.05",
        ixx=0.05,
        iyy=0.05,
        izz=0.04,
    )
    + _LINK.format(
        number=2,
        parent="link_1",
        origin="0 0.05 0.1",
        axis="0 1 0",
        mass=5,
        com="0.2 0.02 0.01",
        ixx=0.02,
        iyy=0.1,
        izz=0.1,
    )
    + _LINK.format(
        number=3,
        parent="link_2",
        origin="0.45 0 0",
        axis="0 1 0",
        mass=3,
        com="0.15 0.03 0.02",
        ixx=0.01,
        iyy=0.04,
        izz=0.04,
    )
    + "</robot>"
)


@cache
def arm() -> NominalArm:
    """The nominal arm; its URDF lies in a temporary folder."""
    urdf = Path(mkdtemp(prefix="gapscope-tests-")) / "robot.urdf"
    urdf.write_text(URDF)
    joints = ("joint_1", "joint_2", "joint_3")
    return NominalArm(
        "yaw_pitch_pitch", urdf, joints, armature=ARMATURE, coulomb=COULOMB, viscous=VISCOUS, encoder_step=ENCODER_STEP
    )


@cache
def body() -> RigidBody:
    """Dynamics of the nominal arm."""
    return RigidBody(arm())


@dataclass(frozen=True)
class Truth:
    """What the recorded arm has beyond the nominal one; zeros and a torque of zero by default.

    Attributes:
        coulomb, viscous, load, armature, scale, offset, delay, encoder: one value per joint, SI.
        mass, com: point mass on the last link [kg], [m].
        extra: torque beyond the catalogue of (t, q, dq), shape (N, n).
    """

    coulomb: tuple[float, ...] = (0.0,) * N
    viscous: tuple[float, ...] = (0.0,) * N
    load: tuple[float, ...] = (0.0,) * N
    armature: tuple[float, ...] = (0.0,) * N
    scale: tuple[float, ...] = (0.0,) * N
    offset: tuple[float, ...] = (0.0,) * N
    delay: tuple[float, ...] = (0.0,) * N
    encoder: tuple[float, ...] = (0.0,) * N
    mass: float = 0.0
    com: tuple[float, ...] = (0.0, 0.0, 0.0)
    extra: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] = field(
        default=lambda t, q, dq: np.zeros_like(q), repr=False
    )


def needed(truth: Truth, motion: Fourier, t: np.ndarray) -> np.ndarray:
    """Torque that must reach the joints at times t [N m], (N, n), by pinocchio with the load welded on."""
    model = pin.buildModelFromUrdf(str(arm().urdf))
    model.appendBodyToJoint(N, pin.Inertia(truth.mass, np.array(truth.com), np.zeros((3, 3))), pin.SE3.Identity())
    data = model.createData()
    q, dq, ddq = motion.position(t), motion.velocity(t), motion.acceleration(t)
    torque = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    sign = np.tanh(dq / 0.005)
    torque += (ARMATURE + np.array(truth.armature)) * ddq
    torque += (COULOMB + np.array(truth.coulomb)) * sign + (VISCOUS + np.array(truth.viscous)) * dq
    torque += truth.extra(t, q, dq)
    motor = torque
    for _ in range(60):  # tau = torque + mu |tau| sgn v
        motor = torque + np.array(truth.load) * np.abs(motor) * sign
    return motor


def recording(truth: Truth, motion: Fourier, rng: np.random.Generator, name: str, rate: float = RATE) -> Recording:
    """What would be logged: applied(t) = (1 + s) recorded(t - T) + offset is what is needed, and noise."""
    t = np.arange(round(motion.duration * rate) + 1) / rate
    applied = np.empty((len(t), N))
    for j, delay in enumerate(truth.delay):
        applied[:, j] = needed(truth, motion, t + SKEW + delay)[:, j]
    tau = (applied - np.array(truth.offset)) / (1.0 + np.array(truth.scale))
    q = np.round((motion.position(t) + np.array(truth.encoder)) / ENCODER_STEP) * ENCODER_STEP
    return Recording(name, t, q, tau + NOISE * rng.standard_normal(tau.shape))


def motion(seed: int, frequency: float = 0.2, duration: float = 10.0) -> Fourier:
    """A smooth motion of all joints."""
    limits = Limits(np.full(N, -1.6), np.full(N, 1.6), np.full(N, 1.6), np.full(N, 7.0))
    centre = np.array([0.0, -0.4, 0.5])
    return Fourier.random(
        np.random.default_rng(seed), limits, duration=duration, centre=centre, frequency=frequency, order=5
    )


def recordings(truth: Truth, seed: int = 0, *, duration: float = 8.0, rate: float = RATE) -> tuple[Recording, ...]:
    """Three recordings, slow to fast."""
    rng = np.random.default_rng(1000 + seed)
    return tuple(
        recording(truth, motion(10 * seed + k, frequency, duration), rng, f"recording_{k}.csv", rate)
        for k, frequency in enumerate((0.1, 0.2, 0.3))
    )


def case(truth: Truth = Truth(), seed: int = 0, *, judged: bool = False) -> Case:
    """A case of three recordings, and where ``judged`` a fourth that is set aside."""
    fitted = recordings(truth, seed)
    rng = np.random.default_rng(2000 + seed)
    aside = (recording(truth, motion(500 + seed, 0.25, 8.0), rng, "judged.csv"),) if judged else ()
    return Case("synthetic", arm().urdf.parent, arm(), fitted, aside)
