"""The nominal arm: what the user believes, a robot file and a data sheet, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import g

from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import per_radian

# The one check on numbers that no arm can have, whatever its unit: a description or data sheet is wrong there.


LENGTH, MASS = 100.0, 1e4
"""The longest arms, on cranes and space stations, have 20 to 80 m; the heaviest industrial ones 12 t [m], [kg]."""
MARGIN = 100.0
"""What exceeds the largest arms by this factor is no unusual arm [1]."""
LARGEST = {
    "length": (MARGIN * LENGTH, "m"),
    "mass": (MARGIN * MASS, "kg"),
    "moment of inertia": (MARGIN * MASS * LENGTH**2, "kg m^2"),
    "gravity": (MARGIN * g, "m/s^2"),
    "armature": (MARGIN * MASS * LENGTH**2, "kg m^2"),
    "friction": (MARGIN * MASS * g * LENGTH, "N m"),
    "viscous friction": (MARGIN * MASS * g * LENGTH, "N m s/rad"),
}
"""Largest size of a quantity, and its unit; of sliding joints the unit with m, N and kg.

No inertia exceeds that of the mass at the length; no friction, at 1 rad/s if it is viscous, what the mass weighs there.
"""


def check_size(
    values: np.ndarray | float, quantity: str, file: Path | None, where: str
) -> None:
    """Check that no value of a quantity is beyond any arm's.

    Args:
        values: SI units, any shape.
        quantity: key of ``LARGEST``.
        file: that holds them.
        where: the place in it.

    Raises:
        InputError: one is.
    """
    largest, unit = LARGEST[quantity]
    sizes = np.abs(np.atleast_1d(np.asarray(values, dtype=float)))
    if sizes.size and sizes.max() > largest:
        raise InputError(
            f"a {quantity} of {sizes.max():.3g} {unit} is beyond any arm's ({largest:.3g} {unit})",
            "correct it; SI units are expected: kg, m, s, rad, N m",
            file=file,
            where=where,
        )


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
        shapes: dict[str, tuple[int, ...]] = {"gravity": (3,), "coupling": (n, n)}
        shapes |= dict.fromkeys((*SHEET_UNITS, "presliding"), (n,))
        for name, shape in shapes.items():
            value = getattr(self, name)
            # zeros if absent, but for a limit and a coupling, which are then none
            if value is None and name not in ("torque_limit", "coupling"):
                value = np.zeros(shape)
            if value is not None:
                object.__setattr__(self, name, self._checked(name, value, shape))
        if self.encoder_step is not None and not self.encoder_step >= 0:
            raise InputError(
                f"expected a number of at least 0, got {self.encoder_step!r}",
                where="nominal.encoder_step",
            )
        if self.encoder not in ("motor", "joint"):
            raise InputError(
                f"expected motor or joint, got {self.encoder!r}",
                where="nominal.encoder",
            )

    def _checked(self, name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
        """Numbers of a quantity as a read-only array."""
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            array = np.array(np.nan)
        count, fault = " by ".join(map(str, shape)), ""
        # one number stands for all joints, and is left as it is
        if array.ndim and array.shape != shape:
            each = ", one per joint" if len(shape) == 1 and name != "gravity" else ""
            fault = f"expected {count} numbers{each}, got {array.size}"
        elif np.isnan(array).any():
            fault = f"holds what is not a number, {value!r}"
        elif name == "coupling" and not np.allclose(np.diag(array), 1.0):
            fault = "a motor's speed counts on the side of its own joint: expected ones on the diagonal"
        if fault:
            raise InputError(fault, file=self.urdf, where=f"nominal.{name}")
        if name in _QUANTITIES:
            check_size(array, _QUANTITIES[name], self.urdf, f"nominal.{name}")
        array.setflags(write=False)
        return array

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return len(self.joints)

    @property
    def per_radian(self) -> np.ndarray:
        """What of each joint counts as one radian where a threshold or a speed is set in radians [rad or m], (n,)."""
        return per_radian(self.sliding)

    def friction(self, dq: np.ndarray) -> np.ndarray:
        """Friction of the data sheet at velocities dq, (..., n): c tanh(dq / v0) + b dq [N m]."""
        return self.coulomb * smooth_sign(dq / self.per_radian) + self.viscous * dq

    @property
    def coupled_motors(self) -> tuple[int, ...]:
        """Numbers from 1 of the motors that turn several joints."""
        if self.coupling is None:
            return ()
        # one entry in a row of D is the motor's own joint
        several = np.count_nonzero(self.coupling, axis=1) > 1
        return tuple(int(m) + 1 for m in np.flatnonzero(several))


def arm_entry(arm: NominalArm) -> dict[str, Any]:
    """Robot and joints as results name them; numbers from 1 of those that slide, if any do."""
    entry: dict[str, Any] = {"robot": arm.name, "joints": list(arm.joints)}
    if any(arm.sliding):
        entry["sliding"] = [j for j, slides in enumerate(arm.sliding, 1) if slides]
    return entry


def smooth_sign(velocity: np.ndarray) -> np.ndarray:
    """Smoothed sign of a velocity v [rad/s], tanh(v / ``FRICTION_SMOOTHING``), any shape [1]."""
    return np.tanh(np.asarray(velocity) / FRICTION_SMOOTHING)


# Coupled motors: those that turn several joints, as in a wrist whose drives share their axes.


def coupled(
    matrix: np.ndarray, entries: Sequence[Mapping[str, Any]], where: str
) -> np.ndarray:
    """A matrix of motors and joints, (n, n), with the entries of motors that turn with a further joint.

    Each says which motor, which joint, and the ratio [1]: turns of the motor for one turn of the joint; 1 by default.

    Raises:
        InputError: an entry names a joint that does not exist, or a motor's own joint, or its ratio is 0.
    """
    out = matrix.copy()
    places = range(1, len(matrix) + 1)
    for number, entry in enumerate(entries, start=1):
        motor, joint, ratio = entry["motor"], entry["joint"], entry.get("ratio", 1.0)
        if motor not in places or joint not in places or motor == joint or not ratio:
            raise InputError(
                f"expected motor and joint, two different numbers from 1 to {len(matrix)}, and a ratio other than 0",
                "write for instance {motor: 6, joint: 5, ratio: 1}",
                where=f"{where}[{number}]",
            )
        out[motor - 1, joint - 1] = ratio
    return out


def coupling_of_transmission(
    transmission: np.ndarray, signs: np.ndarray | float
) -> np.ndarray:
    """The matrix D of motor speeds w = D dq [1], (n, n), from R of q_motor = R q_joint, (n, n), and the log's signs.

    A motor's row is divided by its ratio to the joint of its own number; a motor that does not turn that joint has no
    side to count on, and no row but that of the joint.
    """
    # the matrix has the log's directions, D those of the URDF
    rows = transmission * signs
    matrix = np.eye(len(rows))
    for motor, row in enumerate(rows):
        if row[motor] != 0:
            matrix[motor] = row / row[motor]
    return matrix


def coupling_entries(matrix: np.ndarray) -> list[dict[str, Any]]:
    """The entries of a data sheet that say the same as D, (n, n)."""
    return [
        {"motor": int(m) + 1, "joint": int(j) + 1, "ratio": float(matrix[m, j])}
        for m, j in zip(*np.nonzero(matrix), strict=True)
        if m != j
    ]
