"""Which parameters of an arm a motion determines: rank, condition, spectrum, standing of each parameter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.rank import EMPTY, rank_by_gap
from gapscope.ident.model.tsqr import TriangularFactor

CONDITION_LIMIT = 1000.0
"""Condition number above which a report warns."""
ALONE, COMBINED, NONE = "alone", "combined", "none"
"""Standings of a parameter: identifiable by itself, only in combination with others, not at all."""
_FOLDED = 1e-6
_WEAK = 0.3


@dataclass(frozen=True)
class Identifiability:
    """What samples determine of p parameters pi of an arm, whose structure leaves b base parameters.

    Attributes:
        base: base parameters of the arm.
        rows: number of rows of the samples.
        rank: how many base parameters, or combinations of them, the samples determine.
        condition: condition number of the base columns, scaled to unit norm [1].
        condition_unscaled: that of the base columns as they are, which depends on the units.
        singular_values: of the unit base columns over their largest, shape (b,), falling.
        column_norms: RMS torque of each parameter per unit of it [N m per unit], shape (p,).
        standing: of each parameter, ``alone``, ``combined`` or ``none``, by the structure of the arm; shape (p,).
        weakest: the base parameters that make up the worst determined combination, largest share first.
        warnings: what makes results doubtful, each a sentence with a remedy.
    """

    base: BaseParameters
    rows: int
    rank: int
    condition: float
    condition_unscaled: float
    singular_values: np.ndarray
    column_norms: np.ndarray
    standing: tuple[str, ...]
    weakest: tuple[str, ...]
    warnings: tuple[str, ...]

    def having(self, standing: str) -> tuple[str, ...]:
        """Names of the parameters of a standing."""
        pairs = zip(self.base.names, self.standing, strict=True)
        return tuple(name for name, own in pairs if own == standing)

    def text(self) -> str:
        """The report in words, some lines, the base parameters last."""
        low, high = self.singular_values[-1], self.singular_values[0]
        lines = [
            f"{self.base.count} base parameters of {len(self.base.names)} (gap of the pivots {self.base.gap:.1e}); "
            f"{self.rows} rows determine {self.rank}",
            f"condition number {self.condition:.4g} with unit columns, {self.condition_unscaled:.4g} as they are; "
            f"singular values from {high:.3g} down to {low:.3g}",
            f"worst determined: {', '.join(self.weakest)}",
            *(
                f"{title}: {', '.join(self.having(s)) or 'none'}"
                for title, s in _TITLES
            ),
            *(f"warning: {warning}" for warning in self.warnings),
            "base parameters [RMS torque per unit, N m]:",
        ]
        norms = self.column_norms[self.base.kept]
        return "\n".join(
            lines
            + [
                f"  {e}  [{norm:.3g}]"
                for e, norm in zip(self.base.expressions(), norms, strict=True)
            ]
        )


_TITLES = (
    ("identifiable alone", ALONE),
    ("identifiable only in combination", COMBINED),
    ("without effect on the torque", NONE),
)


def identifiability(
    samples: np.ndarray | TriangularFactor, base: BaseParameters
) -> Identifiability:
    """What samples determine of the parameters of an arm.

    Args:
        samples: regressor of all p parameters, shape (M, p) or (N, n, p), or its factor for long recordings.
        base: base parameters of the arm (``structural_base``), which separate what the arm cannot show from what the
            motion does not show.

    Raises:
        InputError: values that are not finite, another number of columns, or no motion at all.

    Source: gautier1992.
    """
    if isinstance(samples, TriangularFactor):
        factor = samples
    else:
        factor = TriangularFactor(samples.shape[-1])
        factor.add(samples)
    if factor.columns != len(base.names):
        raise InputError(
            f"{factor.columns} columns, but {len(base.names)} parameters",
            where="regressor",
        )
    triangle = factor.triangle
    norms = np.linalg.norm(triangle, axis=0)
    if not norms.any():
        raise InputError(
            "the regressor is zero: nothing moves and nothing weighs", "record a motion"
        )
    columns, kept_norms = triangle[:, base.kept], norms[base.kept]
    excited = kept_norms > EMPTY * norms.max()
    # columns without excitation would divide by zero
    unit = np.where(excited, columns, 0.0) / np.where(excited, kept_norms, 1.0)
    values, right = np.linalg.svd(unit)[1:]
    relative = values / values[0]
    rank = rank_by_gap(relative)
    # the parameters that make up the direction that the samples show least
    last = np.abs(right[-1])
    names = [base.names[place] for place in base.kept]
    order = [int(k) for k in np.argsort(-last)]
    weakest = tuple(names[k] for k in order if last[k] > _WEAK * last.max())
    condition, raw = float(np.linalg.cond(unit)), float(np.linalg.cond(columns))
    return Identifiability(
        base=base,
        rows=factor.rows,
        rank=rank,
        condition=condition,
        condition_unscaled=raw,
        singular_values=relative,
        column_norms=norms / np.sqrt(max(factor.rows, 1)),
        standing=_standings(base),
        weakest=weakest,
        warnings=_warnings(base, rank, condition, raw, weakest),
    )


def _standings(base: BaseParameters) -> tuple[str, ...]:
    """Standing of each parameter by the combinations it occurs in."""
    involved = np.abs(base.combination) > _FOLDED
    standing = [COMBINED if in_any else NONE for in_any in involved.any(axis=0)]
    alone = involved.sum(axis=1) == 1
    for place in base.kept[alone]:
        standing[place] = ALONE
    return tuple(standing)


def _warnings(
    base: BaseParameters,
    rank: int,
    condition: float,
    raw: float,
    weakest: tuple[str, ...],
) -> tuple[str, ...]:
    out = []
    if rank < base.count:
        out.append(
            f"the samples determine only {rank} of {base.count} base parameters, not {', '.join(weakest)}; "
            "record a motion that moves every joint, up to higher speed and acceleration"
        )
    if condition > CONDITION_LIMIT:
        out.append(
            f"condition number {condition:.3g} with unit columns is above {CONDITION_LIMIT:g}: "
            f"{', '.join(weakest)} cannot be separated; record an optimised exciting motion, or drop what is not "
            "essential"
        )
    elif raw > CONDITION_LIMIT:
        out.append(
            f"condition number {raw:.3g} is above {CONDITION_LIMIT:g} for the sake of units alone; scale the columns "
            "to unit norm before solving"
        )
    return tuple(out)
