"""Essential parameters: those base parameters that a recording needs to be explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.ident.model.tsqr import TriangularFactor

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
