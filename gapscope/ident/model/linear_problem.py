"""The linear problem of an identification: its columns, rows assembled, and whether it can be solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import units_of
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.root_mean_square import rms
from gapscope.effects.friction import friction_direction
from gapscope.ident.model.physical_parameters import LEAST_MASS
from gapscope.ident.model.regressor import Regressor

# The linear problem of identification, tau = W beta + noise.


@dataclass(frozen=True)
class Problem:
    """Tau = W beta + noise, N samples of n joints, b parameters.

    Attributes:
        matrix: W, shape (N, n, b); base columns, so that it has full rank, unless said otherwise.
        torque: tau [N m], shape (N, n).
        names: of the parameters, shape (b,).
        group: which recording (or stretch of one) a sample belongs to, shape (N,), integers that do not fall.
        interval: time between samples [s].
        forms: unknown functions of each joint that no column has, (N, n, K); each array has amplitudes of its own.
    """

    matrix: np.ndarray
    torque: np.ndarray
    names: Sequence[str]
    group: np.ndarray
    interval: float
    forms: Sequence[np.ndarray] = ()

    @property
    def n_joints(self) -> int:
        """Number n of joints."""
        return self.torque.shape[1]

    def stacked(self) -> tuple[np.ndarray, np.ndarray]:
        """W of shape (N n, b) and tau of shape (N n,)."""
        return self.matrix.reshape(-1, self.matrix.shape[2]), self.torque.ravel()

    def residual(self, beta: np.ndarray) -> np.ndarray:
        """Tau - W beta [N m], shape (N, n)."""
        return self.torque - self.matrix @ beta

    def rows(self, chosen: np.ndarray | slice) -> Problem:
        """The problem of some samples only."""
        return Problem(
            self.matrix[chosen],
            self.torque[chosen],
            self.names,
            self.group[chosen],
            self.interval,
            [each[chosen] for each in self.forms],
        )


def equal_parts(rows: slice, count: int) -> list[slice]:
    """A slice cut into parts of about equal length, empty ones left out."""
    edges = np.linspace(rows.start, rows.stop, count + 1).astype(int).tolist()
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


# Friction of drives as columns: direction of motion, its memory at rest, Stribeck and saturating friction.


STRIBECK_SPEEDS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Speeds vs tried for d exp(-(v / vs)^2) [rad/s]."""
SATURATION_SHARES = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7)
"""Speeds vt tried for s tanh(|v| / vt), over the largest speed of each drive [1]."""
PRESLIDING_DISTANCES = (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3)
"""Distances tried over which dry friction turns round at a reversal [rad]."""


@dataclass(frozen=True)
class FrictionLaw:
    r"""Friction of every drive beside b v: (c + d exp(-(v / vs)^2) + s tanh(\|v\| / vt)) e, e the direction of motion.

    Attributes:
        stribeck_speed: vs [rad/s]; ``None``: no such term.
        saturation_speeds: vt of each drive [rad/s]; ``None``: no such term.
        presliding: distance of each drive over which e turns from -1 to 1 [rad], so that it keeps its value at rest;
            0 or ``None``: e is the smoothed sign of the velocity, as in the effects' catalogue.
    """

    stribeck_speed: float | None = None
    saturation_speeds: tuple[float, ...] | None = None
    presliding: tuple[float, ...] | None = None

    @property
    def shapes(self) -> tuple[str, ...]:
        """Symbols of the columns per drive: c, d if there is a Stribeck term, s if there is one that saturates."""
        stribeck = () if self.stribeck_speed is None else ("d",)
        saturating = () if self.saturation_speeds is None else ("s",)
        return ("c", *stribeck, *saturating)

    def columns(self, position: np.ndarray, velocity: np.ndarray) -> list[np.ndarray]:
        """What c, d and s multiply [1], from position [rad] and velocity [rad/s] of shape (N, k); each (N, k)."""
        at_once = (0.0,) * velocity.shape[1]
        distance = np.array(self.presliding or at_once)
        sign = friction_direction(position, velocity, distance)
        columns = [sign]
        if self.stribeck_speed is not None:
            columns.append(sign * np.exp(-((velocity / self.stribeck_speed) ** 2)))
        if self.saturation_speeds is not None:
            relative = np.abs(velocity) / np.array(self.saturation_speeds)
            columns.append(sign * np.tanh(relative))
        return columns

    def __str__(self) -> str:
        """In words, for the report."""
        parts = ["Coulomb and viscous"]
        if self.stribeck_speed is not None:
            parts.append(f"Stribeck below {self.stribeck_speed:g} rad/s")
        if self.saturation_speeds is not None:
            speeds = ", ".join(f"{speed:.2g}" for speed in self.saturation_speeds)
            parts.append(f"saturating above {speeds} rad/s")
        if self.presliding is not None:
            distances = ", ".join(f"{1e3 * x:g}" for x in self.presliding)
            parts.append(
                f"direction kept at rest, turned round within {distances} mrad"
            )
        return ", ".join(parts)


def drives(arm: NominalArm) -> tuple[np.ndarray, tuple[str, ...]]:
    """What turns: D with speeds D dq [1], shape (n + k, n): the joints, then the k motors that move several of them.

    The speed of a motor, and the friction along D^T, count on the side of the joint of its own number.

    Returns:
        D, and labels: ``1`` to ``n``, and ``6m`` for motor 6.
    """
    joints = np.eye(arm.n_joints)
    labels = tuple(str(j + 1) for j in range(arm.n_joints))
    if arm.coupling is None or not arm.coupled_motors:
        return joints, labels
    rows = arm.coupling[[motor - 1 for motor in arm.coupled_motors]]
    motors = tuple(f"{motor}m" for motor in arm.coupled_motors)
    return np.vstack([joints, rows]), (*labels, *motors)


# The model of the pipeline, tau = W x: rigid bodies, rotors and friction of joints and coupled motors, offsets.


SMOOTH = ("rotor", "damping", "offset")
"""Quantities of drives whose columns do not depend on the friction law."""
MIN_ARM = 0.05
"""Lever that a link's first moment is at least counted with in its unit [m]."""


class ModelColumns:
    """W with tau = W x for an arm of n joints.

    First the ten inertial parameters of each link, rotor inertia I [kg m^2], viscous friction b [N m s/rad] and offset
    o [N m] of each joint, and I and b of each motor that moves several joints (``I6m``: motor 6, on the side of joint
    6); then dry friction by a ``FrictionLaw``: c and d [N m] of joints and coupled motors.

    The friction law counts positions and speeds of slides in what counts as a radian of them.

    Args:
        arm: the nominal arm; its coupling says which motors move several joints.
        body: rigid bodies of the arm; built if ``None``.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody | None = None,
    ) -> None:
        self.arm, self.body = arm, body or RigidBody(arm)
        self.drives, self.labels = drives(arm)
        self.regressor = Regressor(arm, self.body, SMOOTH)
        self._motors = arm.coupled_motors
        own = arm.per_radian[[motor - 1 for motor in self._motors]]
        self.per_radian = np.r_[arm.per_radian, own]
        self.links = 10 * arm.n_joints

    @property
    def coupled(self) -> tuple[str, ...]:
        """Labels of the coupled motors, ``6m``."""
        return self.labels[self.arm.n_joints :]

    def names(self, law: FrictionLaw) -> tuple[str, ...]:
        """Names of x, shape (p,)."""
        smooth = [f"{symbol}{label}" for symbol in ("I", "b") for label in self.coupled]
        dry = [f"{shape}{label}" for shape in law.shapes for label in self.labels]
        return (*self.regressor.names, *smooth, *dry)

    def units(self, law: FrictionLaw) -> tuple[str, ...]:
        """Units of x, shape (p,)."""
        slides = (*self.arm.sliding, *(self.arm.sliding[m - 1] for m in self._motors))
        coupled = slides[self.arm.n_joints :]
        dry = units_of("N m", slides) * len(law.shapes)
        smooth = (*units_of("kg m^2", coupled), *units_of("N m s/rad", coupled))
        return (*self.regressor.units, *smooth, *dry)

    def nominal(self, law: FrictionLaw) -> np.ndarray:
        """The x of the nominal arm and its data sheet, shape (p,)."""
        sheet = self.regressor.nominal()
        # rotor inertia and viscous friction of coupled motors are no part of the sheet
        motors = np.zeros(2 * len(self.coupled))
        dry = np.zeros((len(law.shapes), len(self.drives)))
        # the data sheet gives Coulomb friction of the joints alone
        dry[0, : self.arm.n_joints] = self.arm.coulomb
        return np.concatenate([sheet, motors, dry.ravel()])

    def smooth(self, motion: Motion) -> np.ndarray:
        """Columns that do not depend on the friction law, shape (N, n, p_smooth)."""
        motors = self.drives[self.arm.n_joints :]
        links = self.regressor.matrix(motion)
        inertia = _along(motion.ddq @ motors.T, motors)
        viscous = _along(motion.dq @ motors.T, motors)
        return np.concatenate([links, inertia, viscous], axis=2)

    def dry(self, motion: Motion, law: FrictionLaw) -> np.ndarray:
        """Columns of dry friction, shape (N, n, p_dry)."""
        # of drives that slide, what counts as a radian is one
        to = self.drives.T / self.per_radian
        return np.concatenate(
            [
                _along(x, self.drives)
                for x in law.columns(motion.q @ to, motion.dq @ to)
            ],
            axis=2,
        )

    def matrix(self, motion: Motion, law: FrictionLaw) -> np.ndarray:
        """W of a motion of N samples, shape (N, n, p)."""
        return np.concatenate([self.smooth(motion), self.dry(motion, law)], axis=2)

    def scale(self, law: FrictionLaw) -> np.ndarray:
        """Change of x that counts as 100 %, shape (p,); infinite for parameters that the nominal arm need not have.

        Mass m; first moments m max(|c|, 5 cm); inertia about the joint frame, half its trace.
        """
        out = np.full(len(self.names(law)), np.inf)
        links = self.body.inertial_parameters().reshape(-1, 10)
        # links of almost no mass still may gain some
        mass = np.maximum(links[:, 0], LEAST_MASS)
        moment = np.maximum(np.linalg.norm(links[:, 1:4], axis=1), MIN_ARM * mass)
        # half the trace, Ixx + Iyy + Izz
        half = 0.5 * links[:, [4, 6, 9]].sum(axis=1)
        inertia = np.maximum(half, mass * (0.2 * MIN_ARM) ** 2)
        sizes = np.stack([mass, moment, inertia], axis=1)
        out[: self.links] = np.repeat(sizes, [1, 3, 6], axis=1).ravel()
        return out


def _along(series: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Columns along the drives' directions: (N, k) and (k, n) to (N, n, k)."""
    return series[:, None, :] * directions.T[None]


# Whether samples can determine parameters, and if not, why: causes before a solver meets them.


STILL = 1e-9
"""A regressor whose columns vary by less than this, relative to its largest entry, belongs to an arm that rests."""
DEPENDENT = 1e-10
"""Pivots of R below this, relative, with columns of unit norm, mark columns that depend on those before them."""
UNIT_FACTOR = 5.0
"""Torque larger or smaller than the nominal arm's by more than this is suspected of another unit."""


def check_samples(
    problem: Problem, *, full_rank: bool = True, rows: np.ndarray | None = None
) -> None:
    """Check that the samples determine the parameters.

    Args:
        problem: to be solved.
        full_rank: whether every parameter must be determined by the samples alone.
        rows: fewer rows than the problem's with the same sums of squares, (K, b), if there are some.

    Raises:
        InputError: a value is not finite; too few samples; a trajectory that rests; columns that depend on each other.
    """
    for values, what, remedy in (
        (problem.torque, "torque", "drop or repair the rows; none is guessed"),
        (problem.matrix, "matrix", "drop rows of q, dq or ddq that are not finite"),
    ):
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            wrong = len(np.unique(bad[:, 0]))
            raise InputError(
                f"is not a finite number in {wrong} of {len(values)} samples, first in sample {bad[0][0] + 1}, joint "
                f"{bad[0][1] + 1}. Either (a) the log has gaps filled with NaN, (b) a column holds text or is empty, "
                "or (c) a division in the import went wrong",
                remedy,
                where=what,
            )
    equations, b = problem.torque.size, problem.matrix.shape[2]
    if full_rank and equations <= b:
        raise InputError(
            f"{len(problem.torque)} samples of {problem.n_joints} joints are {equations} equations for {b} parameters: "
            "too few. Either (a) the recording is too short, (b) filtering and trimming left little of it, or (c) the "
            "model has more parameters than this arm needs",
            "record for longer, or use base parameters, or an estimator with a prior (ridge, partial update)",
            where="samples",
        )
    spread = np.ptp(problem.matrix, axis=0).max(initial=0.0)
    if spread <= STILL * float(np.abs(problem.matrix).max(initial=0.0)):
        raise InputError(
            "the trajectory is constant: every sample gives the same equations. Either (a) the arm rested while it was "
            "recorded, (b) the position columns are not those of the moving joints, or (c) positions were rounded away",
            "record an exciting trajectory (`gapscope excite`)",
            where="q",
        )
    if full_rank:
        check_rank(problem.stacked()[0] if rows is None else rows, problem.names)


def unit_warnings(problem: Problem, nominal: np.ndarray) -> tuple[str, ...]:
    """Warnings about torque that is suspiciously small or large against the nominal arm's.

    Args:
        problem: with torque [N m] as recorded.
        nominal: parameters of the nominal arm, shape (b,), in the problem's columns.
    """
    recorded, expected = (rms(x) for x in (problem.torque, problem.matrix @ nominal))
    loaded = expected > 0.05 * expected.max(initial=0.0)
    if not loaded.any():
        return ()
    factor = float(np.median(recorded[loaded] / expected[loaded]))
    if 1 / UNIT_FACTOR < factor < UNIT_FACTOR:
        return ()
    size = "large" if factor > 1 else "small"
    return (
        f"the recorded torque is suspiciously {size}: {factor:.3g} times the nominal arm's. Either (a) its unit is not "
        "N m (N mm: 1000, N cm: 100), (b) it is a motor current, or a motor-side torque without the gear ratio, or (c) "
        "the nominal arm is another arm; state unit and transmission in import:, or correct the URDF",
    )


def check_rank(matrix: np.ndarray, names: Sequence[str]) -> None:
    """Check that rows of equations, (K, b), determine every parameter; raises ``InputError`` otherwise."""
    missing = max(0, matrix.shape[1] - len(matrix))
    matrix = np.pad(matrix, ((0, missing), (0, 0)))
    norms = np.linalg.norm(matrix, axis=0)
    unit = matrix / np.where(norms > 0, norms, 1.0)
    pivots = np.abs(np.diag(np.linalg.qr(unit, mode="r")))
    if (pivots > DEPENDENT).all():
        return
    open_names = ", ".join(np.asarray(names)[pivots <= DEPENDENT])
    raise InputError(
        f"the samples do not determine {open_names}. Either (a) the trajectory does not excite them, (b) the columns "
        "are not base parameters, so that some depend on others, or (c) a joint that they need did not move",
        "record an exciting trajectory (`gapscope excite`), use base parameters, or an estimator with a prior",
        where="matrix",
    )
