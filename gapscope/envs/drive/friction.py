"""Friction of all joints at one moment: the limit of dry friction, and the viscous coefficient."""

from __future__ import annotations

import numpy as np

from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.friction import (
    COULOMB,
    DRIFT,
    LOAD,
    SATURATING,
    STRIBECK,
    VISCOUS,
)
from gapscope.effects.passivity import total
from gapscope.envs.drive.rows import Rows

DRIFT_PERIOD = 0.016
"""Drift, whose time constant is seconds and more, is brought up to date this often [s]."""


class Friction(Rows):
    """Limit of dry friction, and b F, with F = 1 + a exp(-t / T) and nominal values included.

    The limit is

        (c + d exp(-(v / vs)^2) + s tanh(|v| / vt) + mu |applied|) F

    The formulas are those of ``gapscope.effects.friction``, arranged such that a step allocates no memory.

    Args:
        arm: an arm with effects.
        order: the arm's joints in the order of the result.
        dt: time step [s].

    Attributes:
        viscous: b F [N m s/rad], shape (n,).
        present: whether there is any friction.
        drifting: whether it drifts.
        dry: mask of the joints with dry friction, shape (n,).

    Raises:
        InputError: friction that is negative in total.
    """

    ROWS = (
        *("_coulomb", "_load", "_peak", "_exponent", "_saturation", "_per_speed"),
        *("_amplitude", "_time", "_base_viscous", "_factor", "viscous", "dry"),
        *("_drifted_peak", "_drifted_saturation", "_limit", "_at_rest", "_work"),
    )

    def __init__(self, arm: CorrectedArm, order: np.ndarray, dt: float) -> None:
        nominal, value = arm.arm, arm.value
        coulomb = nominal.coulomb + value(COULOMB.name, "torque")
        viscous = nominal.viscous + value(VISCOUS.name, "coefficient")
        peak = value(STRIBECK.name, "torque")
        speed = value(STRIBECK.name, "velocity")
        saturation = value(SATURATING.name, "torque")
        saturation_speed = value(SATURATING.name, "velocity")
        coulomb = total(coulomb, COULOMB.name, "N m")
        viscous = total(viscous, VISCOUS.name, "N m s/rad")
        self._coulomb = coulomb[order]
        self._load = value(LOAD.name, "coefficient")[order]
        self._peak = self._drifted_peak = peak[order]
        self._exponent = -1.0 / np.where(speed > 0, speed, 1.0)[order] ** 2
        self._saturation = self._drifted_saturation = saturation[order]
        self._per_speed = 1.0 / np.where(saturation > 0, saturation_speed, 1.0)[order]
        self._amplitude = value(DRIFT.name, "amplitude")[order]
        time = value(DRIFT.name, "time_constant")[order]
        self._time = np.where(self._amplitude != 0, time, 1.0)
        self._base_viscous, self.viscous = viscous[order], viscous[order].copy()
        self._factor: np.ndarray = np.ones(len(order))
        self._every = max(1, round(DRIFT_PERIOD / dt))
        self._limit, self._at_rest, self._work = np.zeros((3, len(order)))
        dry = self._coulomb + self._load + self._peak + self._saturation
        self.dry = dry > 0
        self._note()

    def _note(self) -> None:
        """Note which parts of the law are absent, so that a step leaves them out."""
        self.drifting = bool(self._amplitude.any())
        self._loaded = bool(self._load.any())
        self._stribeck = bool(self._peak.any())
        self._saturates = bool(self._saturation.any())
        self.present = bool(self.dry.any() or self._base_viscous.any())

    def put(self, number: int, one: Friction) -> None:
        """Take over the friction of one arm, drift included, as that of arm ``number``."""
        super().put(number, one)
        self._note()

    def drifts(self, step: int) -> bool:
        """Whether the drift must be brought up to date at a step's number."""
        return self.drifting and not step % self._every

    def due(self, steps: np.ndarray) -> np.ndarray:
        """The same for the numbers of several arms' steps: a mask of their shape."""
        return steps % self._every == 0

    def drift(self, t: float | np.ndarray, where: np.ndarray | bool = True) -> None:
        """Bring the drift up to date at a time t [s], of all joints or of those of a mask, shape (n,)."""
        factor = 1.0 + self._amplitude * np.exp(-t / self._time)
        self._factor = np.where(where, factor, self._factor)
        self.viscous = self._factor * self._base_viscous
        self._drifted_peak = self._factor * self._peak
        self._drifted_saturation = self._factor * self._saturation

    def load(self, applied: np.ndarray, where: np.ndarray | None = None) -> None:
        """Take over the applied motor torque [N m], shape (n,), of all joints or of those of a mask."""
        at_rest = self._at_rest if where is None else self._work
        if self._loaded:
            np.abs(applied, at_rest)
            at_rest *= self._load
            at_rest += self._coulomb
        else:
            at_rest[:] = self._coulomb
        if self.drifting:
            at_rest *= self._factor
        if where is not None:
            np.copyto(self._at_rest, at_rest, where=where)

    def limit(self, velocity: np.ndarray) -> np.ndarray:
        """Limit of dry friction [N m] at velocities [rad/s], shape (n,); valid until the next call."""
        if not (self._stribeck or self._saturates):
            return self._at_rest
        limit = self._limit
        np.multiply(velocity, velocity, limit)
        limit *= self._exponent
        np.exp(limit, limit)
        limit *= self._drifted_peak
        limit += self._at_rest
        if self._saturates:
            work = np.abs(velocity, self._work)
            work *= self._per_speed
            np.tanh(work, work)
            work *= self._drifted_saturation
            limit += work
        return limit
