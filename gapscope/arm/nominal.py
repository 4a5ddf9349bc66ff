"""The nominal arm: what the user believes, a URDF and a data sheet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.beyond_any_arm import check_size
from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import per_radian

FRICTION_SMOOTHING = 0.005
"""Velocity scale v0 of the smoothed sign, sgn v = tanh(v / v0) [rad/s], as the case format fixes it; a slide's velocity
is divided by ``NominalArm.per_radian`` first."""

SHEET_UNITS = {
    "armature": "kg m^2",
    "coulomb": "N m",
    "viscous": "N m s/rad",
    "torque_limit": "N m",
}
"""Entries of the data sheet with one value per joint, and their units."""
_QUANTITIES = {
    "gravity": "gravity",
    "armature": "armature",
    "coulomb": "friction",
    "viscous": "viscous friction",
}


@dataclass(frozen=True)
class NominalArm:
    """What the user believes about the arm, n joints; joint-side SI units.

    Attributes:
        name: name of the robot.
        urdf: path of the URDF file.
        joints: names of the joints in the order of the recordings' columns.
        gravity: gravity in the base frame [m/s^2], shape (3,).
        armature: reflected rotor inertia [kg m^2], (n,).
        coulomb: Coulomb friction [N m], (n,).
        viscous: viscous friction [N m s/rad], (n,).
        torque_limit: [N m], (n,), or ``None``.
        encoder: side of the transmission on which q is measured, ``motor`` or ``joint``.
        encoder_step: quantisation step of q that the data sheet admits [rad], or ``None``.
        coupling: D [1] with the motors' speeds D dq, (n, n), ones on the diagonal; ``None``: each motor turns its own
            joint alone.
        presliding: distance over which dry friction builds up after a reversal [rad], (n,); where it is 0 friction
            follows the velocity at once.
        locked: positions of the file's other joints [rad or m]; those that are not named are locked at zero.
        sliding: whether each joint is prismatic, (n,): its coordinate is then in m, its torque a force in N, and so on.
        friction_source: where ``coulomb`` and ``viscous`` come from, in words; empty if nothing states them.

    Raises:
        InputError: a data sheet list does not have one number per joint, or one beyond any arm.
    """

    name: str
    urdf: Path
    joints: tuple[str, ...]
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    armature: np.ndarray = None  # type: ignore[assignment]
    coulomb: np.ndarray = None  # type: ignore[assignment]
    viscous: np.ndarray = None  # type: ignore[assignment]
    torque_limit: np.ndarray | None = None
    encoder: str = "motor"
    encoder_step: float | None = None
    coupling: np.ndarray | None = None
    presliding: np.ndarray = None  # type: ignore[assignment]
    locked: Mapping[str, float] = field(default_factory=dict)
    sliding: tuple[bool, ...] = ()
    friction_source: str = ""

    def __post_init__(self) -> None:
        """Fill in zeros if the data sheet is silent and freeze the arrays."""
        n = len(self.joints)
        object.__setattr__(self, "sliding", self.sliding or (False,) * n)
        per_joint = (*SHEET_UNITS, "presliding")
        for name in per_joint:
            if name != "torque_limit" and getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(n))
        for name in ("gravity", *per_joint):
            length = 3 if name == "gravity" else n
            value = getattr(self, name)
            if value is None:
                continue
            try:
                array = np.array(value, dtype=float)
            except (TypeError, ValueError, OverflowError):
                raise InputError(
                    f"holds what is not a number, {value!r}", where=f"nominal.{name}"
                ) from None
            if array.shape != (length,):
                raise InputError(
                    f"expected {length} numbers, got {array.size}",
                    file=self.urdf,
                    where=f"nominal.{name}",
                )
            if np.isnan(array).any():
                raise InputError(
                    "holds what is not a number, nan",
                    file=self.urdf,
                    where=f"nominal.{name}",
                )
            if name in _QUANTITIES:
                check_size(array, _QUANTITIES[name], self.urdf, f"nominal.{name}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.coupling is not None:
            object.__setattr__(self, "coupling", _checked_coupling(self.coupling, n))
        if self.encoder not in ("motor", "joint"):
            raise InputError(
                f"expected motor or joint, got {self.encoder!r}",
                where="nominal.encoder",
            )

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.joints)

    @property
    def per_radian(self) -> np.ndarray:
        """What of each joint counts as one radian where a threshold or a speed is set in radians [rad or m], (n,)."""
        return per_radian(self.sliding)

    @property
    def coupled_motors(self) -> tuple[int, ...]:
        """Numbers from 1 of the motors that turn several joints."""
        if self.coupling is None:
            return ()
        several = np.count_nonzero(self.coupling, axis=1) > 1
        return tuple(int(m) + 1 for m in np.flatnonzero(several))


def _checked_coupling(coupling: np.ndarray, n_joints: int) -> np.ndarray:
    """D as a read-only array of the right shape, with ones on the diagonal."""
    matrix = np.array(coupling, dtype=float)
    if matrix.shape != (n_joints, n_joints) or not np.isfinite(matrix).all():
        raise InputError(
            f"expected {n_joints} by {n_joints} numbers", where="nominal.coupling"
        )
    if not np.allclose(np.diag(matrix), 1.0):
        raise InputError(
            "a motor's speed counts on the side of its own joint: expected ones on the diagonal",
            where="nominal.coupling",
        )
    matrix.setflags(write=False)
    return matrix


def arm_entry(arm: NominalArm) -> dict[str, Any]:
    """Robot and joints as results name them; numbers from 1 of those that slide, if any do."""
    entry: dict[str, Any] = {"robot": arm.name, "joints": list(arm.joints)}
    if any(arm.sliding):
        entry["sliding"] = [j for j, slides in enumerate(arm.sliding, 1) if slides]
    return entry


def smooth_sign(velocity: np.ndarray, scale: float = FRICTION_SMOOTHING) -> np.ndarray:
    """Smoothed sign of a velocity, tanh(v / scale), any shape [1]; v and scale in rad/s."""
    return np.tanh(np.asarray(velocity) / scale)
