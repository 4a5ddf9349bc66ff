"""Base parameters by QR: ranks, which bodies they hold, what is essential and what can be recovered."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.linalg import get_lapack_funcs, qr, solve_triangular

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import urdf_limits
from gapscope.ident.model.regressor import Regressor

# Numerical rank of a regressor: unit columns, and the gap in a spectrum.


EMPTY = 1e-12
"""A column whose norm is below this part of the largest has no content."""
DEPENDENT = 2e-5
"""Largest value of a spectrum, relative to a unit column, that can count as nil. Angles of a URDF rounded to four
decimals make directions of up to 5e-6, which no recording resolves."""
CLEAR_GAP = 1e3
"""Ratio of two neighbours in a spectrum from which the rank is certain."""
FLOOR = 1e-16
"""Values of a spectrum below this are rounding."""


def unit_triangle(Y: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Triangular factor of Y with its columns scaled to unit norm.

    Args:
        Y: stacked regressor, shape (M, p) or (N, n, p); or its triangular factor, shape (p, p).
        names: of the columns, shape (p,).

    Returns:
        R of the scaled columns, zero in columns without content, shape (p, p); and the norms, 1 of those, shape (p,).

    Raises:
        InputError: values that are not finite, fewer rows than columns, or a regressor of zeros.
    """
    rows = np.asarray(Y, dtype=float).reshape(-1, len(names))
    if len(rows) < len(names):
        raise InputError(
            f"{len(rows)} rows do not determine {len(names)} parameters",
            "record more samples",
            where="regressor",
        )
    if not np.isfinite(rows).all():
        raise InputError(
            "the regressor has values that are not finite",
            "check the motion for missing values",
            where="regressor",
        )
    triangle = (
        rows
        if len(rows) == len(names)
        else qr(rows, mode="r", check_finite=False)[0][: len(names)]
    )
    norms = np.linalg.norm(triangle, axis=0)
    full = norms > EMPTY * norms.max()
    if not full.any():
        raise InputError(
            "the regressor is zero: nothing moves and nothing weighs", "record a motion"
        )
    norms = np.where(full, norms, 1.0)
    return np.where(full, triangle, 0.0) / norms, norms


def orthonormal_columns(x: np.ndarray, tolerance: float) -> np.ndarray:
    """Orthonormal basis of the columns of x, (M, K), scaled to one each; shape (M, r).

    Directions smaller than ``tolerance`` times the largest are left out. So are columns without content: what a body
    leaves on a joint on which it does not act is rounding, and scaled to one it would be a direction of its own.
    """
    norms = np.linalg.norm(x, axis=0)
    full = norms > EMPTY * norms.max()
    u, size, _ = np.linalg.svd(x[:, full] / norms[full], full_matrices=False)
    return np.asarray(u[:, size > tolerance * size[0]])


def rank_by_gap(spectrum: np.ndarray, tolerance: float = DEPENDENT) -> int:
    """Number of values that are not nil, of a falling spectrum that starts near 1.

    It ends at the first drop by ``CLEAR_GAP`` to a value below ``tolerance``, or, if there is none so clear, at the
    widest drop to a value below it. All count if no value is so small.
    """
    small = np.flatnonzero(spectrum <= tolerance)
    if not len(small):
        return len(spectrum)
    # below the floor a ratio is one of rounding errors
    values = np.maximum(spectrum, FLOOR)
    drops = values[small - 1] / values[small]
    clear = np.flatnonzero(drops >= CLEAR_GAP)
    end = clear[0] if len(clear) else np.argmax(drops)
    return int(small[end])


def gap_at(spectrum: np.ndarray, rank: int) -> float:
    """Ratio of the last value that counts to the first that does not; infinite if all count."""
    return (
        float("inf")
        if len(spectrum) <= rank
        else float(spectrum[rank - 1] / max(spectrum[rank], FLOOR))
    )


# Streaming least squares: the triangular factor of a regressor of any length, in memory that does not grow.


ROWS = 2000
"""Rows that are factored at a time."""
_SINGULAR = 1e-10
_GEQRF, _GEQRF_LWORK = get_lapack_funcs(("geqrf", "geqrf_lwork"), dtype=np.float64)


class TriangularFactor:
    """R and Q^T tau of a regressor W and a torque tau that arrive in chunks of rows.

    [W, tau] = Q [[R, z], [0, rho]] with orthogonal Q, which is not kept: each chunk is stacked below the triangle of
    those before it and factored again (TSQR). R^T R = W^T W, but without the squared condition number of that product.
    p columns.

    Args:
        columns: number p of columns of W.

    Attributes:
        rows: number M of rows that were added.

    Source: demmel2012.
    """

    def __init__(self, columns: int) -> None:
        self.rows = 0
        self._columns = columns
        self._stack = np.zeros((columns + 1 + ROWS, columns + 1), order="F")
        self._work = int(_GEQRF_LWORK(*self._stack.shape)[0])

    @property
    def columns(self) -> int:
        """Number p of columns."""
        return self._columns

    @property
    def triangle(self) -> np.ndarray:
        """R, shape (p, p), upper triangular; its diagonal may have either sign."""
        return self._stack[: self._columns, : self._columns].copy()

    @property
    def projected(self) -> np.ndarray:
        """The leading p entries z of Q^T tau, shape (p,)."""
        return self._stack[: self._columns, self._columns].copy()

    @property
    def residual_norm(self) -> float:
        """Norm rho of tau - W beta for the best beta [N m]."""
        rest = self._stack[self._columns, self._columns]
        if self._full_rank:
            return float(abs(rest))
        # rows of R without content have taken up some of tau
        unexplained = self.projected - self.triangle @ self.solve()
        return float(np.hypot(rest, np.linalg.norm(unexplained)))

    def add(self, W: np.ndarray, tau: np.ndarray | None = None) -> None:
        """Add rows.

        Args:
            W: shape (M, p) or (N, n, p).
            tau: [N m], shape (M,) or (N, n); zeros if ``None``.

        Raises:
            InputError: values that are not finite, or shapes that do not match.
        """
        W = np.asarray(W)
        self._check(
            W.shape[-1] == self._columns,
            f"expected {self._columns} columns, got {W.shape[-1]}",
        )
        W = W.reshape(-1, self._columns)
        tau = np.zeros(len(W)) if tau is None else np.asarray(tau).ravel()
        self._check(
            len(tau) == len(W),
            f"{len(W)} rows of the regressor, but {len(tau)} torques",
        )
        # rows that turn out not to be finite must leave the factor as it was
        before = self._stack[: self._columns + 1].copy()
        # chunks of fixed size bound the memory, whatever the length of the recording
        for start in range(0, len(W), ROWS):
            part = slice(start, start + ROWS)
            self._absorb(W[part], tau[part])
        if not np.isfinite(self._stack[: self._columns + 1]).all():
            self._stack[: self._columns + 1] = before
            self._check(False, "values that are not finite")
        self.rows += len(W)

    def merge(
        self, other: TriangularFactor, columns: Sequence[int] | np.ndarray | None = None
    ) -> None:
        """Add all rows of another factor.

        Args:
            other: the other factor, such as one of another recording, joint or process.
            columns: which columns of this factor are the other's, if it has fewer; shape (other.columns,).
        """
        places = np.arange(self._columns) if columns is None else np.asarray(columns)
        self._check(
            len(places) == other.columns,
            f"expected {len(places)} columns, got {other.columns}",
        )
        top = other.columns + 1
        # the rows of the other triangle replace all its rows
        W = np.zeros((top, self._columns))
        W[:, places] = other._stack[:top, : other.columns]
        self._absorb(W, other._stack[:top, other.columns])
        self.rows += other.rows

    def scaled(self, factor: float) -> TriangularFactor:
        """The factor of (factor W, factor tau), for weights."""
        out = TriangularFactor(self._columns)
        out._stack[:] = factor * self._stack
        out.rows = self.rows
        return out

    def select(self, columns: Sequence[int] | np.ndarray) -> TriangularFactor:
        """The factor of some columns of W, in the order given, such as those of base parameters."""
        out = TriangularFactor(len(columns))
        out._absorb(
            self._stack[: self._columns + 1, columns],
            self._stack[: self._columns + 1, self._columns],
        )
        out.rows = self.rows
        return out

    def solve(self) -> np.ndarray:
        """Beta that minimises the norm of tau - W beta, shape (p,); the shortest if several do."""
        if self._full_rank:
            return solve_triangular(self.triangle, self.projected)
        return np.linalg.lstsq(self.triangle, self.projected, rcond=_SINGULAR)[0]

    def covariance(self) -> np.ndarray:
        """Covariance of ``solve`` for white noise, rho^2 / (M - p) (R^T R)^-1, shape (p, p); W of full rank."""
        self._check(
            self.rows > self._columns,
            f"{self.rows} rows do not determine {self._columns} parameters",
        )
        variance = self.residual_norm**2 / (self.rows - self._columns)
        inverse = solve_triangular(self.triangle, np.eye(self._columns))
        return variance * inverse @ inverse.T

    @property
    def _full_rank(self) -> bool:
        size = np.abs(np.diag(self._stack[: self._columns, : self._columns]))
        return bool(size.min() > _SINGULAR * size.max())

    def _absorb(self, W: np.ndarray, tau: np.ndarray) -> None:
        """Factor the triangle so far and some rows below it into a new triangle."""
        top = self._columns + 1
        stack = self._stack[: top + len(W)]
        # a part of the array is not contiguous in columns, which LAPACK needs
        if len(W) < ROWS:
            stack = np.asfortranarray(stack)
        stack[top:, : self._columns] = W
        stack[top:, self._columns] = tau
        factored = _GEQRF(stack, lwork=self._work, overwrite_a=True)[0]
        self._stack[:top] = np.triu(factored[:top])

    @staticmethod
    def _check(fine: bool, problem: str) -> None:
        if not fine:
            raise InputError(
                problem, "check the regressor and the torque", where="streamed rows"
            )


class JointFactors:
    """Triangular factors of each joint's rows, of which each involves only some columns; n joints, p columns.

    Rows of a joint do not depend on the links before it and of other joints' friction, which makes their factors small.
    Stacked with weights they give weighted least squares with one noise level per joint.

    Args:
        support: which columns each joint's rows involve, boolean, shape (n, p), as of ``Regressor.support``.
    """

    def __init__(self, support: np.ndarray) -> None:
        self.support = np.asarray(support, dtype=bool)
        self.places = [np.flatnonzero(row) for row in self.support]
        self.joints = [TriangularFactor(len(places)) for places in self.places]

    def add(self, Y: np.ndarray, tau: np.ndarray | None = None) -> None:
        """Add samples: Y of shape (N, n, p) and tau [N m] of shape (N, n)."""
        if tau is None:
            tau = np.zeros(Y.shape[:2])
        for i, factor in enumerate(self.joints):
            places = self.places[i]
            for start in range(0, len(Y), ROWS):
                rows = slice(start, start + ROWS)
                factor.add(Y[rows, i][:, places], tau[rows, i])

    def merge(self, other: JointFactors) -> None:
        """Add all samples of other factors with the same columns."""
        for mine, others in zip(self.joints, other.joints, strict=True):
            mine.merge(others)

    def stacked(
        self, weights: Sequence[float] | np.ndarray | None = None
    ) -> TriangularFactor:
        """The factor of all joints' rows, those of joint i times ``weights[i]`` [1/(N m) or 1], shape (n,)."""
        out = TriangularFactor(self.support.shape[1])
        for i, (factor, places) in enumerate(
            zip(self.joints, self.places, strict=True)
        ):
            out.merge(
                factor if weights is None else factor.scaled(float(weights[i])), places
            )
        return out


def factored(
    regressor: Regressor, motion: Motion, torque: np.ndarray | None = None
) -> JointFactors:
    """Factors of the regressor of a motion, which itself is never held: ``ROWS`` samples of it at a time.

    Args:
        regressor: of the arm.
        motion: N samples.
        torque: [N m], shape (N, n); zeros if ``None``, as base parameters do not need it.
    """
    factors, count = JointFactors(regressor.support), len(motion.t)
    # one array for all chunks
    room = np.empty((min(ROWS, count), *regressor.support.shape))
    for start in range(0, count, ROWS):
        rows = slice(start, min(start + ROWS, count))
        chunk = Motion(
            motion.t[rows], motion.q[rows], motion.dq[rows], motion.ddq[rows]
        )
        Y = regressor.matrix(chunk, room[: rows.stop - start])
        factors.add(Y, None if torque is None else torque[rows])
    return factors


# Base parameters: the minimal combinations of pi that the torque depends on.


ACCELERATION = 5.0
"""Typical acceleration of random states [rad/s^2]."""
_CLEAN = 1e-9
_SPAN = 1e-4

Preference = Literal["link", "kind"]


@dataclass(frozen=True)
class BaseParameters:
    """Base parameters beta = C pi with Y pi = Y[:, kept] beta for every motion; b of p parameters.

    Attributes:
        names: names of pi, shape (p,).
        kept: places in pi of the parameters that represent the combinations, shape (b,), ascending.
        combination: C, shape (b, p); its columns at ``kept`` are the identity.
        pivots: magnitude of the diagonal of R of the pivoted QR of the unit columns, shape (p,), falling: the spectrum
            whose gap decides b.
    """

    names: tuple[str, ...]
    kept: np.ndarray
    combination: np.ndarray
    pivots: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return len(self.kept)

    @property
    def gap(self) -> float:
        """Smallest kept over largest dropped pivot; infinite if none was dropped or pivots are not known."""
        return gap_at(self.pivots, self.count)

    @property
    def dropped(self) -> np.ndarray:
        """Places in pi of the others, folded into the kept ones or without effect, shape (p - b,), ascending."""
        return np.setdiff1d(np.arange(len(self.names)), self.kept)

    @property
    def null_space(self) -> np.ndarray:
        """N, shape (p, p - b): pi + N z gives the same torque as pi, for every z; ``dropped`` rows are the identity.

        So every pi is ``spread(of(pi)) + null_space @ pi[dropped]``.
        """
        out = np.zeros((len(self.names), len(self.names) - self.count))
        out[self.dropped] = np.eye(out.shape[1])
        out[self.kept] = -self.combination[:, self.dropped]
        return out

    def of(self, parameters: np.ndarray) -> np.ndarray:
        """Beta = C pi, shape (b,)."""
        return self.combination @ parameters

    def spread(self, beta: np.ndarray) -> np.ndarray:
        """The pi, zero outside ``kept``, that gives the same torque as beta; shape (p,)."""
        out = np.zeros(len(self.names))
        out[self.kept] = beta
        return out

    def nearest(self, beta: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """The pi nearest to a prior, shape (p,), that gives the same torque as beta (least squares)."""
        return prior + np.linalg.pinv(self.combination) @ (beta - self.of(prior))

    def expressions(self, tolerance: float = 1e-6) -> tuple[str, ...]:
        """Each base parameter as a readable combination, ``mx2 + 0.5 m3``, its kept one first; shape (b,)."""
        rows = zip(self.kept.tolist(), self.combination, strict=True)
        return tuple(
            _expression(kept, row, self.names, tolerance) for kept, row in rows
        )


def base_parameters(
    Y: np.ndarray,
    names: Sequence[str],
    tolerance: float = DEPENDENT,
    preference: Preference = "link",
) -> BaseParameters:
    """Base parameters by QR of a regressor of enough random samples.

    The number b comes from the QR with column pivoting of the columns scaled to unit norm: it ends at the gap in the
    spectrum of R's diagonal, see ``rank_by_gap``. Which parameters represent the combinations is a choice. Columns are
    taken in an order of preference, and one that depends on those before it is folded into them:

    - ``link``: from the base to the tip, within a link mass, first moment, inertia; then effects. What a link carries
      is folded into the link that carries it, so that factors are levers and their squares (``mx2 + 0.5 m3``), as in
      the classical regrouping rules of serial arms, and rotor inertia into the inertia of the link.
    - ``kind``: all masses first, then all first moments, inertias, effects, each from the base to the tip. If a
      mass can represent a combination, it does; factors are then inverse levers too, and the kept columns worse
      conditioned.

    If that leaves another number than b, because data excite the arm poorly, the columns that the pivoting chose are
    kept.

    Args:
        Y: stacked regressor, shape (M, p) or (N, n, p); or its triangular factor, shape (p, p).
        names: of the columns.
        tolerance: largest pivot of a dependent unit column.
        preference: which parameters represent the combinations.

    Raises:
        InputError: no such preference, values that are not finite, fewer rows than columns, or a regressor of zeros.

    Source: gautier1991, gautier1990.
    """
    if preference not in ("link", "kind"):
        raise InputError(
            f"{preference!r} is no preference",
            "choose link or kind",
            where="preference",
        )
    names = tuple(names)
    scaled, norms = unit_triangle(Y, names)
    # how many: by the pivots, which reveal the rank
    pivoted, places = qr(scaled, mode="r", pivoting=True, check_finite=False)
    pivots = np.abs(np.diag(pivoted))
    count = rank_by_gap(pivots, tolerance)
    # which: in the order of preference, unless that finds another number
    border = _SPAN * pivots[count - 1]
    kept = _independent(scaled, _order(names, preference), border)
    if len(kept) != count:
        kept = places[:count]
    kept = np.sort(kept)
    # every column as a combination of those kept
    weights = np.linalg.lstsq(scaled[:, kept], scaled, rcond=None)[0]
    # rounding would show as combinations that are none
    weights[np.abs(weights) < _CLEAN] = 0.0
    weights *= norms / norms[kept, None]
    weights[:, kept] = np.eye(count)
    return BaseParameters(
        names=names,
        kept=kept,
        combination=weights,
        pivots=pivots,
    )


def structural_base(
    regressor: Regressor,
    rng: np.random.Generator,
    samples: int = 300,
    preference: Preference = "link",
) -> BaseParameters:
    """Base parameters of an arm, whatever its recordings excite: of random states within the arm's limits.

    Args:
        regressor: of the arm, with the columns wanted.
        rng: source of the states.
        samples: number N of states; at least p / n.
        preference: which parameters represent the combinations, see ``base_parameters``.
    """
    return base_parameters(
        regressor.matrix(random_states(regressor, rng, samples)),
        regressor.names,
        DEPENDENT,
        preference,
    )


def random_states(
    regressor: Regressor, rng: np.random.Generator, samples: int
) -> Motion:
    """N unrelated states within the limits of the URDF, acceleration [rad/s^2] normal with ``ACCELERATION``.

    It is a motion in form only: its samples do not follow from one another.
    """
    shape = (samples, regressor.arm.n_joints)
    limits = urdf_limits(regressor.body, ACCELERATION, margin=0.0)
    q = rng.uniform(limits.lower, limits.upper, shape)
    dq = rng.uniform(-limits.velocity, limits.velocity, shape)
    ddq = ACCELERATION * rng.standard_normal(shape)
    t = np.arange(samples) / 1e3
    return Motion(t, q, dq, ddq)


def _independent(scaled: np.ndarray, order: Sequence[int], border: float) -> np.ndarray:
    """Columns, in the order given, of which more than ``border`` lies outside the span of those before."""
    span = np.empty((len(scaled), 0))
    kept = []
    for place in order:
        rest = scaled[:, place]
        # Gram-Schmidt
        for _ in range(2):  # twice is enough for orthogonality to the last bit
            rest = rest - span @ (span.T @ rest)
        size = np.linalg.norm(rest)
        if size > border:
            span = np.column_stack([span, rest / size])
            kept.append(place)
    return np.array(kept, dtype=int)


def _order(names: Sequence[str], preference: Preference) -> list[int]:
    """Places of the columns in the order of preference."""

    def key(place: int) -> tuple[int, ...]:
        found = re.fullmatch(r"([A-Za-z]+)(\d+)", names[place])
        if found is None or found[1] not in INERTIAL_PARAMETERS:
            return (1, 0, 0, place)  # effects come last, in their order
        link = int(found[2])
        within_link = INERTIAL_PARAMETERS.index(found[1])
        if preference == "link":
            return (0, link, within_link, place)
        # mass, three first moments, six inertias
        kind = 0 if within_link == 0 else 1 if within_link < 4 else 2
        return (0, kind, link, within_link)

    return sorted(range(len(names)), key=key)


def _expression(
    kept: int, row: np.ndarray, names: Sequence[str], tolerance: float
) -> str:
    """A combination in words, the parameter that represents it first."""
    parts = [names[kept]]
    for place in np.flatnonzero(np.abs(row) > tolerance):
        if place == kept:
            continue
        sign, size = "-" if row[place] < 0 else "+", abs(row[place])
        factor = "" if abs(size - 1) <= tolerance else f"{size:.6g} "
        parts.append(f"{sign} {factor}{names[place]}")
    return " ".join(parts)


# Base parameters in orthonormal combinations, by singular value decomposition.


@dataclass(frozen=True)
class OrthonormalBase:
    """Base parameters gamma = V1^T pi, co-ordinates of pi in the row space of Y; b of p parameters.

    The pi of least norm with the same torque is V1 gamma.

    Attributes:
        names: names of pi, shape (p,).
        basis: V1, shape (p, b), orthonormal columns.
        singular_values: of the unit columns of Y, shape (p,), falling; empty if not known.

    Source: gautier1991.
    """

    names: tuple[str, ...]
    basis: np.ndarray
    singular_values: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return self.basis.shape[1]

    @property
    def gap(self) -> float:
        """Smallest singular value that counts over the largest that does not."""
        return gap_at(self.singular_values, self.count)

    def of(self, parameters: np.ndarray) -> np.ndarray:
        """Gamma = V1^T pi, shape (b,)."""
        return self.basis.T @ parameters

    def spread(self, gamma: np.ndarray) -> np.ndarray:
        """Pi = V1 gamma, the shortest with this torque; shape (p,)."""
        return self.basis @ gamma

    def matrix(self, Y: np.ndarray) -> np.ndarray:
        """Y V1, the regressor of gamma, shape (..., b), of Y of shape (..., p)."""
        return Y @ self.basis

    def to_base(self, base: BaseParameters) -> np.ndarray:
        """T with beta = T gamma, shape (b, b)."""
        return base.combination @ self.basis

    def from_base(self, base: BaseParameters) -> np.ndarray:
        """T with gamma = T beta, shape (b, b)."""
        return np.linalg.inv(self.to_base(base))


def orthonormal_base(
    Y: np.ndarray, names: Sequence[str], tolerance: float = DEPENDENT
) -> OrthonormalBase:
    """Base parameters by singular value decomposition of a regressor of enough random samples.

    The right singular vectors of the unit columns that belong to values behind the gap, scaled back, span the pi
    without torque; V1 spans what is orthogonal to them.

    Args:
        Y: stacked regressor, shape (M, p) or (N, n, p); or its triangular factor, shape (p, p).
        names: of the columns.
        tolerance: largest singular value that can count as nil.

    Raises:
        InputError: values that are not finite, fewer rows than columns, or a regressor of zeros.

    Source: gautier1991.
    """
    names = tuple(names)
    scaled, norms = unit_triangle(Y, names)
    _, values, right = np.linalg.svd(scaled)
    count = rank_by_gap(values, tolerance)
    without_torque = right[count:].T / norms[:, None]
    unit = without_torque / np.linalg.norm(without_torque, axis=0)
    # a complete Q spans the pi without torque first, and then their orthogonal complement
    full = np.linalg.qr(unit, mode="complete")[0]
    return OrthonormalBase(names, full[:, len(names) - count :], values)


# Essential parameters: those base parameters that a recording needs to be explained.


DEVIATION = 0.3
"""A parameter with a larger relative standard deviation than this is not known from the recording [1]."""
CONTRIBUTION = 1e-3
"""A parameter that explains a smaller part of the RMS torque than this is negligible [1]."""
GROWTH = 0.02
"""All that is dropped together may raise the residual by no more than this part of it [1]."""


@dataclass(frozen=True)
class Dropped:
    """A parameter that was dropped.

    Attributes:
        name: of the parameter.
        relative_deviation: standard deviation over magnitude when it was dropped [1].
        contribution: RMS torque that it alone explained then, over the RMS of the torque [1].
    """

    name: str
    relative_deviation: float
    contribution: float


@dataclass(frozen=True)
class EssentialParameters:
    """A model that was reduced to its essential parameters, e of b.

    Attributes:
        names: of the essential parameters, shape (e,).
        places: theirs among the b base parameters, shape (e,), ascending.
        value: their least-squares estimate without the others, shape (e,).
        relative_deviation: standard deviation over magnitude [1], shape (e,).
        dropped: the others, in the order in which they were dropped.
        residual: RMS residual before and after [N m].
    """

    names: tuple[str, ...]
    places: np.ndarray
    value: np.ndarray
    relative_deviation: np.ndarray
    dropped: tuple[Dropped, ...]
    residual: tuple[float, float]

    def text(self) -> str:
        """The reduction in words, a line for each parameter that was dropped."""
        before, after = self.residual
        lines = [
            f"{len(self.names)} essential parameters of {len(self.names) + len(self.dropped)}; "
            f"RMS residual {before:.4g} N m before, {after:.4g} N m after"
        ]
        rows = [
            f"  dropped {d.name}: relative deviation {d.relative_deviation:.2g}, {100 * d.contribution:.2g} % of torque"
            for d in self.dropped
        ]
        return "\n".join(lines + rows)


def essential_parameters(
    factor: TriangularFactor,
    names: Sequence[str],
    *,
    deviation: float = DEVIATION,
    contribution: float = CONTRIBUTION,
    growth: float = GROWTH,
    inflation: float = 1.0,
) -> EssentialParameters:
    """Reduce a model step by step to its essential parameters.

    Each step drops the parameter with the largest relative deviation sigma_k / |beta_k|, which is also the one whose
    loss raises the sum of squares least, by beta_k^2 / [(R^T R)^-1]_kk, and fits again. It ends when the next one
    is known to ``deviation`` and explains ``contribution`` of the torque, or when the residual would
    have grown by more than ``growth`` in all (or beyond ``contribution`` of the torque, if there is hardly any).

    Args:
        factor: of the base columns and the torque, full rank; weighted, if joints differ in noise.
        names: of the base parameters, shape (b,).
        deviation: relative standard deviation above which a parameter is dropped.
        contribution: share of the RMS torque below which a parameter is dropped.
        growth: share by which the residual may grow.
        inflation: how many rows count as one, since the residual is autocorrelated [1].

    Raises:
        InputError: no more rows than parameters, or base columns that depend on each other in these samples.

    Source: pham1991.
    """
    diagonal = np.abs(np.diag(factor.triangle))
    if factor.rows <= len(names) or diagonal.min() < 1e-10 * diagonal.max():
        raise InputError(
            f"{factor.rows} rows do not determine {len(names)} parameters",
            "record a richer or longer motion",
        )
    torque = float(np.hypot(np.linalg.norm(factor.projected), factor.residual_norm))
    # a residual of almost nothing may grow by more than a share of itself
    limit = max((1 + growth) * factor.residual_norm, contribution * torque)
    places = list(range(len(names)))
    dropped: list[Dropped] = []
    current = factor
    while True:
        value, relative, rise = _significance(current, inflation)
        worst = int(np.argmin(rise))
        share = float(rise[worst] / torque) if torque else 0.0
        negligible = relative[worst] > deviation or share < contribution
        residual_without = np.hypot(current.residual_norm, rise[worst])
        if len(places) == 1 or not negligible or residual_without > limit:
            break
        name = names[places.pop(worst)]
        dropped.append(Dropped(name, float(relative[worst]), share))
        # fitted again without it: the others change
        current = factor.select(places)
    scale = 1 / np.sqrt(factor.rows)
    residual = (factor.residual_norm * scale, current.residual_norm * scale)
    kept = tuple(names[place] for place in places)
    return EssentialParameters(
        names=kept,
        places=np.array(places),
        value=value,
        relative_deviation=relative,
        dropped=tuple(dropped),
        residual=residual,
    )


def _significance(
    factor: TriangularFactor, inflation: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate, relative deviation [1], and by how much the norm of the residual rises without each parameter [N m]."""
    value = factor.solve()
    spread = np.sqrt(inflation * np.diag(factor.covariance()))
    relative = spread / np.maximum(np.abs(value), np.finfo(float).tiny)
    # row norms of R^-1 are the roots of the diagonal of (R^T R)^-1
    rise = np.abs(value) / np.linalg.norm(np.linalg.inv(factor.triangle), axis=1)
    return value, relative, rise


# Which inertial parameters base parameters give back, which only in combination, which not at all.


RECOVERED, COMBINED, HIDDEN = "recovered", "only in combination", "not identifiable"
SHARE = 1e-5
"""Part of a parameter's direction outside what the torque depends on, beyond which it is not recovered alone [1]."""


@dataclass(frozen=True)
class Recovery:
    """Whether and how one parameter is determined.

    Attributes:
        name: of the parameter.
        unit: its unit.
        status: ``recovered``, ``only in combination`` or ``not identifiable``.
        reason: why, in words.
        nominal: value of the nominal arm.
        value: the value in the consistent set; of a parameter that is not recovered a choice near the nominal one.
        deviation: standard deviation, or ``None`` if the data do not determine the parameter alone.
    """

    name: str
    unit: str
    status: str
    reason: str
    nominal: float
    value: float
    deviation: float | None


def recoveries(
    base: BaseParameters,
    covariance: np.ndarray,
    value: np.ndarray,
    nominal: np.ndarray,
    units: Sequence[str],
) -> tuple[Recovery, ...]:
    """Whether and how each parameter of pi is determined.

    A parameter is recovered if its unit vector lies in the row space of C, beta = C pi: then pi_j = e_j^T C^+ beta.
    It is not identifiable if its column of C is zero: no torque depends on it.

    Args:
        base: C.
        covariance: of beta, shape (b, b).
        value: consistent pi, shape (p,).
        nominal: pi of the nominal arm, shape (p,).
        units: of pi, shape (p,).
    """
    inverse = np.linalg.pinv(base.combination)
    inside = np.einsum("pb,bp->p", inverse, base.combination)
    size = np.linalg.norm(base.combination, axis=0)
    expressions = base.expressions(1e-4)
    out = []
    for j, name in enumerate(base.names):
        deviation: float | None = None
        if size[j] <= 1e-9:
            status, reason = HIDDEN, "no torque in these recordings depends on it"
        elif inside[j] >= 1 - SHARE:
            status = RECOVERED
            deviation = float(np.sqrt(max(inverse[j] @ covariance @ inverse[j], 0.0)))
            reason = "the torque determines it alone"
            if deviation > abs(value[j]):
                reason = "the torque determines it alone, but not more exactly than its own size"
        else:
            status = COMBINED
            first = int(np.argmax(np.abs(base.combination[:, j])))
            reason = f"the torque depends on {shortened(expressions[first])}"
        out.append(
            Recovery(
                name=name,
                unit=units[j],
                status=status,
                reason=reason,
                nominal=float(nominal[j]),
                value=float(value[j]),
                deviation=deviation,
            )
        )
    return tuple(out)


def shortened(expression: str, terms: int = 4) -> str:
    """An expression with its first terms, and how many more there are."""
    parts = expression.replace(" - ", " + -").split(" + ")
    if len(parts) <= terms:
        return expression
    return (
        " + ".join(parts[:terms]).replace("+ -", "- ")
        + f" and {len(parts) - terms} more terms"
    )
