"""Base parameters: the minimal combinations of pi that the torque depends on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.linalg import qr

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import urdf_limits
from gapscope.ident.model.rank import DEPENDENT, gap_at, rank_by_gap, unit_triangle
from gapscope.ident.model.regressor import Regressor

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
