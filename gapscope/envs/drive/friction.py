"""Friction of all joints at one moment: the limit of dry friction, and the viscous coefficient."""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy import add, multiply

from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift, DryLaw
from gapscope.effects.passivity import total
from gapscope.envs.drive.repeated import Repeated
from gapscope.envs.drive.rows import Laws, Rows

DRIFT_PERIOD = 0.016
"""Drift, whose time constant is seconds and more, is brought up to date this often [s]."""


class Friction(Rows):
    """Limit of dry friction, and b F, with the nominal values included.

    With A_l(v, applied) the ``amplitude`` of each law l of dry friction and D_m(t) the ``change`` of each drift m, the
    limit is (c + sum_l A_l) F, F = prod_m (1 + D_m). Laws that vary with nothing are summed once, those that vary with
    the load when a torque is taken over.

    Args:
        arm: an arm with effects.
        order: the arm's joints in the order of the result.
        dt: time step [s].

    Attributes:
        viscous: b F [N m s/rad], shape (n,).
        present: whether there is any friction.
        drifting: whether it drifts; it is to be brought up to date every ``every`` steps.
        dry: mask of the joints with dry friction, shape (n,).

    Raises:
        InputError: friction that is negative in total.
    """

    ROWS = (
        *("_constant", "_loaded", "_moving", "dry"),
        *("_base_viscous", "viscous", "_drifts", "_factor"),
    )

    def __init__(self, arm: CorrectedArm, order: np.ndarray, dt: float) -> None:
        # coupled motors have dry friction of their own
        laws = [item for item in arm.of_kind(DryLaw) if item[0].reach != "motor"]
        constant = arm.arm.coulomb
        for law, values in laws:
            if law.varies_with == "nothing":
                constant = constant + law.amplitude(0.0, 0.0, *values)
        self._constant = total(constant, "nominal.coulomb", "N m")[order]
        self._loaded, self._moving = (
            Laws([item for item in laws if item[0].varies_with == what], order)
            for what in ("load", "velocity")
        )
        self.dry = (self._constant > 0) | self._loaded.joints | self._moving.joints
        viscous = total(arm.quantity("damping"), "nominal.viscous", "N m s/rad")
        self._base_viscous, self.viscous = viscous[order], viscous[order]
        self._drifts = Laws(arm.of_kind(Drift), order)
        self._factor: np.ndarray = np.ones(len(order))
        self.every = max(1, round(DRIFT_PERIOD / dt))
        self.note()

    def note(self) -> None:
        """Note what is absent, so that a step leaves it out; a torque is still to be taken over."""
        self.drifting = bool(self._drifts.acting)
        self.present = bool(self.dry.any() or self._base_viscous.any())
        self._at_rest, size = self._constant, len(self._constant)
        self._applied, self._limit = np.zeros((2, size))
        self._moves = bool(self._moving.acting)
        self._in_motion = Repeated(self._sum, 2, size)
        self._drifted = Repeated(self._product, 1, size)

    def drift(self, t: float | np.ndarray, where: np.ndarray | None = None) -> None:
        """Bring the drift up to date at a time t [s], of all joints or of those of a mask, shape (n,)."""
        now = True if where is None else where
        np.copyto(self._factor, self._drifted(t), where=now)
        self.viscous = self._factor * self._base_viscous

    def _product(self, t: np.ndarray) -> np.ndarray | float:
        """The drift's factor F [1] at times t [s]."""
        factor: np.ndarray | float = 1.0
        for effect, values in self._drifts.acting:
            factor = factor * (1.0 + effect.change(t, *values))
        return factor

    def load(self, applied: np.ndarray, where: np.ndarray | None = None) -> None:
        """Take over the applied motor torque [N m], shape (n,), of all joints or of those of a mask."""
        at_rest = self._constant
        for law, values in self._loaded.acting:
            at_rest = at_rest + law.amplitude(0.0, applied, *values)
        if self.drifting:
            at_rest = at_rest * self._factor
        if where is not None:
            at_rest = np.where(where, at_rest, self._at_rest)
            applied = np.where(where, applied, self._applied)
        self._at_rest, self._applied = at_rest, applied

    def limit(self, velocity: np.ndarray) -> np.ndarray:
        """Limit of dry friction [N m] at velocities [rad/s], shape (n,); valid until the next call."""
        if not self._moves:
            return self._at_rest
        more = self._in_motion(velocity, self._applied)
        if self.drifting:
            more = multiply(more, self._factor, self._limit)
        return add(more, self._at_rest, self._limit)

    def _sum(self, velocity: np.ndarray, applied: np.ndarray) -> np.ndarray:
        """Sum of what varies with the velocity [N m]."""
        acting = self._moving.acting
        return reduce(
            add, [law.amplitude(velocity, applied, *values) for law, values in acting]
        )
