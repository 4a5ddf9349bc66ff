"""The search for an exciting trajectory: families of motions, criteria, gradients and optimisers."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import subspace_angles
from scipy.optimize import minimize
from scipy.special import ndtr

from gapscope.arm.control import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import (
    Fourier,
    Limits,
    ReferenceMotion,
    WayPoints,
    clamped_quintic,
)
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.severity import draw
from gapscope.ident.excitation.limits import Checker
from gapscope.ident.model.base_parameters import random_states, structural_base
from gapscope.ident.model.regressor import Regressor

# Families of trajectories, each q(t) = q0 + B(t) C: a basis over time, and coefficients C from free numbers.


RAMP = 1.0
"""Length of the flanks in which a motion rises from rest and falls back [s]."""


class Basis(NamedTuple):
    """B(t) and its first two derivatives, each of shape (N, m); 1, 1/s, 1/s^2."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


@dataclass(frozen=True)
class FourierFamily:
    """``gapscope.arm.motions.trajectory.Fourier`` with free a_k and b_k, weighed by 1/k [swevers2007].

    Attributes:
        n_joints: n.
        duration: [s].
        order: number of harmonics.
        frequency: of the first harmonic [Hz].
    """

    n_joints: int
    duration: float
    order: int
    frequency: float

    @property
    def size(self) -> int:
        """Count of free numbers, 2 order n."""
        return 2 * self.order * self.n_joints

    @property
    def highest_frequency(self) -> float:
        """That of the last harmonic, or of the window if its flanks are steeper [Hz]."""
        return max(self.order * self.frequency, 0.5 / RAMP)

    def basis(self, t: np.ndarray) -> Basis:
        """Windowed sines, then windowed cosines; m = 2 order."""
        series = self.reference(np.zeros(2 * self.order), np.eye(2 * self.order))
        return Basis(series.position(t), series.velocity(t), series.acceleration(t))

    def coefficients(self, free: np.ndarray) -> np.ndarray:
        """The free numbers over k."""
        return free.reshape(2 * self.order, self.n_joints) / self._harmonics

    def pullback(self, free: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """The gradient over k."""
        return (gradient / self._harmonics).ravel()

    def reference(self, centre: np.ndarray, coefficients: np.ndarray) -> Fourier:
        """A Fourier series."""
        sine, cosine = coefficients[: self.order], coefficients[self.order :]
        return Fourier(
            centre=centre,
            sine=sine,
            cosine=cosine,
            frequency=self.frequency,
            duration=self.duration,
            ramp=RAMP,
        )

    @property
    def _harmonics(self) -> np.ndarray:
        return np.tile(np.arange(1.0, self.order + 1), 2)[:, None]


@dataclass(frozen=True)
class MultisineFamily(FourierFamily):
    """Random phase multisine: the Fourier series with amplitudes 1/k, the same velocity at all harmonics, free phases.

    [pintelon2012].
    """

    @property
    def size(self) -> int:
        """Count of phases, order n."""
        return self.order * self.n_joints

    def coefficients(self, free: np.ndarray) -> np.ndarray:
        """Sine and cosine shares of 1/k at a phase of pi times the free number."""
        phase = np.pi * free.reshape(self.order, self.n_joints)
        return np.concatenate([np.cos(phase), np.sin(phase)]) / self._harmonics

    def pullback(self, free: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Chain rule over sine and cosine."""
        phase = np.pi * free.reshape(self.order, self.n_joints)
        sine, cosine = np.split(gradient / self._harmonics, 2)
        return np.pi * (-np.sin(phase) * sine + np.cos(phase) * cosine).ravel()


@dataclass(frozen=True)
class QuinticFamily:
    """``gapscope.arm.motions.trajectory.WayPoints`` with free way points at equal times; it starts and ends at q0.

    Attributes:
        n_joints: n.
        duration: [s].
        points: number of way points between start and end.
    """

    n_joints: int
    duration: float
    points: int

    @property
    def size(self) -> int:
        """Count of free numbers, points n."""
        return self.points * self.n_joints

    @property
    def highest_frequency(self) -> float:
        """Frequency of a motion that turns at every way point [Hz]."""
        return (self.points + 1) / (2 * self.duration)

    def basis(self, t: np.ndarray) -> Basis:
        """Splines that are 1 at one way point and 0 at the others; m = points."""
        t = np.clip(t, 0.0, self.duration)
        return Basis(*(self._splines(t, derivative) for derivative in (0, 1, 2)))

    def coefficients(self, free: np.ndarray) -> np.ndarray:
        """The free numbers."""
        return free.reshape(self.points, self.n_joints)

    def pullback(self, free: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """The gradient itself."""
        return gradient.ravel()

    def reference(self, centre: np.ndarray, coefficients: np.ndarray) -> WayPoints:
        """A spline."""
        rest = np.zeros((1, self.n_joints))
        return WayPoints(
            self._times, centre + np.concatenate([rest, coefficients, rest])
        )

    @cached_property
    def _splines(self) -> BSpline:
        return clamped_quintic(self._times, np.eye(self.points + 2)[:, 1:-1])

    @property
    def _times(self) -> np.ndarray:
        return np.linspace(0.0, self.duration, self.points + 2)


KINDS = ("fourier", "quintic", "multisine")
"""Names of the families."""


Family = FourierFamily | QuinticFamily
"""A family of trajectories of n joints, at rest at both ends; C from ``size`` free numbers."""


def family(
    kind: str, n_joints: int, duration: float, order: int, frequency: float
) -> Family:
    """A family by its name; a quintic has 2 order way points, as many free numbers as the Fourier series.

    Raises:
        InputError: unknown name.
    """
    check_known("kind of trajectory", kind, KINDS, where="kind")
    if kind == "quintic":
        return QuinticFamily(n_joints, duration, 2 * order)
    made = FourierFamily if kind == "fourier" else MultisineFamily
    return made(n_joints, duration, order, frequency)


# From unbounded numbers to trajectories that keep their limits of position, velocity and acceleration.


STEP = 0.004
"""Time between the samples at which the limits are kept by construction [s]."""
RESERVE = 0.998
"""Share of the limits that is used, for what lies between those samples [1]."""
ROOM = 0.9
"""Share of the position range in which a centre may lie [1]."""


class _Decoded(NamedTuple):
    """Centre, share, S and gain as in ``Parametrisation``; the row in which a joint uses a limit most, and its sign."""

    centre: np.ndarray
    share: np.ndarray
    raw: np.ndarray
    gain: np.ndarray
    active: np.ndarray
    sign: np.ndarray

    @property
    def coefficients(self) -> np.ndarray:
        """C [rad], shape (m, n)."""
        return np.asarray(self.share * self.gain * self.raw)


class Parametrisation:
    """Every x of R^d is a trajectory q0 + B(t) C within the limits of position, velocity and acceleration.

    x holds n numbers for the centre, q0 = middle + 0.9 (2 Phi(x) - 1) half the range; n for the amplitude, the share
    Phi(x) of what the limits allow; and those of the family. Phi is the normal distribution, so that standard normal x
    draw centre and amplitude uniformly. C_j = share_j gain_j S_j, where S are the family's coefficients and 1 / gain_j
    is the largest use of a limit of joint j over time by B S_j.

    Args:
        family: of trajectories.
        limits: of position, velocity and acceleration.
    """

    def __init__(self, family: Family, limits: Limits) -> None:
        self.family, self.limits = family, limits
        self._n = family.n_joints
        self.size = 2 * self._n + family.size
        # limits are checked at these times
        self._count = int(np.ceil(family.duration / STEP)) + 1
        dense = family.basis(np.linspace(0.0, family.duration, self._count))
        kinds = [dense.position, dense.velocity, dense.acceleration]
        self._rows = np.concatenate(kinds)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """A random x, shape (d,)."""
        return rng.standard_normal(self.size)

    def reference(self, x: np.ndarray) -> ReferenceMotion:
        """The trajectory."""
        found = self._decode(x)
        return self.family.reference(found.centre, found.coefficients)

    def motion(self, x: np.ndarray, t: np.ndarray, basis: Basis) -> Motion:
        """The motion at times t [s], shape (N,), at which ``basis`` was taken."""
        found = self._decode(x)
        q, dq, ddq = (rows @ found.coefficients for rows in basis)
        return Motion(t, found.centre + q, dq, ddq)

    def pullback(
        self,
        x: np.ndarray,
        basis: Basis,
        gradients: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> np.ndarray:
        """Gradient by x, shape (d,), from those by q, dq and ddq at the samples of a basis, each (N, n).

        If several samples use the same limit equally, it is the gradient for one of them.
        """
        n, decoded = self._n, self._decode(x)
        # by the coefficients share * gain * raw
        by_coefficients = np.zeros_like(decoded.raw)
        for rows, gradient in zip(basis, gradients, strict=True):
            by_coefficients += rows.T @ gradient
        along = (decoded.raw * by_coefficients).sum(axis=0)
        # the gain is RESERVE over the use of the limit that is used most
        by_use = -(decoded.gain**2) / RESERVE * decoded.share * along
        limit, use_by_centre = self._active_limit(decoded)
        active_rows = self._rows[decoded.active].T
        by_raw = (
            decoded.share * decoded.gain * by_coefficients
            + by_use * decoded.sign / limit * active_rows
        )
        by_centre = gradients[0].sum(axis=0) + by_use * use_by_centre
        half = (self.limits.upper - self.limits.lower) / 2
        by_share = decoded.gain * along
        by_uniform = np.concatenate([by_centre * 2 * ROOM * half, by_share])
        # centre and share are uniform: the normal distribution of x
        density = np.exp(-(x[: 2 * n] ** 2) / 2) / np.sqrt(2 * np.pi)
        by_coefficient_numbers = self.family.pullback(x[2 * n :], by_raw)
        return np.concatenate([by_uniform * density, by_coefficient_numbers])

    def _decode(self, x: np.ndarray) -> _Decoded:
        n, limits = self._n, self.limits
        lower, upper = limits.lower, limits.upper
        away = 2 * ndtr(x[:n]) - 1
        centre = (lower + upper) / 2 + ROOM * away * (upper - lower) / 2
        raw = self.family.coefficients(x[2 * n :])
        # position, velocity and acceleration, each at all times: (3, times, n)
        series = (self._rows @ raw).reshape(3, self._count, n)
        above = np.stack([upper - centre, limits.velocity, limits.acceleration])
        below = np.stack([centre - lower, limits.velocity, limits.acceleration])
        uses = np.concatenate([series.max(axis=1) / above, -series.min(axis=1) / below])
        # rows 0 to 2 are the upper limits of the three, 3 to 5 the lower ones
        most_used = uses.argmax(axis=0)
        joints = np.arange(n)
        kind, is_upper = most_used % 3, most_used < 3
        time = np.where(
            is_upper,
            series.argmax(axis=1)[kind, joints],
            series.argmin(axis=1)[kind, joints],
        )
        # a joint that does not move uses no limit
        use = np.maximum(uses[most_used, joints], 1e-12)
        return _Decoded(
            centre=centre,
            share=ndtr(x[n : 2 * n]),
            raw=raw,
            gain=RESERVE / use,
            active=kind * self._count + time,
            sign=np.where(is_upper, 1.0, -1.0),
        )

    def _active_limit(self, found: _Decoded) -> tuple[np.ndarray, np.ndarray]:
        """The limit that each joint uses most, and the derivative of that use by q0 [1/rad]; each of shape (n,)."""
        kind = found.active // self._count
        above, below = (
            self.limits.upper - found.centre,
            found.centre - self.limits.lower,
        )
        room = np.where(found.sign > 0, above, below)
        position, velocity = kind == 0, kind == 1
        limit = np.select(
            [position, velocity],
            [room, self.limits.velocity],
            self.limits.acceleration,
        )
        use = RESERVE / found.gain
        return limit, np.where(position, found.sign * use / room, 0.0)


# How well a trajectory excites: functions of the eigenvalues of the information matrix W^T W.


FLOOR = 1e-13
"""Eigenvalues below this share of the largest count as this [1]."""


@dataclass(frozen=True)
class Criterion:
    """A function of the eigenvalues of A = S W^T W S, to be made small.

    Attributes:
        name: ``condition``, ``d`` or ``e``.
        scaling: ``unit``: S gives every column of W the norm 1; ``fixed``: S divides by the RMS that the column has
            over random states, and by the square root of the count of samples, so that larger motions count more.
        value: of the eigenvalues, shape (b,).
        slope: its derivative by each of them, shape (b,).
    """

    name: str
    scaling: str
    value: Callable[[np.ndarray], float]
    slope: Callable[[np.ndarray], np.ndarray]

    def evaluate(self, matrix: np.ndarray, reference: np.ndarray) -> float:
        """The value for W of shape (N, n, b), given the columns' RMS over random states, (b,)."""
        return self.value(self._spectrum(*self._scaled(matrix, reference))[0])

    def gradient(self, matrix: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Derivative of the value by W, shape (N, n, b)."""
        scaled, scale = self._scaled(matrix, reference)
        values, vectors = self._spectrum(scaled, scale)
        by_gram = (vectors * self.slope(values)) @ vectors.T
        by_scaled = 2 * scaled @ by_gram
        if self.scaling == "unit":
            # the norm of a column is divided out: no gradient along the column
            along = (scaled * by_scaled).sum(axis=0)
            by_scaled = by_scaled - scaled * along
        return (by_scaled / scale).reshape(matrix.shape)

    def _scaled(
        self, matrix: np.ndarray, reference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        flat = matrix.reshape(-1, matrix.shape[2])
        scale = np.sqrt(len(flat)) * reference
        if self.scaling == "unit":
            scale = np.linalg.norm(flat, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        return flat / scale, scale

    @staticmethod
    def _spectrum(
        scaled: np.ndarray, scale: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        values, vectors = np.linalg.eigh(scaled.T @ scaled)
        return np.maximum(values, FLOOR * max(values[-1], FLOOR)), vectors


def condition_number(matrix: np.ndarray) -> float:
    """Condition number of W, shape (N, n, b), with every column scaled to unit norm [1]; infinite for a zero column."""
    flat = matrix.reshape(-1, matrix.shape[2])
    norms = np.linalg.norm(flat, axis=0)
    if (norms == 0).any():
        return float("inf")
    return float(np.linalg.cond(flat / norms))


def _ends(values: np.ndarray, least: float, largest: float) -> np.ndarray:
    """A slope by the logarithms of the least and the largest eigenvalue alone, (b,)."""
    out = np.zeros_like(values)
    out[0], out[-1] = least / values[0], largest / values[-1]
    return out


CRITERIA = {
    "condition": Criterion(
        name="condition",
        scaling="unit",
        value=lambda v: 0.5 * float(np.log(v[-1] / v[0])),
        slope=lambda v: _ends(v, -0.5, 0.5),
    ),
    "d": Criterion(
        name="d",
        scaling="fixed",
        value=lambda v: -0.5 * float(np.mean(np.log(v))),
        slope=lambda v: -0.5 / (len(v) * v),
    ),
    "e": Criterion(
        name="e",
        scaling="fixed",
        value=lambda v: -0.5 * float(np.log(v[0])),
        slope=lambda v: _ends(v, -0.5, 0.0),
    ),
}
"""``condition``: log of the condition number, columns scaled to unit norm [gautier1992]. ``d``: minus the mean log of
the singular values, half the log determinant over b; ``e``: minus the log of the smallest singular value
[swevers2007]."""


# How well a trajectory separates effects from each other and from the base parameters.


class Separated(NamedTuple):
    """How far effects are apart on a trajectory.

    Attributes:
        least: smallest singular value of all signatures, each of norm 1 before the base parameters are taken out: 0
            if some mixture of them shows nothing of its own, 1 if all are perpendicular to each other and to
            the base parameters.
        angle: least angle between the subspaces of two effects, after the base parameters are taken out [rad], for
            each pair of names.
    """

    least: float
    angle: dict[tuple[str, str], float]


class Separator(Protocol):
    """Says how far explanations are apart on a motion."""

    def separate(self, motion: Motion, matrix: np.ndarray) -> Separated:
        """On a motion of N samples with base regressor W, shape (N, n, b)."""


class Signatures:
    """Changes of torque by effects of typical size, one for each joint of an effect on joints.

    Args:
        arm: the nominal arm.
        body: its rigid bodies.
        names: of effects in the catalogue, two or more.
        seed: of their sizes, drawn by ``gapscope.effects.severity``.

    Raises:
        InputError: fewer than two effects, the same one twice, or one that is not known.
    """

    def __init__(
        self, arm: NominalArm, body: RigidBody, names: Sequence[str], seed: int = 0
    ) -> None:
        if len(names) < 2 or len(set(names)) < len(names):
            raise InputError(
                "separation needs two or more different effects",
                "name them, with commas",
                where="effects",
            )
        self.names, self._arm, self._body = tuple(names), arm, body
        scale, rng = ArmScale.of(arm), np.random.default_rng(seed)
        self._applied: list[tuple[str, AppliedEffect]] = []
        for name in names:
            check_known("effect", name, CATALOGUE, where="effects")
            if CATALOGUE[name].scope != "joint":
                self._applied.append((name, draw(name, rng, scale, None)))
                continue
            for joint in range(1, arm.n_joints + 1):
                self._applied.append((name, draw(name, rng, scale, [joint])))

    def of(self, motion: Motion) -> np.ndarray:
        """Change of the torque that would be recorded [N m], N n rows, one column for each effect and joint."""
        nominal = CorrectedArm(self._arm).predict(self._body, motion)
        changes = []
        for _, effect in self._applied:
            torque = CorrectedArm(self._arm, (effect,)).predict(self._body, motion)
            changes.append((torque - nominal).ravel())
        return np.column_stack(changes)

    def separate(self, motion: Motion, matrix: np.ndarray) -> Separated:
        """How far the effects are apart on a motion of N samples with base regressor W, shape (N, n, b).

        With Z the signatures, each divided by its norm, and P the residual of a vector after least squares with the
        columns of W: the smallest singular value of P Z, and the angles between the P Z of two effects.
        """
        signatures = self.of(motion)
        norms = np.linalg.norm(signatures, axis=0)
        unit = signatures / np.where(norms > 0, norms, 1.0)
        basis = _column_space(matrix.reshape(-1, matrix.shape[2]))
        # base parameters can absorb this much of an effect
        residual = unit - basis @ (basis.T @ unit)
        least = float(np.linalg.svd(residual, compute_uv=False)[-1])
        owner = np.array([name for name, _ in self._applied])
        angles = {
            (a, b): _least_angle(residual[:, owner == a], residual[:, owner == b])
            for a, b in itertools.combinations(self.names, 2)
        }
        return Separated(least, angles)


def _column_space(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the columns, those of almost no content left out."""
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    basis, values, _ = np.linalg.svd(columns / norms, full_matrices=False)
    return basis[:, values > 1e-9 * values[0]]


def _least_angle(first: np.ndarray, second: np.ndarray) -> float:
    """Least principal angle between two column spaces [rad]; 0 if one of them is empty."""
    shown = [x[:, np.linalg.norm(x, axis=0) > 1e-9] for x in (first, second)]
    if not all(x.size for x in shown):
        return 0.0
    return float(subspace_angles(*shown).min())


# Model that scores a candidate: the base columns of its regressor and its torque, with exact derivatives.


MODEL_SAMPLES = 400
"""Random samples from which the base columns are found."""
SHIFTS = np.array([1.0, 3.0, 5.0, 7.0]) * np.pi / 4
"""Shifts from which the derivative of a trigonometric polynomial of degree two is exact [rad]."""
WEIGHTS = np.array([1.0, -1.0, 1.0, -1.0]) / (8 * np.sin(SHIFTS / 2) ** 2)
"""Their weights."""


class ExcitationModel:
    """Base regressor W(q, dq, ddq) and nominal torque of an arm.

    The inertial columns are linear in ddq, quadratic in dq and, as rotations enter each of them twice, trigonometric
    polynomials of degree two in the position of every joint that turns. Their derivatives therefore follow without
    error from a few shifted evaluations: by ddq from one step, by dq from two, by q from four [wierichs2022]. The
    sign of the velocity in the column of Coulomb friction counts as constant.

    Args:
        arm: the nominal arm.
        quantities: with columns of their own, as in ``Regressor``.

    Attributes:
        names: of the base columns, shape (b,).
        reference: RMS of each base column over random states within the limits, shape (b,).
    """

    def __init__(
        self, arm: NominalArm, body: RigidBody, quantities: tuple[str, ...] = ()
    ) -> None:
        self.arm, self.body = arm, body
        self._regressor = Regressor(arm, body, quantities)
        base = structural_base(self._regressor, np.random.default_rng(0), MODEL_SAMPLES)
        self._kept = base.kept
        self.names = tuple(self._regressor.names[i] for i in self._kept)
        states = random_states(self._regressor, np.random.default_rng(0), MODEL_SAMPLES)
        # typical size of each column, whatever the motion
        mean_square = (self.matrix(states) ** 2).mean(axis=(0, 1))
        self.reference = np.sqrt(mean_square)

    def matrix(self, motion: Motion) -> np.ndarray:
        """W of a motion of N samples, shape (N, n, b)."""
        return self._regressor.matrix(motion)[:, :, self._kept]

    def torque(self, motion: Motion) -> np.ndarray:
        """Nominal torque with armature and data sheet friction [N m], shape (N, n)."""
        return feedforward(
            self.arm, self.body, "nominal", motion.q, motion.dq, motion.ddq
        )

    def pullback(
        self, motion: Motion, by_matrix: np.ndarray, by_torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gradients by q, dq and ddq, each (N, n), of a function whose gradients by W and torque are given.

        Args:
            motion: N samples.
            by_matrix: gradient by W, shape (N, n, b).
            by_torque: gradient by the nominal torque, shape (N, n).
        """
        n, links = self.arm.n_joints, 10 * self.arm.n_joints
        full = np.zeros((len(motion.t), n, len(self._regressor.names)))
        full[:, :, self._kept] = by_matrix
        # the nominal torque is the regressor times the nominal parameters
        by_nominal = by_torque[:, :, None] * self.body.inertial_parameters()
        by_q, by_dq, by_ddq = self._inertial(motion, full[:, :, :links] + by_nominal)
        by_ddq += self.arm.armature * by_torque
        by_dq += self.arm.viscous * by_torque
        for k, name in enumerate(self._regressor.quantities):
            first = links + k * n
            own = np.einsum("ijj->ij", full[:, :, first : first + n])
            if name == "rotor":
                by_ddq += own
            elif name == "damping":
                by_dq += own
        return by_q, by_dq, by_ddq

    def _inertial(
        self, motion: Motion, weight: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of sum(weight * Y) by q, dq and ddq, each (N, n); Y and weight have shape (N, n, 10 n)."""
        q, dq, ddq = motion.q, motion.dq, motion.ddq

        def contracted(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
            return np.einsum("tij,tij->t", weight, self.body.regressor(q, dq, ddq))

        here = contracted(q, dq, ddq)
        by_q, by_dq, by_ddq = (np.zeros_like(q) for _ in range(3))
        for j, unit in enumerate(np.eye(q.shape[1])):
            # exact: trigonometric in q, quadratic in dq, linear in ddq
            shifted = [contracted(q + shift * unit, dq, ddq) for shift in SHIFTS]
            by_q[:, j] = WEIGHTS @ np.array(shifted)
            faster, slower = (
                contracted(q, dq + unit, ddq),
                contracted(q, dq - unit, ddq),
            )
            by_dq[:, j] = (faster - slower) / 2
            by_ddq[:, j] = contracted(q, dq, ddq + unit) - here
        return by_q, by_dq, by_ddq


# A search for the best trajectory: what a candidate scores, what it costs, and the best ones that keep all limits.


SAMPLES = 200
"""Samples of a candidate during the search."""
PENALTY = 10.0
"""Score for a limit broken by all of it; smaller breaches count in proportion."""
PENALISED = ("torque", "singular value", "distance")
"""Limits that candidates may break; the others are kept by construction."""
TOLERATED = np.array([0.005, 0.05, 0.05])
"""Breaches that still count as kept: half of what the limits are tightened by [1]. Up to there the penalty grows with
the square, so that a descent does not stall on the edge of what is allowed."""
DISTANCE_SCALE = 0.1
"""Distance by which a clearance counts as broken by all of it [m]."""


@dataclass(frozen=True)
class Budget:
    """When a search ends: at the first of these.

    Attributes:
        evaluations: candidates evaluated, one with its gradient counted as ``GRADIENT_COST``; ``None`` for any.
        seconds: time [s]; ``None`` for any, and then a search with the same seed gives the same result.

    Raises:
        InputError: neither is given, or one is not positive.
    """

    evaluations: int | None = 3000
    seconds: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in vars(self).items():
            if value is not None and not value > 0:
                raise InputError(
                    f"a budget of {value:g} is spent at once",
                    "give a positive number",
                    where=name,
                )
        if self.evaluations is None and self.seconds is None:
            raise InputError(
                "the search would never end",
                "give evaluations, seconds or both",
                where="budget",
            )


GRADIENT_COST = 8
"""Evaluations that one with a gradient counts as: what it takes on an arm with seven joints."""


@dataclass(frozen=True)
class Found:
    """A candidate that keeps all limits at the samples of the search.

    Attributes:
        x: its numbers, shape (d,).
        value: of the criterion.
        evaluations: when it was found.
    """

    x: np.ndarray
    value: float
    evaluations: int


@dataclass
class TrajectorySearch:
    """Scores candidates and keeps the best ones.

    The score is the value of the criterion plus a penalty for torque, singular values and distances that break their
    limits, which are somewhat tighter here than the final ones, for what lies between the samples.

    Attributes:
        parametrisation: of the trajectories.
        model: of the arm.
        criterion: to be made small; with ``signatures``, minus the log of the separation is made small instead.
        checker: of the limits, tightened.
        budget: when to end.
        signatures: of the effects to separate, or ``None``.
        progress: called with the share of the budget spent [1] and the best value so far, or infinity.
        samples: of a candidate during the search.
        found: candidates that keep all limits, each better than those before it.
        evaluations: spent.
        judged: number of candidates scored.
        feasible: number of candidates that kept all limits.
    """

    parametrisation: Parametrisation
    model: ExcitationModel
    criterion: Criterion
    checker: Checker
    budget: Budget
    signatures: Separator | None = None
    progress: Callable[[float, float], None] = lambda share, best: None
    samples: int = SAMPLES
    found: list[Found] = field(init=False, default_factory=list)
    evaluations: int = field(init=False, default=0)
    judged: int = field(init=False, default=0)
    feasible: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        """Sample the basis, and start the clock."""
        family = self.parametrisation.family
        self._t = np.linspace(0.0, family.duration, self.samples)
        self._basis = family.basis(self._t)
        self._start = time.monotonic()
        self._broken = np.zeros(len(PENALISED), dtype=int)

    @property
    def spent(self) -> bool:
        """Whether the budget is spent."""
        return self.share >= 1

    @property
    def share(self) -> float:
        """Share of the budget that is spent [1]."""
        evaluations, seconds = self.budget.evaluations, self.budget.seconds
        share = 0.0
        if evaluations:
            share = self.evaluations / evaluations
        if seconds:
            share = max(share, (time.monotonic() - self._start) / seconds)
        return min(share, 1.0)

    @property
    def hardest(self) -> tuple[str, ...]:
        """Limits that half of the candidates broke, and the one that most broke, which comes first."""
        first, *others = np.argsort(-self._broken, kind="stable")
        often = [i for i in others if 2 * self._broken[i] >= self.judged]
        return tuple(PENALISED[i] for i in (first, *often))

    def score(self, x: np.ndarray) -> float:
        """Score of a candidate, shape (d,)."""
        self.evaluations += 1
        motion = self.parametrisation.motion(x, self._t, self._basis)
        value = self._value(motion, self.model.matrix(motion))
        torque, _ = self._torque_breach(self.model.torque(motion))
        breaches = [torque]
        for slack, scale in self._slacks(motion.q):
            breaches.append(max(0.0, -float(slack.min()) / scale))
        return self._note(x, value, breaches)

    def score_and_gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Score of a candidate and its gradient, shape (d,), exact but for distances, by central differences."""
        self.evaluations += GRADIENT_COST
        motion = self.parametrisation.motion(x, self._t, self._basis)
        matrix = self.model.matrix(motion)
        value = self._value(motion, matrix)
        torque, by_torque = self._torque_breach(self.model.torque(motion))
        breaches = [torque]
        # derivatives of the other breaches by q, which the worst sample alone decides
        by_position = np.zeros((2, *motion.q.shape))
        for k, (slack, scale) in enumerate(self._slacks(motion.q)):
            worst = int(slack.argmin())
            breaches.append(max(0.0, -float(slack[worst]) / scale))
            if slack[worst] < 0:
                by_position[k, worst] -= self._slope(motion.q[worst], k) / scale
        weight = PENALTY * np.minimum(np.array(breaches) / TOLERATED, 1.0)
        by_matrix = self.criterion.gradient(matrix, self.model.reference)
        by_q, by_dq, by_ddq = self.model.pullback(
            motion, by_matrix, weight[0] * by_torque
        )
        by_q += weight[1] * by_position[0] + weight[2] * by_position[1]
        gradient = self.parametrisation.pullback(x, self._basis, (by_q, by_dq, by_ddq))
        return self._note(x, value, breaches), gradient

    def _value(self, motion: Motion, matrix: np.ndarray) -> float:
        if self.signatures is None:
            return self.criterion.evaluate(matrix, self.model.reference)
        separation = self.signatures.separate(motion, matrix).least
        return -float(np.log(max(separation, 1e-12)))

    def _note(self, x: np.ndarray, value: float, breaches: list[float]) -> float:
        """The score; a candidate that keeps all limits is counted, and kept if it is the best so far."""
        breach = np.array(breaches)
        self.judged += 1
        self._broken += breach > TOLERATED
        if (breach <= TOLERATED).all():
            self.feasible += 1
            # the list is a record of improvements: the last is the best
            if not self.found or value < self.found[-1].value:
                self.found.append(Found(np.array(x), value, self.evaluations))
        best = self.found[-1].value if self.found else np.inf
        self.progress(self.share, best)
        # quadratic up to what is tolerated, linear beyond, with a continuous slope
        quadratic, linear = breach**2 / (2 * TOLERATED), breach - TOLERATED / 2
        penalties = np.where(breach < TOLERATED, quadratic, linear)
        return value + PENALTY * float(penalties.sum())

    def _torque_breach(self, torque: np.ndarray) -> tuple[float, np.ndarray]:
        """Sum over joints of the largest breach as a share of the limit, and its derivative by torque, (N, n)."""
        limit = self.checker.allowed.torque
        joints = np.arange(torque.shape[1])
        worst = np.abs(torque).argmax(axis=0)
        peak = torque[worst, joints]
        breach = np.maximum(np.abs(peak) / limit - 1, 0.0)
        slope = np.zeros_like(torque)
        slope[worst, joints] = np.where(breach > 0, np.sign(peak) / limit, 0.0)
        return float(breach.sum()), slope

    def _slacks(self, q: np.ndarray) -> list[tuple[np.ndarray, float]]:
        """Slack of singular value and distance at q, (N, n), each (N,), with what counts as broken by all of it."""
        allowed, checker = self.checker.allowed, self.checker
        unlimited = np.full(len(q), np.inf)
        singular = (
            checker.singular_value(q) - allowed.singular
            if allowed.singular > 0
            else unlimited
        )
        return [
            (singular, max(allowed.singular, 1e-3)),
            (checker.distance(q) - allowed.clearance, DISTANCE_SCALE),
        ]

    def _slope(self, q: np.ndarray, which: int, step: float = 1e-4) -> np.ndarray:
        """Derivative of one slack by q, shape (n,), by central differences."""
        shifts = step * np.eye(len(q))
        up, down = (self._slacks(q + shifts * sign)[which][0] for sign in (1, -1))
        return (up - down) / (2 * step)


# Optimisers: each spends the budget of a search; what it found lies in ``search.found``.


Optimiser = Callable[[TrajectorySearch, np.random.Generator], None]


def random_search(
    search: TrajectorySearch, rng: np.random.Generator, feasible: float = np.inf
) -> None:
    """Independent draws of standard normal numbers, until the budget is spent or so many kept all limits."""
    while not search.spent and search.feasible < feasible:
        search.score(search.parametrisation.draw(rng))


STARTS = 0.05
"""Share of the budget for the random candidates of each start [1]."""


def random_starts(
    search: TrajectorySearch, rng: np.random.Generator, count: int
) -> np.ndarray:
    """The best of random candidates, best first, shape (count, d), for ``STARTS`` of the whole budget."""
    candidates: list[np.ndarray] = []
    scores: list[float] = []
    end = search.share + STARTS
    while len(candidates) < count or (search.share < end and not search.spent):
        x = search.parametrisation.draw(rng)
        candidates.append(x)
        scores.append(search.score(x))
    best = np.argsort(scores, kind="stable")[:count]
    return np.array(candidates)[best]


# Gradient refinement: quasi-Newton steps with analytic derivatives.


WORTH = 0.01
"""Least gain for which a descent that has stalled is begun anew at its end."""


class _SpentError(Exception):
    """The budget is spent."""


def refinement(search: TrajectorySearch, rng: np.random.Generator) -> None:
    """L-BFGS from the best of random candidates; from new ones if it can go no further.

    A criterion has edges where eigenvalues or broken limits swap places. There the descent stalls, and is begun anew
    without its memory of curvature as long as that helps.
    """

    def objective(x: np.ndarray) -> tuple[float, np.ndarray]:
        if search.spent:
            raise _SpentError
        return search.score_and_gradient(x)

    options = {"maxcor": 30}
    with suppress(_SpentError):
        while not search.spent:
            x, before = random_starts(search, rng, 1)[0], np.inf
            while True:
                done = minimize(
                    objective, x, jac=True, method="L-BFGS-B", options=options
                )
                if before - done.fun < WORTH:
                    break
                x, before = done.x, float(done.fun)


# CMA-ES: evolution with an adapted covariance.


SPREAD = 0.3
"""Initial standard deviation, in that of random draws [1]."""


def evolution(search: TrajectorySearch, rng: np.random.Generator) -> None:
    """CMA-ES [hansen2016] by the package ``cma``, from the best of random candidates; started anew if it stalls."""
    import cma

    options: dict[str, Any] = {
        "verbose": -9,
        "seed": np.nan,  # the generator that is passed in draws, not numpy's global one
        "randn": lambda *shape: rng.standard_normal(shape),
        "maxfevals": np.inf,
    }
    # a run that has converged is begun anew elsewhere
    while not search.spent:
        start = random_starts(search, rng, 1)[0]
        strategy = cma.CMAEvolutionStrategy(start, SPREAD, options)
        while not search.spent and not strategy.stop():
            candidates = strategy.ask()
            scores = []
            for x in candidates:
                scores.append(search.score(np.asarray(x)))
                if search.spent:
                    return
            strategy.tell(candidates, scores)


# Particle swarm.


PARTICLES = 40
INERTIA, PULL = 0.7298, 1.4962
"""w and c of a swarm [1]."""
REACH = 3.0
"""Particles stay within this many standard deviations of a random draw."""


def swarm(search: TrajectorySearch, rng: np.random.Generator) -> None:
    """A particle swarm with the constriction of [clerc2002].

    v <- w v + c r1 (own best - x) + c r2 (best of all - x), x <- x + v, with r1, r2 uniform per coordinate.
    """
    x = random_starts(search, rng, PARTICLES)
    best = x.copy()
    scores = np.array([search.score(particle) for particle in x])
    v = 0.1 * rng.standard_normal(x.shape)
    while not search.spent:
        for i in range(PARTICLES):
            leader = best[int(scores.argmin())]
            own, common = rng.uniform(0.0, PULL, (2, x.shape[1]))
            to_own, to_leader = best[i] - x[i], leader - x[i]
            v[i] = INERTIA * v[i] + own * to_own + common * to_leader
            # far out all candidates map to the edge of the limits
            x[i] = np.clip(x[i] + v[i], -REACH, REACH)
            score = search.score(x[i])
            if score < scores[i]:
                best[i] = x[i]
                scores[i] = score
            if search.spent:
                break
