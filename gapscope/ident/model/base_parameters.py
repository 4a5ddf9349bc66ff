"""Base parameters by QR: ranks, which bodies they hold, what is essential and what can be recovered."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr, solve_triangular

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import urdf_limits
from gapscope.ident.model.regressor import Regressor

TINY = float(np.sqrt(np.finfo(float).tiny))
"""What would be divided by zero is divided by this: its square and its reciprocal are numbers yet."""

ROUNDING = float(np.sqrt(np.finfo(float).eps))
"""Share of a number of size one below which its difference from nothing is rounding [1]."""

WORTH = 0.02
"""A richer model has to lower an error on other data by this share; a poorer one may raise it by as much [1]."""

CONDITION_LIMIT = 1000.0
"""Condition number above which results are doubtful, and ratio of two neighbours in a spectrum at which it ends."""

# Numerical rank of a regressor: unit columns, and the gap in a spectrum.


DEPENDENT = 2e-5
"""Largest value of a spectrum, relative to a unit column, that can count as nil. Angles of a URDF rounded to four
decimals make directions of up to 5e-6, which no recording resolves."""
FLOOR = float(np.finfo(float).eps)
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
    if len(rows) > len(names):
        rows = qr(rows, mode="r", check_finite=False)[0][: len(names)]
    norms = np.linalg.norm(rows, axis=0)
    full = norms > ROUNDING * norms.max()
    if not full.any():
        raise InputError(
            "the regressor is zero: nothing moves and nothing weighs", "record a motion"
        )
    norms = np.where(full, norms, 1.0)
    return np.where(full, rows, 0.0) / norms, norms


def condition_number(matrix: np.ndarray) -> float:
    """Condition number of W, shape (N, n, b), with every column scaled to unit norm [1]; infinite for a zero column."""
    triangle = np.linalg.qr(matrix.reshape(-1, matrix.shape[2]), mode="r")
    norms = np.linalg.norm(triangle, axis=0)
    return float(np.linalg.cond(triangle / norms)) if norms.all() else float("inf")


def rank_by_gap(spectrum: np.ndarray) -> int:
    """Number of values that are not nil, of a falling spectrum that starts near 1.

    It ends at the first drop by ``CONDITION_LIMIT`` to a value below ``DEPENDENT``, or, if there is none so clear, at
    the widest drop to a value below it. All count if no value is so small.
    """
    small = np.flatnonzero(spectrum <= DEPENDENT)
    if not len(small):
        return len(spectrum)
    # below the floor a ratio is one of rounding errors
    values = np.maximum(spectrum, FLOOR)
    drops = values[small - 1] / values[small]
    clear = np.flatnonzero(drops >= CONDITION_LIMIT)
    end = clear[0] if len(clear) else np.argmax(drops)
    return int(small[end])


# Least squares by the triangular factor of its equations, in which no condition number is squared.


@dataclass(frozen=True)
class Factor:
    """Equations W beta = tau of any number of rows as a triangle: |tau - W beta|^2 = |z - R beta|^2 + rest.

    Attributes:
        triangle: R, shape (b, b).
        rotated: z, shape (b,).
        rest: squared norm of what no beta explains.
        rows: number of equations.
    """

    triangle: np.ndarray
    rotated: np.ndarray
    rest: float
    rows: int

    @classmethod
    def of(cls, matrix: np.ndarray, torque: np.ndarray) -> Factor:
        """The factor of equations, matrix of shape (M, b) and torque of shape (M,)."""
        b = matrix.shape[1]
        # half of a joint's columns are zero, as its torque has nothing of the bodies before it
        present = matrix.any(axis=0)
        equations = np.column_stack([matrix[:, present], torque])
        some = np.asarray(np.linalg.qr(equations, mode="r"))
        count = int(present.sum())
        # fewer equations than columns: rows of zeros complete the triangle
        triangle, rotated = np.zeros((b, b)), np.zeros(b)
        upper = some[:count]
        triangle[: len(upper), present] = upper[:, :count]
        rotated[: len(upper)] = upper[:, count]
        rest = float((some[count:, count] ** 2).sum())
        return cls(triangle, rotated, rest, len(matrix))

    @classmethod
    def together(cls, parts: Sequence[Factor]) -> Factor:
        """The factor of the equations of all parts, of the same parameters."""
        triangles = np.vstack([part.triangle for part in parts])
        found = cls.of(triangles, np.concatenate([part.rotated for part in parts]))
        rest = found.rest + sum(part.rest for part in parts)
        return replace(found, rest=rest, rows=sum(part.rows for part in parts))

    def select(self, columns: Sequence[int]) -> Factor:
        """The factor of some columns of W, in the order given."""
        return Factor.together([replace(self, triangle=self.triangle[:, columns])])

    def over(self, noise: float) -> Factor:
        """The factor of the equations divided by a noise."""
        triangle, rotated = self.triangle / noise, self.rotated / noise
        return Factor(triangle, rotated, self.rest / noise**2, self.rows)

    def squares(self, beta: np.ndarray) -> float:
        """|tau - W beta|^2."""
        left = self.rotated - self.triangle @ beta
        return float(left @ left) + self.rest

    @property
    def freedom(self) -> int:
        """Equations less parameters, at least 1."""
        return max(self.rows - len(self.rotated), 1)

    def solve(self) -> np.ndarray:
        """The least-squares beta, shape (b,); R must be regular."""
        return solve_triangular(self.triangle, self.rotated)

    def inverse_gram(self) -> np.ndarray:
        """(W^T W)^-1, shape (b, b); R must be regular."""
        inverse = solve_triangular(self.triangle, np.eye(len(self.triangle)))
        return inverse @ inverse.T


# Base parameters: the minimal combinations of pi that the torque depends on.


ACCELERATION = 5.0
"""Typical acceleration of random states [rad/s^2]."""
STATES = 300
"""Random states from which what an arm shows is found, whatever its recordings excite."""


@dataclass(frozen=True)
class BaseParameters:
    """Base parameters beta = C pi with Y pi = Y[:, kept] beta for every motion; b of p parameters.

    Attributes:
        names: names of pi, shape (p,).
        kept: places in pi of the parameters that represent the combinations, shape (b,), ascending.
        combination: C, shape (b, p); its columns at ``kept`` are the identity.
    """

    names: tuple[str, ...]
    kept: np.ndarray
    combination: np.ndarray

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return len(self.kept)

    @property
    def kept_names(self) -> tuple[str, ...]:
        """Names of the parameters that represent the combinations, shape (b,)."""
        return tuple(self.names[k] for k in self.kept)

    @property
    def dropped(self) -> np.ndarray:
        """Places in pi of the others, folded into the kept ones or without effect, shape (p - b,), ascending."""
        return np.setdiff1d(np.arange(len(self.names)), self.kept)

    @property
    def null_space(self) -> np.ndarray:
        """N, shape (p, p - b): pi + N z gives the same torque as pi, for every z; ``dropped`` rows are the identity.

        So every pi is that of ``of(pi)``, zero but where kept, plus ``null_space @ pi[dropped]``.
        """
        out = np.zeros((len(self.names), len(self.names) - self.count))
        out[self.dropped] = np.eye(out.shape[1])
        out[self.kept] = -self.combination[:, self.dropped]
        return out

    def of(self, parameters: np.ndarray) -> np.ndarray:
        """Beta = C pi, shape (b,)."""
        return self.combination @ parameters

    def nearest(self, beta: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """The pi nearest to a prior, shape (p,), that gives the same torque as beta (least squares)."""
        return prior + np.linalg.pinv(self.combination) @ (beta - self.of(prior))

    def expressions(self) -> tuple[str, ...]:
        """Each base parameter as a readable combination, ``mx2 + 0.5 m3``, its kept one first; shape (b,)."""
        out = []
        for kept, row in zip(self.kept.tolist(), self.combination, strict=True):
            parts = [self.names[kept]]
            for place in np.flatnonzero(np.abs(row) > DEPENDENT):
                sign, size = "-" if row[place] < 0 else "+", abs(row[place])
                factor = "" if abs(size - 1) <= DEPENDENT else f"{size:.6g} "
                if place != kept:
                    parts.append(f"{sign} {factor}{self.names[place]}")
            out.append(" ".join(parts))
        return tuple(out)


def base_parameters(Y: np.ndarray, names: Sequence[str]) -> BaseParameters:
    """Base parameters by QR of a regressor of enough random samples.

    The number b comes from the QR with column pivoting of the columns scaled to unit norm: it ends at the gap in the
    spectrum of R's diagonal, see ``rank_by_gap``. Which parameters represent the combinations is a choice: columns are
    taken from the base to the tip, within a link mass, first moment, inertia, then effects, and one that depends on
    those before it is folded into them. What a link carries is so folded into the link that carries it, factors are
    levers and their squares (``mx2 + 0.5 m3``), as in the classical regrouping rules of serial arms, and rotor inertia
    goes into the inertia of the link.

    If that leaves another number than b, because data excite the arm poorly, the columns that the pivoting chose are
    kept.

    Args:
        Y: stacked regressor, shape (M, p) or (N, n, p); or its triangular factor, shape (p, p).
        names: of the columns.

    Raises:
        InputError: values that are not finite, fewer rows than columns, or a regressor of zeros.

    Source: gautier1991, gautier1990.
    """
    names = tuple(names)
    scaled, norms = unit_triangle(Y, names)
    # how many: by the pivots, which reveal the rank
    pivoted, places = qr(scaled, mode="r", pivoting=True, check_finite=False)
    pivots = np.abs(np.diag(pivoted))
    count = rank_by_gap(pivots)
    # which: in the order of preference, unless that finds another number
    # in the middle of the gap
    border = np.sqrt(pivots[count - 1] * max(np.append(pivots, 0.0)[count], FLOOR))
    span, chosen = np.empty((len(scaled), 0)), []
    for place in _order(names):
        rest = scaled[:, place]
        # Gram-Schmidt
        for _ in range(2):  # twice is enough for orthogonality to the last bit
            rest = rest - span @ (span.T @ rest)
        size = np.linalg.norm(rest)
        # more than that lies outside the span of those before
        if size > border:
            span = np.column_stack([span, rest / size])
            chosen.append(place)
    kept = np.sort(chosen if len(chosen) == count else places[:count])
    # every column as a combination of those kept
    weights = np.linalg.lstsq(scaled[:, kept], scaled, rcond=None)[0]
    # rounding would show as combinations that are none
    weights[np.abs(weights) < ROUNDING] = 0.0
    weights *= norms / norms[kept, None]
    weights[:, kept] = np.eye(count)
    return BaseParameters(names, kept, weights)


def structural_base(regressor: Regressor, rng: np.random.Generator) -> BaseParameters:
    """Base parameters of an arm, whatever its recordings excite: of random states within the arm's limits.

    Args:
        regressor: of the arm, with the columns wanted.
        rng: source of the states.
    """
    states = random_states(regressor, rng, STATES)
    return base_parameters(regressor.matrix(states), regressor.names)


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


def _order(names: Sequence[str]) -> list[int]:
    """Places of the columns in the order of preference: link by link, effects last in their order."""

    def key(place: int) -> tuple[int, ...]:
        found = re.fullmatch(r"([A-Za-z]+)(\d+)", names[place])
        if found is None or found[1] not in INERTIAL_PARAMETERS:
            return (1, place)
        return (0, int(found[2]), INERTIAL_PARAMETERS.index(found[1]))

    return sorted(range(len(names)), key=key)


# Essential parameters: those base parameters that a recording needs to be explained.


DEVIATION = 0.3
"""A parameter with a larger relative standard deviation than this is not known from the recording [1]."""
CONTRIBUTION = 1 / CONDITION_LIMIT
"""A parameter that explains a smaller part of the RMS torque than this is negligible [1]."""


@dataclass(frozen=True)
class EssentialParameters:
    """A model that was reduced to its essential parameters, e of b.

    Attributes:
        names: of the essential parameters, shape (e,).
        relative_std: standard deviation over magnitude [1], shape (e,).
        dropped: the others, in the order in which they were dropped, each with ``name``, ``relative_std`` then, and
            ``contribution``: the RMS torque that it alone explained, over the RMS of the torque [1].
        residual_growth: share by which the RMS residual grew [1].
    """

    names: tuple[str, ...]
    relative_std: np.ndarray
    dropped: list[dict[str, str | float]]
    residual_growth: float


def essential_parameters(
    factor: Factor, names: Sequence[str], inflation: float = 1.0
) -> EssentialParameters:
    """Reduce a model step by step to its essential parameters.

    Each step drops the parameter with the largest relative deviation sigma_k / |beta_k|, which is also the one whose
    loss raises the sum of squares least, by beta_k^2 / [(R^T R)^-1]_kk, and fits again. It ends when the next one
    is known to ``DEVIATION`` and explains ``CONTRIBUTION`` of the torque, or when the residual would
    have grown by more than ``WORTH`` in all (or beyond ``CONTRIBUTION`` of the torque, if there is hardly any).

    Args:
        factor: of the base columns and the torque, full rank; weighted, if joints differ in noise.
        names: of the base parameters, shape (b,).
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
    before = np.sqrt(factor.rest)
    torque = float(np.hypot(np.linalg.norm(factor.rotated), before))
    # a residual of almost nothing may grow by more than a share of itself
    limit = max((1 + WORTH) * before, CONTRIBUTION * torque)
    places = list(range(len(names)))
    dropped: list[dict[str, str | float]] = []
    current = factor
    while True:
        value, inverse = current.solve(), np.diag(current.inverse_gram())
        size = np.abs(value)
        variance = inflation * current.rest / current.freedom
        relative = np.sqrt(variance * inverse) / np.maximum(size, TINY)
        # by how much the norm of the residual rises without each parameter [N m]
        rise = size / np.sqrt(inverse)
        worst = int(np.argmin(rise))
        share = float(rise[worst] / torque) if torque else 0.0
        negligible = relative[worst] > DEVIATION or share < CONTRIBUTION
        squares_without = current.rest + rise[worst] ** 2
        if len(places) == 1 or not negligible or squares_without > limit**2:
            break
        name = names[places.pop(worst)]
        deviation = float(relative[worst])
        dropped.append({"name": name, "relative_std": deviation, "contribution": share})
        # fitted again without it: the others change
        current = factor.select(places)
    before, after = (float(np.sqrt(f.rest / f.rows)) for f in (factor, current))
    kept = tuple(names[place] for place in places)
    growth = after / (before + TINY) - 1
    return EssentialParameters(kept, relative, dropped, growth)


# Which inertial parameters base parameters give back, which only in combination, which not at all.


RECOVERED, COMBINED, HIDDEN = "recovered", "only in combination", "not identifiable"


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
        std: standard deviation, or ``None`` if the data do not determine the parameter alone.
    """

    name: str
    unit: str
    status: str
    reason: str
    nominal: float
    value: float
    std: float | None


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
    deviations = np.sqrt(np.einsum("pb,bc,pc->p", inverse, covariance, inverse).clip(0))
    expressions = base.expressions()
    out = []
    for j, name in enumerate(base.names):
        deviation = None
        status, reason = HIDDEN, "no torque in these recordings depends on it"
        # beyond rounding of a URDF, part of it lies outside what the torque depends on
        if inside[j] >= 1 - DEPENDENT:
            status, deviation = RECOVERED, float(deviations[j])
            reason = "the torque determines it alone"
            if deviation > abs(value[j]):
                reason += ", but not more exactly than its own size"
        elif size[j] > ROUNDING:
            first = int(np.argmax(np.abs(base.combination[:, j])))
            status = COMBINED
            reason = f"the torque depends on {shortened(expressions[first])}"
        known = float(nominal[j]), float(value[j]), deviation
        out.append(Recovery(name, units[j], status, reason, *known))
    return tuple(out)


TERMS = 4
"""Terms of an expression that are shown."""


def shortened(expression: str) -> str:
    """An expression with its first terms, and how many more there are."""
    first, *others = re.split(r" (?=[+-] )", expression)
    if len(others) < TERMS:
        return expression
    left = f"and {len(others) + 1 - TERMS} more terms"
    return " ".join([first, *others[: TERMS - 1], left])
