"""The search for an exciting trajectory: limits, families of motions, criteria, gradients and optimisers."""

from __future__ import annotations

import itertools
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import orth, subspace_angles
from scipy.optimize import minimize
from scipy.special import ndtr

from gapscope.arm.control import feedforward
from gapscope.arm.dynamics.kinematics import Kinematics, smallest_singular_value
from gapscope.arm.dynamics.link_shapes import CollisionModel
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import common_unit, joint_unit
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import (
    Curve,
    Fourier,
    Limits,
    ReferenceMotion,
    Sampled,
    way_points,
)
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.root_mean_square import rms
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.severity import draw
from gapscope.ident.model.base_parameters import (
    FLOOR,
    ROUNDING,
    STATES,
    TINY,
    WORTH,
    base_parameters,
    random_states,
)
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor
from gapscope.model.conditioning import WORKING_RATE
from gapscope.model.design import LIKELY

# What a trajectory has to keep, and by how much it keeps it.


JERK_TIME = 0.02
"""Shortest time in which the acceleration may rise from nothing to its limit [s]: jerk is bounded by their ratio."""
SPARE = 1e-4
"""What is kept of a limit for rounding and interpolation of the files: a share [1], or a distance [m]."""
SURFACE = "surface"
"""Name of the surface among the bodies of a ``CollisionModel``."""
REMEDIES = {
    "torque": "raise --torque, or lower --acceleration and --velocity",
    "torque when slow": "raise --torque: the posture alone needs it",
    "jerk": "lower --frequency, --order or --acceleration",
    "singular value": "lower --singular",
    "distance": "lower --clearance",
    SURFACE: "lower --surface, the height under the arm",
}
"""What to change if candidates break a limit."""


@dataclass(frozen=True)
class Allowed:
    """All limits of an exciting trajectory.

    Attributes:
        motion: of position [rad], velocity [rad/s] and acceleration [rad/s^2].
        torque: largest nominal torque [N m], shape (n,).
        singular: least singular value of the tool's Jacobian, as ``gapscope.arm.dynamics.kinematics`` has it; 0 if it
            may be any.
        clearance: least distance between bodies, and to the surface [m].
    """

    motion: Limits
    torque: np.ndarray
    singular: float
    clearance: float

    @property
    def jerk(self) -> np.ndarray:
        """Largest jerk [rad/s^3], shape (n,)."""
        return self.motion.acceleration / JERK_TIME


@dataclass(frozen=True)
class Margin:
    """How far a trajectory stays from one limit.

    Attributes:
        name: ``position``, ``velocity``, ``acceleration``, ``jerk``, ``torque``, ``singular value`` or ``distance``.
        unit: of limit and margin.
        limit: the limit; for ``position`` half the range about its middle; shape (n,) or ().
        margin: least distance from the limit over all samples, negative if it is broken; shape (n,) or ().
        at: time at which the margin is least [s].
    """

    name: str
    unit: str
    limit: np.ndarray
    margin: np.ndarray
    at: float

    @property
    def kept(self) -> bool:
        """Whether the limit holds at every sample, but for rounding."""
        return bool((self.margin >= -1e-9).all())

    @property
    def spares(self) -> bool:
        """Whether ``SPARE`` of the limit is left at every sample; of a distance that many metres."""
        share = 1.0 if self.name == "distance" else self.limit
        return bool((self.margin >= SPARE * share).all())


class Checker:
    """Checks motions against limits, sample by sample.

    Args:
        arm: the nominal arm.
        body: its rigid bodies.
        allowed: the limits.
        collision: its collision shapes; ``None`` if collisions are not checked.

    Attributes:
        allowed, collision: as given.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        allowed: Allowed,
        collision: CollisionModel | None,
    ) -> None:
        self.allowed, self.collision = allowed, collision
        self._arm, self._body, self._kinematics = arm, body, Kinematics(body)

    def torque(self, motion: Motion) -> np.ndarray:
        """Nominal torque with armature and data sheet friction [N m], shape (N, n)."""
        state = motion.q, motion.dq, motion.ddq
        return feedforward(self._arm, self._body, "nominal", *state)

    def singular_value(self, q: np.ndarray) -> np.ndarray:
        """Smallest singular value of the tool's Jacobian at q [rad], (N, n); shape (N,)."""
        return smallest_singular_value(self._kinematics, q)

    def distance(self, q: np.ndarray) -> np.ndarray:
        """Least distance between bodies at q [rad], (N, n), infinite if it is not checked [m]; shape (N,)."""
        return (
            np.full(len(q), np.inf)
            if self.collision is None
            else self.collision.distance(q)[0]
        )

    def margins(self, motion: Motion, torque: np.ndarray) -> tuple[Margin, ...]:
        """Margins of a motion of N samples with its nominal torque [N m], (N, n), to all limits that are checked."""
        allowed, t, sliding = self.allowed, motion.t, self._arm.sliding
        limits = allowed.motion
        middle, half = limits.upper + limits.lower, limits.upper - limits.lower
        wanted = [
            ("position", "rad", half / 2, motion.q - middle / 2),
            ("velocity", "rad/s", limits.velocity, motion.dq),
            ("acceleration", "rad/s^2", limits.acceleration, motion.ddq),
            ("torque", "N m", allowed.torque, torque),
        ]
        if len(t) > 1:
            # over each step, counted at its end
            change = np.diff(motion.ddq, axis=0) * motion.rate
            wanted.append(("jerk", "rad/s^3", allowed.jerk, change))
        out = [
            _margin(name, common_unit(unit, sliding), limit, limit - np.abs(values), t)
            for name, unit, limit, values in wanted
        ]
        least = [("singular value", "1", allowed.singular, self.singular_value)]
        if allowed.singular <= 0:
            least = []
        if self.collision is not None:
            least.append(("distance", "m", allowed.clearance, self.distance))
        for name, unit, bound, measure in least:
            slack = measure(motion.q) - bound
            out.append(_margin(name, unit, np.array(bound), slack, t))
        return tuple(out)

    def margin_when_slow(self, motion: Motion, speed: float) -> Margin:
        """Margin to the torque limits of the same path at ``speed`` times the speed [1]; gravity may need more then."""
        slow = Sampled(motion).slower(speed).motion
        slack = self.allowed.torque - np.abs(self.torque(slow))
        unit = common_unit("N m", self._arm.sliding)
        return _margin("torque when slow", unit, self.allowed.torque, slack, motion.t)

    def check_static(self, postures: np.ndarray) -> None:
        """Check that some posture can be held at all, given many within the position limits, shape (N, n).

        Raises:
            InputError: torque, singular poses or collisions forbid all of them; says which.
        """
        still = np.zeros_like(postures)
        torque = (
            np.abs(self._body.inverse_dynamics(postures, still, still))
            <= self.allowed.torque
        )
        if not torque.all(axis=1).any():
            joint = int(torque.mean(axis=0).argmin())
            force = joint_unit("N m", self._arm.sliding[joint])
            raise InputError(
                f"the limits allow no trajectory: gravity alone needs more than "
                f"{self.allowed.torque[joint]:.4g} {force} on joint {joint + 1} in nearly every posture",
                "raise the share of the torque limits that is used",
                where="torque",
            )
        values = self.singular_value(postures)
        if values.max() < self.allowed.singular:
            raise InputError(
                f"the limits allow no trajectory: no posture has a singular value of {self.allowed.singular:.4g}; the "
                f"largest met is {values.max():.3g}",
                "choose a smaller least singular value, or 0",
                where="singular",
            )
        distances = self.distance(postures)
        if distances.max() < self.allowed.clearance:
            raise InputError(
                f"the limits allow no trajectory: no posture keeps {self.allowed.clearance:.4g} m between bodies and "
                f"to the surface; the best keeps {distances.max():.3g} m",
                self.remedy("distance", postures),
                where="clearance",
            )

    def remedy(self, name: str, postures: np.ndarray) -> str:
        """What to change if candidates break one limit, named as in ``Margin``.

        Args:
            name: of the limit.
            postures: random ones within the position limits, shape (N, n), for what mostly comes too near.
        """
        if name != "distance" or self.collision is None:
            return REMEDIES.get(name, "slow the motion down")
        distance, nearest = self.collision.distance(postures)
        too_near = nearest[distance < self.allowed.clearance]
        to_surface = [SURFACE in self.collision.pairs[i] for i in too_near]
        mostly_surface = sum(to_surface) > len(to_surface) / 2
        return REMEDIES[SURFACE if mostly_surface else name]


def _margin(
    name: str, unit: str, limit: np.ndarray, slack: np.ndarray, t: np.ndarray
) -> Margin:
    relative = slack / limit if limit.ndim else slack
    worst = relative.min(axis=1) if limit.ndim else relative
    at = t[len(t) - len(slack) + int(worst.argmin())]
    return Margin(name, unit, limit, slack.min(axis=0), float(at))


def check_motion_limits(limits: Limits) -> None:
    """Check that the limits leave room to move.

    Raises:
        InputError: an empty range of positions, or a velocity or acceleration of zero.
    """
    rooms = {
        "position": limits.upper - limits.lower,
        "velocity": limits.velocity,
        "acceleration": limits.acceleration,
    }
    for name, room in rooms.items():
        if (room > 0).all() and np.isfinite(room).all():
            continue
        joint = int(np.argmin(np.where(np.isfinite(room), room, -1.0)))
        raise InputError(
            f"the limits allow no trajectory: joint {joint + 1} has no room of {name} ({room[joint]:.4g})",
            "give a positive limit, or a smaller distance from the position limits",
            where=name,
        )


# Families of trajectories, each q(t) = q0 + B(t) C: a basis over time, and coefficients C from free numbers.


RAMP = 1.0
"""Length of the flanks in which a motion rises from rest and falls back [s]."""


Basis = tuple[np.ndarray, np.ndarray, np.ndarray]
"""B(t) and its first two derivatives, each of shape (N, m); 1, 1/s, 1/s^2."""


@dataclass(frozen=True)
class Family(ABC):
    """Trajectories of n joints, at rest at both ends; C, (m, n), from ``size`` free numbers.

    Attributes:
        n_joints: n.
        duration: [s].
        order: number of harmonics, or half that of way points: m is twice as many.
        frequency: of the first harmonic [Hz].
    """

    n_joints: int
    duration: float
    order: int
    frequency: float

    @property
    @abstractmethod
    def highest_frequency(self) -> float:
        """Highest frequency of the motion [Hz]."""

    @abstractmethod
    def reference(
        self, centre: np.ndarray, coefficients: np.ndarray
    ) -> ReferenceMotion:
        """The trajectory q0 + B(t) C."""

    @property
    def size(self) -> int:
        """Count of free numbers, 2 order n."""
        return 2 * self.order * self.n_joints

    @property
    def weight(self) -> np.ndarray:
        """Size of each coefficient, (m, 1)."""
        return np.ones((2 * self.order, 1))

    def basis(self, t: np.ndarray) -> Basis:
        """The motions of single coefficients: those of as many joints, of which each has one of its own."""
        m = 2 * self.order
        series = replace(self, n_joints=m).reference(np.zeros(m), np.eye(m))
        return series.position(t), series.velocity(t), series.acceleration(t)

    def coefficients(self, free: np.ndarray) -> np.ndarray:
        """The free numbers in their sizes."""
        return self.weight * free.reshape(-1, self.n_joints)


class FourierFamily(Family):
    """``gapscope.arm.motions.trajectory.Fourier`` with free a_k and b_k, weighed by 1/k [swevers2007]."""

    @property
    def highest_frequency(self) -> float:
        """That of the last harmonic, or of the window if its flanks are steeper [Hz]."""
        return max(self.order * self.frequency, 0.5 / RAMP)

    @property
    def weight(self) -> np.ndarray:
        """1 / k of sines, then of cosines."""
        return 1.0 / np.tile(np.arange(1.0, self.order + 1), 2)[:, None]

    def reference(self, centre: np.ndarray, coefficients: np.ndarray) -> Fourier:
        """A Fourier series."""
        sine, cosine = np.split(coefficients, 2)
        return Fourier(centre, sine, cosine, self.frequency, self.duration, RAMP)


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
        return self.weight * np.concatenate([np.cos(phase), np.sin(phase)])


class QuinticFamily(Family):
    """``gapscope.arm.motions.trajectory.way_points``, free at equal times; it starts and ends at q0."""

    @property
    def highest_frequency(self) -> float:
        """Frequency of a motion that turns at every way point [Hz]."""
        return (2 * self.order + 1) / (2 * self.duration)

    def reference(self, centre: np.ndarray, coefficients: np.ndarray) -> Curve:
        """A spline."""
        times = np.linspace(0.0, self.duration, 2 * self.order + 2)
        return way_points(times, centre + np.pad(coefficients, ((1, 1), (0, 0))))


KINDS: dict[str, type[Family]] = {
    "fourier": FourierFamily,
    "quintic": QuinticFamily,
    "multisine": MultisineFamily,
}
"""Families by name."""


# From unbounded numbers to trajectories that keep their limits of position, velocity and acceleration.


STEP = 1.0 / WORKING_RATE
"""Time between the samples at which the limits are kept by construction [s]."""
RESERVE = 0.998
"""Share of the limits that is used, for what lies between those samples [1]."""
ROOM = 0.9
"""Share of the position range in which a centre may lie [1]."""


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
        count = int(np.ceil(family.duration / STEP)) + 1
        self._rows = np.stack(family.basis(np.linspace(0.0, family.duration, count)))

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """A random x, shape (d,)."""
        return rng.standard_normal(self.size)

    def reference(self, x: np.ndarray) -> ReferenceMotion:
        """The trajectory."""
        return self.family.reference(*self._decode(x))

    def motion(self, x: np.ndarray, t: np.ndarray, basis: Basis) -> Motion:
        """The motion at times t [s], shape (N,), at which ``basis`` was taken."""
        centre, coefficients = self._decode(x)
        q, dq, ddq = (rows @ coefficients for rows in basis)
        return Motion(t, centre + q, dq, ddq)

    def pullback(
        self,
        x: np.ndarray,
        basis: Basis,
        gradients: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> np.ndarray:
        """Gradient by x, shape (d,), from those by q, dq and ddq at the samples of a basis, each (N, n).

        By central differences of centre and coefficients.
        """
        by_centre = gradients[0].sum(axis=0)
        pairs = zip(basis, gradients, strict=True)
        by_coefficients = sum(rows.T @ gradient for rows, gradient in pairs)

        def along(x: np.ndarray) -> np.ndarray:
            centre, coefficients = self._decode(x)
            return by_centre * centre + (by_coefficients * coefficients).sum(axis=0)

        # a number moves its own joint alone: those of all joints are moved at once, by so little that no other limit
        # comes to be the one that is used most
        steps = np.repeat(ROUNDING * np.eye(self.size // self._n), self._n, axis=1)
        changes = [along(x + step) - along(x - step) for step in steps]
        return np.concatenate(changes) / (2 * ROUNDING)

    def _decode(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centre, (n,), and C, (m, n), in rad."""
        n, limits = self._n, self.limits
        lower, upper = limits.lower, limits.upper
        away = 2 * ndtr(x[:n]) - 1
        centre = (lower + upper) / 2 + ROOM * away * (upper - lower) / 2
        raw = self.family.coefficients(x[2 * n :])
        # position, velocity and acceleration, each at all times: (3, times, n)
        series = self._rows @ raw
        above = np.stack([upper - centre, limits.velocity, limits.acceleration])
        below = np.stack([centre - lower, limits.velocity, limits.acceleration])
        uses = np.maximum(series.max(axis=1) / above, -series.min(axis=1) / below)
        # a joint that does not move uses no limit
        gain = RESERVE / np.maximum(uses.max(axis=0), TINY)
        return centre, ndtr(x[n : 2 * n]) * gain * raw


# How well a trajectory excites: functions of the eigenvalues of the information matrix W^T W.


@dataclass(frozen=True)
class Criterion:
    """A sum w . log s over the singular values s of W S, ascending, to be made small.

    Attributes:
        weights: w, of their number b.
        unit: S gives every column of W the norm 1; else S divides by the RMS that the column has over random states,
            and by the square root of the count of samples, so that larger motions count more.
    """

    weights: Callable[[int], np.ndarray]
    unit: bool

    def evaluate(self, matrix: np.ndarray, reference: np.ndarray) -> float:
        """The value for W of shape (N, n, b), given the columns' RMS over random states, (b,)."""
        values, _, _, _ = self._spectrum(matrix, reference)
        return float(self.weights(len(values)) @ np.log(values)) / 2

    def gradient(self, matrix: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Derivative of the value by W, shape (N, n, b)."""
        values, vectors, scaled, scale = self._spectrum(matrix, reference)
        by_gram = (vectors * (self.weights(len(values)) / values)) @ vectors.T
        by_scaled = scaled @ by_gram
        if self.unit:
            # the norm of a column is divided out: no gradient along the column
            by_scaled -= scaled * (scaled * by_scaled).sum(axis=0)
        return (by_scaled / scale).reshape(matrix.shape)

    def _spectrum(
        self, matrix: np.ndarray, reference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Squares of s and their directions, and W S with the reciprocals of S."""
        flat = matrix.reshape(-1, matrix.shape[2])
        scale = np.sqrt(len(flat)) * reference
        if self.unit:
            scale = np.linalg.norm(flat, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        scaled = flat / scale
        values, vectors = np.linalg.eigh(scaled.T @ scaled)
        # below rounding of so many products no eigenvalue is known
        least = len(values) * FLOOR * values[-1] + TINY
        return np.maximum(values, least), vectors, scaled, scale


def _ends(least: float, largest: float) -> Callable[[int], np.ndarray]:
    """Weights of the least and the largest alone."""
    return lambda b: np.array([least, *np.zeros(b - 2), largest])


CRITERIA = {
    "condition": Criterion(_ends(-1.0, 1.0), unit=True),
    "d": Criterion(lambda b: np.full(b, -1.0 / b), unit=False),
    "e": Criterion(_ends(-1.0, 0.0), unit=False),
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


Separator = Callable[[Motion, np.ndarray], Separated]
"""Says how far explanations are apart on a motion of N samples with base regressor W, shape (N, n, b)."""


def separator_of(arm: NominalArm, body: RigidBody, names: Sequence[str]) -> Separator:
    """Separates effects of typical size: one signature for each joint of an effect on joints, a change of torque.

    With Z the signatures, each divided by its norm, and P the residual of a vector after least squares with the
    columns of W: the smallest singular value of P Z, and the angles between the P Z of two effects.

    Args:
        arm: the nominal arm.
        body: its rigid bodies.
        names: of effects in the catalogue, two or more; their sizes are drawn by ``gapscope.effects.severity``.

    Raises:
        InputError: fewer than two effects, the same one twice, or one that is not known.
    """
    if len(names) < 2 or len(set(names)) < len(names):
        raise InputError(
            "separation needs two or more different effects",
            "name them, with commas",
            where="effects",
        )
    scale, rng = ArmScale.of(arm), np.random.default_rng(0)
    applied: list[AppliedEffect] = []
    for name in names:
        check_known("effect", name, CATALOGUE, where="effects")
        joints: list[list[int] | None] = [None]
        if CATALOGUE[name].scope == "joint":
            joints = [[joint] for joint in range(1, arm.n_joints + 1)]
        applied += [draw(name, rng, scale, own) for own in joints]
    owner = np.array([effect.name for effect in applied])

    def separate(motion: Motion, matrix: np.ndarray) -> Separated:
        nominal = CorrectedArm(arm).predict(body, motion)
        arms = (CorrectedArm(arm, (effect,)) for effect in applied)
        changes = [(own.predict(body, motion) - nominal).ravel() for own in arms]
        signatures = np.column_stack(changes)
        norms = np.linalg.norm(signatures, axis=0)
        unit = signatures / np.where(norms > 0, norms, 1.0)
        columns = matrix.reshape(-1, matrix.shape[2])
        basis = orth(columns / (np.linalg.norm(columns, axis=0) + TINY), ROUNDING)
        # base parameters can absorb this much of an effect
        residual = unit - basis @ (basis.T @ unit)
        least = float(np.linalg.svd(residual, compute_uv=False)[-1])
        shown = np.linalg.norm(residual, axis=0) > ROUNDING
        angles = {}
        for pair in itertools.combinations(names, 2):
            parts = [residual[:, shown & (owner == name)] for name in pair]
            known = all(part.size for part in parts)
            angles[pair] = float(subspace_angles(*parts).min()) if known else 0.0
        return Separated(least, angles)

    return separate


# Model that scores a candidate: the base columns of its regressor and its torque, with exact derivatives.


DEGREE = 2
"""Degree of the columns as trigonometric polynomials of a position."""
SHIFTS = np.pi * (2 * np.arange(2 * DEGREE) + 1) / (2 * DEGREE)
"""Shifts from which the derivative of such a polynomial is exact [rad]."""
WEIGHTS = (-1.0) ** np.arange(2 * DEGREE) / (2 * DEGREE * (1 - np.cos(SHIFTS)))
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
        states = random_states(self._regressor, np.random.default_rng(0), STATES)
        matrix = self._regressor.matrix(states)
        base = base_parameters(matrix, self._regressor.names)
        self._kept, self.names = base.kept, base.kept_names
        # typical size of each column, whatever the motion
        self.reference = rms(matrix[:, :, base.kept], axis=(0, 1))

    def matrix(self, motion: Motion) -> np.ndarray:
        """W of a motion of N samples, shape (N, n, b)."""
        return self._regressor.matrix(motion)[:, :, self._kept]

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
        weight = full[:, :, :links] + by_nominal
        own = {name: np.zeros_like(motion.q) for name in JOINT_COLUMNS}
        for k, name in enumerate(self._regressor.quantities):
            first = links + k * n
            own[name] = np.einsum("ijj->ij", full[:, :, first : first + n])
        by_q = np.zeros_like(motion.q)
        by_dq = self.arm.viscous * by_torque + own["damping"]
        by_ddq = self.arm.armature * by_torque + own["rotor"]

        def contracted(*state: np.ndarray) -> np.ndarray:
            return np.einsum("tij,tij->t", weight, self.body.regressor(*state))

        q, dq, ddq = motion.q, motion.dq, motion.ddq
        here = contracted(q, dq, ddq)
        for j, unit in enumerate(np.eye(n)):
            # exact: trigonometric in q, quadratic in dq, linear in ddq
            shifted = [contracted(q + shift * unit, dq, ddq) for shift in SHIFTS]
            by_q[:, j] = WEIGHTS @ np.array(shifted)
            faster = contracted(q, dq + unit, ddq)
            by_dq[:, j] += (faster - contracted(q, dq - unit, ddq)) / 2
            by_ddq[:, j] += contracted(q, dq, ddq + unit) - here
        return by_q, by_dq, by_ddq


# A search for the best trajectory: what a candidate scores, what it costs, and the best ones that keep all limits.


SAMPLES = 200
"""Samples of a candidate during the search."""
PENALTY = 10.0
"""Score for a limit broken by all of it; smaller breaches count in proportion."""
PENALISED = ("torque", "singular value", "distance")
"""Limits that candidates may break; the others are kept by construction."""
TIGHTER = {"torque": 0.01, "singular": 0.1, "clearance": 0.01}
"""By how much the limits are tighter in the search: share, share, m."""
DISTANCE_SCALE = 0.1
"""Distance by which a clearance counts as broken by all of it [m]."""
TOLERATED = np.array(list(TIGHTER.values())) / [2, 2, 2 * DISTANCE_SCALE]
"""Breaches that still count as kept: half of what the limits are tightened by [1]. Up to there the penalty grows with
the square, so that a descent does not stall on the edge of what is allowed."""
SLOPE_STEP = np.sqrt(ROUNDING)
"""Step of the differences of singular value and distance [rad]."""


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


class Found(NamedTuple):
    """A candidate that keeps all limits at the samples of the search: numbers, (d,), criterion, and found when."""

    x: np.ndarray
    value: float
    evaluations: int


class TrajectorySearch:
    """Scores candidates and keeps the best ones.

    The score is the value of the criterion plus a penalty for torque, singular values and distances that break their
    limits, which are somewhat tighter here than the final ones, for what lies between the samples.

    Args:
        parametrisation: of the trajectories.
        model: of the arm.
        criterion: to be made small; with ``separator``, minus the log of the separation is made small instead.
        checker: of the limits, tightened.
        budget: when to end.
        separator: of the effects to separate, or ``None``.
        progress: called with the share of the budget spent [1] and the best value so far, or infinity.
        samples: of a candidate during the search.

    Attributes:
        found: candidates that keep all limits, each better than those before it.
        evaluations: spent.
        judged: number of candidates scored.
        feasible: number of candidates that kept all limits.
    """

    def __init__(
        self,
        parametrisation: Parametrisation,
        model: ExcitationModel,
        criterion: Criterion,
        checker: Checker,
        budget: Budget,
        separator: Separator | None = None,
        progress: Callable[[float, float], None] = lambda share, best: None,
        samples: int = SAMPLES,
    ) -> None:
        self.parametrisation, self.model, self.criterion = (
            parametrisation,
            model,
            criterion,
        )
        self.checker, self.budget, self.separator = checker, budget, separator
        self.progress = progress
        self.found: list[Found] = []
        self.evaluations = self.judged = self.feasible = 0
        family = parametrisation.family
        self._t = np.linspace(0.0, family.duration, samples)
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
        motion, matrix, breaches, _ = self._judged(x)
        return self._note(x, self._value(motion, matrix), breaches)

    def score_and_gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Score of a candidate and its gradient, shape (d,), with that by the motion exact but for distances."""
        self.evaluations += GRADIENT_COST
        motion, matrix, breaches, worst = self._judged(x)
        weight = PENALTY * np.minimum(breaches / TOLERATED, 1.0)
        by_torque = np.zeros_like(motion.q)
        joints, limit = np.arange(len(worst[0])), self.checker.allowed.torque
        peak = self.checker.torque(motion)[worst[0], joints]
        slope = np.where(np.abs(peak) > limit, np.sign(peak) / limit, 0.0)
        by_torque[worst[0], joints] = weight[0] * slope
        by_q, by_dq, by_ddq = self.model.pullback(
            motion, self.criterion.gradient(matrix, self.model.reference), by_torque
        )
        # of the other breaches the worst sample alone decides
        for k, row in enumerate(worst[1:]):
            if breaches[1 + k] > 0:
                shifts = SLOPE_STEP * np.eye(len(joints))
                up, down = (
                    self._slacks(motion.q[row] + s)[k] for s in (shifts, -shifts)
                )
                by_q[row] -= weight[1 + k] * (up - down) / (2 * SLOPE_STEP)
        gradient = self.parametrisation.pullback(x, self._basis, (by_q, by_dq, by_ddq))
        return self._note(x, self._value(motion, matrix), breaches), gradient

    def _judged(
        self, x: np.ndarray
    ) -> tuple[Motion, np.ndarray, np.ndarray, list[Any]]:
        """Motion, W, by how much each of ``PENALISED`` is broken, (3,), and in which samples it is used most."""
        motion = self.parametrisation.motion(x, self._t, self._basis)
        use = np.abs(self.checker.torque(motion)) / self.checker.allowed.torque
        # the largest use of each joint, and the least slack of all
        worst = [use.argmax(axis=0)]
        breaches = [np.maximum(use.max(axis=0) - 1, 0.0).sum()]
        for slack in self._slacks(motion.q):
            worst.append(slack.argmin())
            breaches.append(max(0.0, -slack.min()))
        return motion, self.model.matrix(motion), np.array(breaches), worst

    def _value(self, motion: Motion, matrix: np.ndarray) -> float:
        if self.separator is None:
            return self.criterion.evaluate(matrix, self.model.reference)
        separation = self.separator(motion, matrix).least
        return -float(np.log(max(separation, TINY)))

    def _note(self, x: np.ndarray, value: float, breach: np.ndarray) -> float:
        """The score; a candidate that keeps all limits is counted, and kept if it is the best so far."""
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

    def _slacks(self, q: np.ndarray) -> list[np.ndarray]:
        """Slack of singular value and distance at q, (N, n), each (N,), over what counts as broken by all of it."""
        allowed, checker = self.checker.allowed, self.checker
        singular: np.ndarray = np.full(len(q), np.inf)
        if allowed.singular > 0:
            singular = checker.singular_value(q) / allowed.singular - 1
        distance = (checker.distance(q) - allowed.clearance) / DISTANCE_SCALE
        return [singular, distance]


# Optimisers: each spends the budget of a search; what it found lies in ``search.found``.


Optimiser = Callable[[TrajectorySearch, np.random.Generator], None]


def random_search(search: TrajectorySearch, rng: np.random.Generator) -> None:
    """Independent draws of standard normal numbers, until the budget is spent."""
    while not search.spent:
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


# Gradient refinement: quasi-Newton steps.


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
                # a descent that has stalled is begun anew as long as that is worth it
                if before - done.fun < WORTH:
                    break
                x, before = done.x, float(done.fun)


# CMA-ES: evolution with an adapted covariance.


SPREAD = 0.3
"""Initial standard deviation, in that of random draws [1]."""


def evolution(search: TrajectorySearch, rng: np.random.Generator) -> None:
    """CMA-ES [hansen2016] by the package ``cma``, from the best of random candidates; started anew if it stalls."""
    import cma

    options = {
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
                scores.append(search.score(x))
                if search.spent:
                    return
            strategy.tell(candidates, scores)


# Particle swarm.


PARTICLES = 40
INERTIA, PULL = 0.7298, 1.4962
"""w and c of a swarm [1]."""


def swarm(search: TrajectorySearch, rng: np.random.Generator) -> None:
    """A particle swarm with the constriction of [clerc2002].

    v <- w v + c r1 (own best - x) + c r2 (best of all - x), x <- x + v, with r1, r2 uniform per coordinate.
    """
    x = random_starts(search, rng, PARTICLES)
    best, scores = x.copy(), np.full(PARTICLES, np.inf)
    v = 0.1 * rng.standard_normal(x.shape)
    while True:
        for i, particle in enumerate(x):
            score = search.score(particle)
            if score < scores[i]:
                best[i], scores[i] = particle, score
            if search.spent:
                return
        own, common = rng.uniform(0.0, PULL, (2, *x.shape))
        leader = best[scores.argmin()]
        v = INERTIA * v + own * (best - x) + common * (leader - x)
        # far out all candidates map to the edge of the limits
        x = np.clip(x + v, -LIKELY, LIKELY)
