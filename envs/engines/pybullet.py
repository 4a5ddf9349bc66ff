"""The PyBullet engine: steps an arm with effects.

PyBullet integrates the rigid bodies, payload included: dq[k+1] = dq[k] + dt ddq(q[k], dq[k], torque[k]) and
q[k+1] = q[k] + dt dq[k+1]. The central difference of q at step k is therefore the acceleration that the torque
commanded at step k causes: position and torque of one step belong together, without the half step by which a held
torque acts late.

PyBullet knows neither rotors nor friction that depends on load, and its own joint friction is a velocity motor. They
enter as torque, but not by their law at the present velocity: rotors would make an algebraic loop, dry friction would
chatter. The acceleration is solved first, from

    (M + I) ddq = applied - h - b dq[k+1] - f,   f in c Sgn(dq[k+1]),   c = coulomb + mu |applied|,

with M and h of the loaded arm, and then applied - f - b dq[k+1] - I ddq is given to PyBullet. Friction here is
Coulomb's, with sticking at rest; the formula that explains data has a smoothed sign instead. That difference is wanted.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pybullet

from arm.dynamics import RigidBody
from arm.errors import InputError
from arm.nominal import NominalArm
from arm.plain_urdf import Link, moving_links, plain_urdf
from effects.applied import AppliedEffect
from effects.corrected import CorrectedArm
from envs.engines.dry_friction import DryFriction
from envs.engines.path import TorquePath

SIMULATED = (
    "coulomb_friction",
    "viscous_friction",
    "load_friction",
    "payload",
    "armature",
    "torque_scale",
    "torque_offset",
    "actuator_delay",
    "encoder_offset",
)
"""Effects that this engine can simulate."""


class PyBulletEngine:
    """A simulated arm with effects, n joints in the arm's order, in a PyBullet world of its own.

    Args:
        arm: the nominal arm; its armature and friction are simulated too.
        effects: what the simulated arm has beyond them.
        dt: time step [s].

    Attributes:
        q: true joint positions [rad], shape (n,).
        dq: true joint velocities [rad/s], shape (n,).
        body: rigid-body model of the arm with its payload.

    Raises:
        InputError: an effect that this engine does not simulate, armature or friction that is negative in total, or an
            arm whose inertia is not physical.
    """

    def __init__(self, arm: NominalArm, effects: tuple[AppliedEffect, ...] = (), dt: float = 1e-3) -> None:
        _check_effects(effects)
        with_effects = CorrectedArm(arm, effects)
        value = with_effects.value
        self.arm, self.dt = arm, dt
        self.encoder_offset = value("encoder_offset", "offset")
        self.body = RigidBody(arm).loaded(with_effects.payload())
        self._armature = _total(arm.armature + value("armature", "inertia"), "armature", "kg m^2")
        self._viscous = _total(arm.viscous + value("viscous_friction", "coefficient"), "viscous_friction", "N m s/rad")
        self._coulomb = _total(arm.coulomb + value("coulomb_friction", "torque"), "coulomb_friction", "N m")
        self._load = value("load_friction", "coefficient")
        self._rotors = np.diag(self._armature)
        self._damped_rotors = np.diag(self._armature + dt * self._viscous)
        self._friction = DryFriction(arm.n_joints)
        self._path = TorquePath(
            value("actuator_delay", "delay"), value("torque_scale", "scale"), value("torque_offset", "torque"), dt
        )
        links = moving_links(self.body)
        self._client = pybullet.connect(pybullet.DIRECT)
        self._robot, self._joints = _load(self._client, links, arm, dt)
        self.reset(np.zeros(arm.n_joints))

    def __enter__(self) -> PyBulletEngine:
        """Use as a context that closes the engine at its end."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the engine."""
        self.close()

    def close(self) -> None:
        """Free the PyBullet world; a second call does nothing."""
        if self._client is not None:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = None

    def reset(self, q: np.ndarray, dq: np.ndarray | None = None) -> None:
        """Put the arm at true positions q [rad] with velocities dq [rad/s] (0 by default), and forget past torque."""
        dq = np.zeros(len(q)) if dq is None else dq
        for joint, position, velocity in zip(self._joints, q, dq, strict=True):
            pybullet.resetJointState(self._robot, joint, float(position), float(velocity), physicsClientId=self._client)
        self._friction.reset()
        self._path.reset()
        self._read()

    def encoders(self) -> np.ndarray:
        """Positions as the encoders see them, q + delta [rad], shape (n,), not quantised."""
        return self.q + self.encoder_offset

    def step(self, torque: np.ndarray) -> None:
        """Hold the commanded torque [N m], shape (n,), for one time step."""
        dt, dq = self.dt, self.dq
        applied = self._path(torque)
        mass, bias = self.body.mass_matrix(self.q), self.body.bias(self.q, dq)
        velocity, impulse = self._friction.solve(
            mass + self._damped_rotors,
            (mass + self._rotors) @ dq + dt * (applied - bias),
            dt * (self._coulomb + self._load * np.abs(applied)),
        )
        lost = impulse / dt + self._viscous * velocity + self._armature * (velocity - dq) / dt
        pybullet.setJointMotorControlArray(
            self._robot, self._joints, pybullet.TORQUE_CONTROL, forces=applied - lost, physicsClientId=self._client
        )
        pybullet.stepSimulation(physicsClientId=self._client)
        self._read()

    def _read(self) -> None:
        states = pybullet.getJointStates(self._robot, self._joints, physicsClientId=self._client)
        self.q = np.array([state[0] for state in states])
        self.dq = np.array([state[1] for state in states])


def _check_effects(effects: tuple[AppliedEffect, ...]) -> None:
    for applied in effects:
        if applied.name not in SIMULATED:
            raise InputError(
                f"PyBullet cannot simulate {applied.name}", f"use {', '.join(SIMULATED)}", where=applied.name
            )


def _total(values: np.ndarray, name: str, unit: str) -> np.ndarray:
    if (values < 0).any():
        joint = int(values.argmin())
        raise InputError(
            f"nominal value plus effect is {values[joint]:.4g} {unit} at joint {joint + 1}, which would feed energy in",
            "give an increment that leaves the total at zero or above",
            where=name,
        )
    return values


def _load(client: int, links: tuple[Link, ...], arm: NominalArm, dt: float) -> tuple[int, list[int]]:
    """Load the bodies into a PyBullet world; its id of the arm, and of the joints in the arm's order."""
    with TemporaryDirectory(prefix="gapscope_") as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(plain_urdf(links))
        pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        robot = pybullet.loadURDF(str(file), useFixedBase=True, flags=flags, physicsClientId=client)
    pybullet.setGravity(*arm.gravity.tolist(), physicsClientId=client)
    pybullet.setTimeStep(dt, physicsClientId=client)
    infos = [pybullet.getJointInfo(robot, i, physicsClientId=client) for i in range(len(links))]
    index = {info[1].decode(): i for i, info in enumerate(infos)}
    pybullet.changeDynamics(robot, -1, linearDamping=0, angularDamping=0, physicsClientId=client)
    for link in links:
        pybullet.changeDynamics(
            robot,
            index[link.joint],
            linearDamping=0,
            angularDamping=0,
            jointDamping=0,
            localInertiaDiagonal=link.moments.tolist(),
            physicsClientId=client,
        )
    joints = [index[name] for name in arm.joints]
    zeros = [0.0] * len(joints)
    pybullet.setJointMotorControlArray(robot, joints, pybullet.VELOCITY_CONTROL, forces=zeros, physicsClientId=client)
    return robot, joints
