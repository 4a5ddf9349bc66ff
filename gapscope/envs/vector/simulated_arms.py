"""The simulated arms of many environments: torque is held over steps of the simulation, as ``SimulatedArm`` does."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.plain_urdf import moving_links
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import Transmission
from gapscope.envs.drive.arm_drive import ArmDrive, nominal_body
from gapscope.envs.effect_ranges import EffectRanges
from gapscope.envs.engines.mujoco import MuJoCoBatch
from gapscope.envs.randomisation import Randomisation
from gapscope.envs.vector.arms_step import ArmsStep

ONE_BY_ONE = (
    "gymnasium.make_vec(..., vectorization_mode='sync') steps such arms one by one"
)
"""What to do if arms cannot be stepped together."""


def check_drawn(randomisation: Randomisation | EffectRanges | None) -> None:
    """Check that no effect may be drawn with which an arm cannot be stepped beside others.

    Raises:
        InputError: one may be; names it.
    """
    if randomisation is None:
        return
    ranges = isinstance(randomisation, EffectRanges)
    names = (
        [item.low.name for item in randomisation.ranges]
        if isinstance(randomisation, EffectRanges)
        else list(randomisation.names)
    )
    for name in names:
        effect = CATALOGUE[name]
        if isinstance(effect, Transmission) or effect.reach == "motor":
            raise InputError(
                f"{name} may be drawn, with which arms are not stepped together",
                ONE_BY_ONE,
                where="ranges" if ranges else "randomisation.names",
            )


class SimulatedArms:
    """N simulated arms with effects, n joints in kinematic order, on MuJoCo.

    Springs beside the joints, forces from outside and laws that a user entered are computed one arm after the other;
    all other effects over all arms at once.

    Args:
        arm: the nominal arm.
        effects: what all arms have beyond it at first.
        dt: time step [s].
        count: N.
        threads: see ``MuJoCoBatch``.

    Attributes:
        nominal: nominal rigid bodies.
        q, dq: true positions [rad] and velocities [rad/s], shape (N, n).
        applied: motor torque that reached the joints in the last step [N m], shape (N, n).

    Raises:
        InputError: an effect that does not fit the arm, or with which it cannot be stepped beside others.
    """

    def __init__(
        self,
        arm: NominalArm,
        effects: tuple[AppliedEffect, ...],
        dt: float,
        count: int,
        threads: int = 0,
    ) -> None:
        self._arm, self._dt, self.nominal = arm, dt, nominal_body(arm)
        first = self.drive(effects)
        gravity = np.asarray(self.nominal.gravity)
        links = moving_links(self.nominal)
        self._engine = MuJoCoBatch(links, gravity, dt, count, threads)
        self._step = ArmsStep(self._engine, dt)
        self.q, self.dq = self._step.q, self._step.dq
        self.applied = np.zeros(self.q.shape)
        self._drives, self._altered = [first] * count, [False] * count
        self._friction = first.friction.beside(count)
        self._path = first.path.beside(count)
        self._counts = np.zeros(count, dtype=int)
        for number in range(count):
            self.put(number, first)

    def drive(self, effects: tuple[AppliedEffect, ...]) -> ArmDrive:
        """The drives and bodies of an arm with effects.

        Raises:
            InputError: they do not fit the arm, or the arm cannot be stepped beside others.
        """
        drive = ArmDrive(self._arm, effects, self._dt, self.nominal)
        flexible = np.flatnonzero(~drive.rigid)
        why = ""
        if len(flexible):
            why = "an elastic joint or one with play has a motor of its own"
        elif drive.coupled.present:
            why = "a motor turns several joints"
        elif drive.parts > 1:
            why = f"a spring divides each step into {drive.parts} parts"
        if why:
            names = ", ".join(applied.name for applied in effects)
            raise InputError(
                f"{why}, which the vector environment does not step ({names})",
                ONE_BY_ONE,
                where="effects",
            )
        return drive

    def put(self, number: int, drive: ArmDrive) -> None:
        """Give an arm, numbered from 0, other effects; ``reset`` has to follow."""
        self._drives[number] = drive
        if drive.altered or self._altered[number]:
            links = moving_links(drive.body)
            self._engine.set_bodies(number, links, np.asarray(drive.body.gravity))
        self._altered[number] = drive.altered
        self._step.put(number, drive)
        self._direct = all(drive.direct for drive in self._drives)
        self._loaded = [i for i, one in enumerate(self._drives) if one.loads.present]

    def reset(self, number: int, q: np.ndarray, dq: np.ndarray) -> None:
        """Put an arm at true positions q [rad] with velocities dq [rad/s], each (n,), and forget its past."""
        drive = self._drives[number]
        if drive.friction.drifting:
            drive.friction.drift(0.0)
        self._counts[number] = 0
        self._engine.reset(number, q, dq)
        self._friction.put(number, drive.friction)
        self._path.put(number, drive.path)
        self._step.reset(number, drive.friction.viscous)
        self.applied[number] = 0.0

    def hold(self, torque: np.ndarray, steps: int = 1) -> None:
        """Hold the commanded torque [N m], shape (N, n), for so many time steps."""
        command, path, friction = torque.ravel(), self._path, self._friction
        if path.constant:
            self.applied = path(command).reshape(torque.shape)
            if self._direct:
                self._engine.step(self.applied, steps)
                self._counts += steps
                return
            friction.load(self.applied.ravel())
        for step in range(steps):
            if not path.constant:
                self._send(command, first=step == 0)
            elif friction.drifting:
                self._drift()
            self._advance()
            self._counts += 1

    def _send(self, command: np.ndarray, first: bool) -> None:
        """Torque of a step of which some changes on its way to the joints; ``first`` of those of a command."""
        path, friction = self._path, self._friction
        u = path(command, self.q.ravel())
        self.applied = u.reshape(self.q.shape)
        if not friction.drifting:
            friction.load(u)
            return
        # a torque that is held was taken over before friction drifted on
        if first:
            friction.load(u, where=~path.changing)
        self._drift()
        friction.load(u, where=path.changing)

    def _advance(self) -> None:
        """One step of all arms."""
        torque, velocity = self.applied, self._step.begin()
        if self._loaded:
            torque = torque.copy()
            for number in self._loaded:
                torque[number] += self._load(number)
        limit = self._friction.limit(velocity.ravel())
        self._step.advance(torque, limit.reshape(torque.shape))

    def _load(self, number: int) -> np.ndarray:
        """What acts on the links of an arm besides gravity and its drives [N m], shape (n,)."""
        time = float(self._counts[number]) * self._dt
        q, dq = self.q[number].copy(), self.dq[number].copy()
        return self._drives[number].loads(time, q, dq, self.applied[number])

    def _drift(self) -> None:
        """Bring the drift of friction up to date in the arms in which that is due."""
        due = self._counts % self._friction.every == 0
        if not due.any():
            return
        n = self.q.shape[1]
        t = np.repeat(self._counts * self._dt, n)
        self._friction.drift(t, where=np.repeat(due, n))
        self._step.set_viscous(self._friction.viscous.reshape(self.q.shape))
