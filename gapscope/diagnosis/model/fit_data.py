"""What a search is fitted to: segments with their rows, folds, errors of bodies and form."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from gapscope.arm.dynamics.inertial_scale import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.gap.noise_floor import NoiseFloor
from gapscope.diagnosis.model.normal_equations import data_sheet_prior, solve_positive
from gapscope.diagnosis.thresholds import (
    RICHEST_INERTIALS,
    RICHEST_ROUNDS,
    RICHEST_TERM,
    SHAPE_ERROR,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.deflection import Matrices
from gapscope.effects.effect import Transmission
from gapscope.model.body_point import Bodies
from gapscope.model.conditioning import Segment
from gapscope.model.decimated_segments import DecimatedSegments
from gapscope.model.effective_samples import group_slices, variance_inflation
from gapscope.model.prediction import Prediction
from gapscope.model.torque_gap import filtered_torque, torque_scale

# Half a recording as normal equations: all that a fit needs of it.


@dataclass(frozen=True)
class EquationRows:
    """Rows of X = [A, N, E, y, d] and what is known of them, M times m: joints, or both sides of each joint.

    Attributes:
        terms: A, derivatives by the terms' coordinates, (M, m, P).
        inertials: N, the nominal inertial regressor in units of its errors, (M, m, 10 n).
        others: E, derivatives by further nuisances: errors of the joint torque sensors in units of their spread,
            (M, m, 3 n), or what a reference leaves open of the joints' parameters and of their gains, (M, m, q + n).
        y: gap plus A theta_0 [N m], (M, m).
        rate: d, what a skew of sampling adds [N m/s], (M, m).
        sticking: RMS that dry friction may leave beyond the floor while the joint may stick [N m], (M, m).
        steady2: mean square of a healthy arm [N^2 m^2], (M, m).
        known: 1 for rows that were measured, 0 for others, (M, m).
    """

    terms: np.ndarray
    inertials: np.ndarray
    others: np.ndarray
    y: np.ndarray
    rate: np.ndarray
    sticking: np.ndarray
    steady2: np.ndarray
    known: np.ndarray

    @property
    def floor2(self) -> np.ndarray:
        """Mean square of a healthy arm on these rows [N^2 m^2], (m,)."""
        return np.asarray(self.steady2.mean(axis=0))

    @cached_property
    def weight(self) -> np.ndarray:
        """Weight of each row, less while a joint may stick, (M, m)."""
        return np.asarray(self.known / (1.0 + self.sticking**2 / self.floor2))

    def of_joint(self, j: int) -> np.ndarray:
        """Rows of X of one joint, by the square root of their weight, (M, P + K + 2)."""
        blocks = [self.terms[:, j], self.inertials[:, j], self.others[:, j]]
        x = np.hstack([*blocks, self.y[:, j, None], self.rate[:, j, None]])
        return np.asarray(x * np.sqrt(self.weight[:, j, None]))

    def halves(self) -> tuple[EquationRows, EquationRows]:
        """The first and the second half of the rows."""
        middle = len(self.y) // 2
        return self._cut(slice(middle)), self._cut(slice(middle, None))

    def _cut(self, rows: slice) -> EquationRows:
        return EquationRows(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True)
class Fold:
    """Normal equations of half a recording, m rows at a time: joints, or both sides of each joint.

    X = [A, N, E, y, d] has P columns for the parameters, K for the nominal inertials and the other nuisances, one for
    the gap, one for the skew.

    Attributes:
        equations: the rows, decimated to about twice the filter's cut-off.
        pieces: number of pieces of equal length into which they are cut, to be divided in two halves.
        sides: with a joint torque sensor the same of 2 n rows, the actuator side of each joint, then the link side.
    """

    equations: EquationRows
    pieces: int
    sides: Fold | None = None

    @property
    def scored(self) -> Fold:
        """What evidence is drawn from: both sides if they are known, the joint's torque otherwise."""
        return self.sides or self

    @cached_property
    def total(self) -> np.ndarray:
        """X^T W X of each joint, (m, P + K + 2, P + K + 2); W weighs rows down while a joint may stick."""
        joints = range(self.equations.y.shape[1])
        return np.array([_gram(self.equations.of_joint(j)) for j in joints])

    @cached_property
    def count(self) -> np.ndarray:
        """Weight of the rows, (m,)."""
        return np.asarray(self.equations.weight.sum(axis=0))

    @property
    def floor(self) -> np.ndarray:
        """RMS that noise, timing and the form of friction leave on this fold [N m], (m,)."""
        return np.sqrt(self.equations.floor2)

    def by_piece(self, places: np.ndarray) -> np.ndarray:
        """X^T W X of some columns of each piece and joint, (pieces, m, C, C)."""
        rows, joints = self.equations.y.shape
        edges = np.linspace(0, rows, self.pieces + 1).astype(int)
        out = np.zeros((self.pieces, joints, len(places), len(places)))
        for j in range(joints):
            x = self.equations.of_joint(j)[:, places]
            for piece, (start, end) in enumerate(itertools.pairwise(edges)):
                out[piece, j] = x[start:end].T @ x[start:end]
        return out


def _gram(x: np.ndarray) -> np.ndarray:
    """X^T X of X (M, D), (D, D); most columns do nothing to one joint, and are left out of the product."""
    out = np.zeros((x.shape[1], x.shape[1]))
    acting = np.flatnonzero(x.any(axis=0))
    within = x[:, acting]
    out[np.ix_(acting, acting)] = within.T @ within
    return out


# What compliance of a joint would do to the torque of the bodies, simulated once for all that is asked of it.


class CompliantBodies:
    """The bodies of an arm, and what compliance of one joint would do to their torque.

    A search asks for the same resonances and widths of free play again and again; each is simulated once.

    Args:
        data: the segments.
        body: dynamics of the nominal arm.
        arm: the arm; of its effects only those on the bodies count.

    Attributes:
        torque: torque that the bodies need on each segment [N m], (N, n).
        mass: inertia that each joint moves, mean over the recordings [kg m^2 or kg], (n,).
    """

    def __init__(
        self, data: DecimatedSegments, body: RigidBody, arm: CorrectedArm
    ) -> None:
        self._data, self._segments = data, data.segments
        self._unit = np.eye(arm.arm.n_joints)
        laden = [s.bodies(body) for s in self._segments]
        pairs = list(zip(laden, self._segments, strict=True))
        self.torque = [arm.rigid_torque(one, s.motion) for one, s in pairs]
        self._matrices = [
            arm.body(one).sensitivities(s.motion.q, s.motion.dq, s.motion.ddq)
            for one, s in pairs
        ]
        inertias = [
            np.diagonal(mass, axis1=1, axis2=2).mean(axis=0)
            for _, _, mass in self._matrices
        ]
        self.mass = np.mean(inertias, axis=0)
        self._known: dict[tuple[str | float, ...], np.ndarray] = {}

    def added(self, effect: Transmission, j: int, x: np.ndarray) -> np.ndarray:
        """What a transmission of one joint, from 0, adds to the torque on the rows of all segments [N m], (M, n).

        Args:
            effect: elasticity, free play or the like.
            j: the joint.
            x: linear coordinates of the effect, (linear,).
        """
        key = (effect.name, j, *x.tolist())
        if key not in self._known:
            values = effect.values_at(x[:, None]).values()
            own = [value * self._unit[j] for value in values]
            added = [
                effect.behind(matrices, rate, torque, *own) - torque
                for matrices, rate, torque in self._by_segment()
            ]
            self._known[key] = self._data.rows(added).astype(np.float32)
        return self._known[key]

    def _by_segment(self) -> Iterator[tuple[Matrices, float, np.ndarray]]:
        rates = [s.motion.rate for s in self._segments]
        return zip(self._matrices, rates, self.torque, strict=True)


# How the inertial parameters of a nominal arm are wrong together: each body's mass, centre and shape.
#
# A body whose mass is wrong by a share u has first and second moments that are wrong by the same share, as a part that
# was left out or a wrong density does. Its centre is off by a distance, and its moments of inertia about the centre
# differ from those of the mass by less. Errors of the ten parameters of one body are therefore far from independent.


MOMENTS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
"""Places in the matrix of inertia of the last six parameters of a body."""


def inertial_errors(parameters: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Root R of the covariance R R^T of the inertial errors, (10 n, 10 n), if masses are off by their own size.

    Per body, with mass m, centre c, D = max(|c|, 5 cm) (that of the units) and inertia I_c about the centre:
    u (m, h, I); a shift of the centre by D in all, D / sqrt 3 along each axis; and each moment of I_c by
    ``SHAPE_ERROR`` tr(I_c) / 2, products by half of that. A body without mass has no error.

    Args:
        parameters: inertial parameters about the joints' frames, (10 n,) [kg, kg m, kg m^2].
        units: size of each, in which R counts, (10 n,); see ``gapscope.arm.dynamics.inertial_scale``.
    """
    bodies = parameters.reshape(-1, 10)
    sizes = units.reshape(-1, 10)
    root = np.zeros((len(bodies), 10, len(bodies), 10))
    for k, (body, size) in enumerate(zip(bodies, sizes, strict=True)):
        if body[0] > 0:
            own = _of_body(body, size[1] / body[0])
            # a point on the joint's axis has no moments of inertia, and no error of them
            known = size > 0
            root[k, known, k] = own[known] / size[known, None]
    return root.reshape(len(parameters), len(parameters))


def _of_body(body: np.ndarray, distance: float) -> np.ndarray:
    """Columns of one body's errors: its mass, three of its centre, six of its shape, (10, 10)."""
    mass, centre = body[0], body[1:4] / body[0]
    about_joint = np.zeros((3, 3))
    for value, (i, j) in zip(body[4:], MOMENTS, strict=True):
        about_joint[i, j] = about_joint[j, i] = value
    about_centre = about_joint - mass * _spread(centre, centre)
    out = np.zeros((10, 10))
    out[:, 0] = body
    for axis, shift in enumerate(distance / np.sqrt(3.0) * np.eye(3)):
        # m (c^T c E - c c^T) changes with the centre by twice its symmetric part
        change = 2.0 * mass * _spread(centre, shift)
        out[1:4, 1 + axis] = mass * shift
        out[4:, 1 + axis] = [change[i, j] for i, j in MOMENTS]
    shape = SHAPE_ERROR * max(0.5 * float(np.trace(about_centre)), 0.0)
    for place, (i, j) in enumerate(MOMENTS):
        out[4 + place, 4 + place] = shape if i == j else 0.5 * shape
    return out


def _spread(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a^T b E - (a b^T + b a^T) / 2, the second moments of unit mass at a if b = a, (3, 3)."""
    return np.asarray(a @ b * np.eye(3) - 0.5 * (np.outer(a, b) + np.outer(b, a)))


# Discrepancy: how far a healthy arm differs from every model of it, learnt from the data itself.
#
# All terms, the nominal inertials and the sensors' errors are fitted at once, under wide priors, to all folds but one,
# and predict that one. What they leave is smooth and repeatable on a real arm, 4 to 23 % of the torque's deviation, and
# about 1 % on a simulated one. No single effect can be expected to predict better than this, and no residual of this
# size speaks for an effect; its autocorrelation says how many independent samples there are.
#
# A model of few terms may predict a joint better than one of all: then its residual counts.


@dataclass(frozen=True)
class Discrepancy:
    """What a healthy arm leaves of m rows: joints, or with joint torque sensors both sides of each.

    Attributes:
        mean_square: of the residual on a typical held-out fold, or on the reference [N^2 m^2], (m,).
        inflation: rows that count as one independent sample [1], (m,).
    """

    mean_square: np.ndarray
    inflation: np.ndarray


def discrepancy(
    folds: Sequence[Fold],
    halves: Sequence[EquationRows],
    deviation: np.ndarray,
    theta: np.ndarray,
) -> Discrepancy:
    """Discrepancy of the folds.

    Args:
        folds: normal equations of each half.
        halves: the rows that they were made of.
        deviation: of the torque, (m,) [N m].
        theta: parameters of the model so far, (P,).
    """
    gram = np.array([fold.total[:, :-1, :-1] for fold in folds])
    count = np.array([fold.count for fold in folds])
    precision = _precision(gram, count, deviation, halves[0])
    values = _held_out_values(gram, count, precision)

    so_far = np.zeros_like(values[0])
    so_far[: len(theta)] = theta
    residuals = [
        _weighted_residuals(halves, values),
        _weighted_residuals(halves, [so_far] * len(halves)),
    ]
    group = np.repeat(np.arange(len(halves)), [len(half.y) for half in halves])
    squares = np.array([_typical_square(r, group, count) for r in residuals])

    better = np.argmin(squares, axis=0)
    residual = np.where(better == 0, residuals[0], residuals[1])
    return Discrepancy(squares.min(axis=0), variance_inflation(residual, group))


def _typical_square(
    residual: np.ndarray, group: np.ndarray, count: np.ndarray
) -> np.ndarray:
    """Median over the folds of the mean square, (m,): what happens once, such as a contact, is no discrepancy."""
    squares = [(residual[rows] ** 2).sum(axis=0) for rows in group_slices(group)]
    return np.asarray(np.median(squares / np.maximum(count, 1e-9), axis=0))


def _precision(
    gram: np.ndarray,
    count: np.ndarray,
    deviation: np.ndarray,
    rows: EquationRows,
) -> np.ndarray:
    """Prior precision of all columns, (P + K,).

    A term makes ``RICHEST_TERM`` times the torque's deviation on some joint; inertials are ``RICHEST_INERTIALS`` off,
    sensors as their data sheets say.
    """
    squares = (
        np.einsum("fjaa->ja", gram)[:, :-1]
        / np.maximum(count.sum(axis=0), 1e-9)[:, None]
    )
    size = (np.sqrt(squares) / deviation[:, None]).max(axis=0)
    terms, inertials = rows.terms.shape[2], rows.inertials.shape[2]
    spread = RICHEST_TERM / np.maximum(size, 1e-9)
    spread[terms : terms + inertials] = RICHEST_INERTIALS
    others = slice(terms + inertials, None)
    spread[others] = np.minimum(spread[others], 1.0)
    # columns that do nothing stay at zero
    return np.asarray(np.where(size > 1e-9, spread**-2.0, 1e18))


def _held_out_values(
    gram: np.ndarray, count: np.ndarray, precision: np.ndarray
) -> list[np.ndarray]:
    """Values of all columns fitted to all folds but each, (P + K,); joints are weighed by what is left on that fold."""
    total = np.maximum(count.sum(axis=0), 1e-9)
    mean_square = gram[..., -1, -1].sum(axis=0) / total
    for _ in range(RICHEST_ROUNDS):
        weight = 1.0 / np.maximum(mean_square, 1e-12)
        by_fold = np.array([np.tensordot(weight, own, axes=1) for own in gram])
        normal = by_fold.sum(axis=0)
        values = [_solved(normal - own, precision) for own in by_fold]
        z = [np.append(-value, 1.0) for value in values]
        squares = [own @ one @ one for own, one in zip(gram, z, strict=True)]
        mean_square = np.maximum(np.sum(squares, axis=0), 0.0) / total
    return values


def _solved(normal: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Least squares under a prior from X^T W X of X = [columns, y]."""
    matrix = normal[:-1, :-1] + np.diag(precision)
    return solve_positive(matrix, normal[:-1, -1:])[:, 0]


def _weighted_residuals(
    halves: Sequence[EquationRows], values: Sequence[np.ndarray]
) -> np.ndarray:
    """Residual of each half under its values, weighed as in its normal equations [N m], (M, m)."""
    residuals = []
    for half, value in zip(halves, values, strict=True):
        terms, inertials = half.terms.shape[2], half.inertials.shape[2]
        parts = np.split(value, [terms, terms + inertials])
        residual = (
            half.y
            - half.terms @ parts[0]
            - half.inertials @ parts[1]
            - half.others @ parts[2]
        )
        residuals.append(residual * np.sqrt(half.weight))
    return np.vstack(residuals)


# Rows of one segment in the linearised equations.


@dataclass(frozen=True)
class SegmentRows:
    """Rows of one segment, M of them, of n joints, decimated to about twice the filter's cut-off.

    Attributes:
        gap: recorded less predicted torque [N m], (M, n).
        columns: A, the derivatives of the predicted torque by the P coordinates, (M, n, P).
        rate: d, the rate of the predicted torque [N m/s], (M, n).
        floor: what a healthy arm leaves on these rows.
        at: what the arm with the effects of theta_0 predicts, at every sample.
        known: 1 for rows whose torque was measured, next to nothing for others, (M, n).
    """

    gap: np.ndarray
    columns: np.ndarray
    rate: np.ndarray
    floor: NoiseFloor
    at: Prediction
    known: np.ndarray

    @property
    def trust(self) -> np.ndarray:
        """Square root of the weight of each row, (M, n): less while a joint may stick, none if it was not measured."""
        sticking = (self.floor.sticking / self.floor.steady) ** 2
        return np.asarray(np.sqrt(self.known / (1.0 + sticking)))


# The data of a diagnosis: segments by fold, with what does not depend on the parameters.


class FitData(DecimatedSegments):
    """Folds of segments with what does not depend on the parameters.

    Args:
        arm, body: the nominal arm and its dynamics.
        folds: segments per fold.
        cutoff: cut-off of the fit's filter, on both sides [Hz].

    Attributes:
        torque_deviation: normalisation of the torque gap over all folds [N m], (n,).
        sensed: whether some segment carries a joint torque sensor.
        units: what a relative error of each inertial parameter would change it by, (10 n,).
        nuisance: the filtered inertial regressor of each segment, per unit.
        sensor_errors: number of the nuisances of joint torque sensors, beside those of the inertials.
        prior: of the nuisances.
        bodies: what the columns need of each segment's bodies.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        folds: list[list[Segment]],
        cutoff: float,
    ) -> None:
        super().__init__([s for fold in folds for s in fold], cutoff)
        self.arm, self.body, self.folds = arm, body, folds
        self.sensed = any(s.torque_sensor is not None for s in self.segments)
        self.torque_deviation = torque_scale(
            np.vstack([filtered_torque(s) for s in self.segments])
        )
        self.units = inertial_scale(body)
        errors = inertial_errors(body.inertial_parameters(), self.units)
        self.sensor_errors = 3 * arm.n_joints if self.sensed else 0
        self.prior = data_sheet_prior(errors, self.sensor_errors)
        self.nuisance, self.bodies = [], []
        for s in self.segments:
            regressor = body.regressor(s.motion.q, s.motion.dq, s.motion.ddq)
            self.bodies.append(Bodies(s.bodies(body), s.motion, regressor))
            self.nuisance.append(self.thin(regressor * self.units, s))

    def on(self, arm: NominalArm) -> FitData:
        """The same data of an arm of the same bodies."""
        other = copy(self)
        other.arm = arm
        return other
