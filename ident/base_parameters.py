"""Base parameters: the minimal combinations of pi that the torque depends on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

_PREFERENCE = {"m": 0, "mx": 1, "my": 1, "mz": 1}


@dataclass(frozen=True)
class BaseParameters:
    """Base parameters beta = C pi with Y pi = Y[:, kept] beta for every motion; b of p parameters.

    Attributes:
        names: names of pi, shape (p,).
        kept: places in pi of the parameters that stand for the combinations, shape (b,), ascending.
        combination: C, shape (b, p); its columns at ``kept`` are the identity.
    """

    names: tuple[str, ...]
    kept: np.ndarray
    combination: np.ndarray

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return len(self.kept)

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
        """Each base parameter as a readable combination, ``m2 + 0.5 m3``; shape (b,)."""
        return tuple(_expression(row, self.names, tolerance) for row in self.combination)


def base_parameters(Y: np.ndarray, names: Sequence[str], tolerance: float = 1e-8) -> BaseParameters:
    """Base parameters by QR of a regressor of enough random samples.

    Columns enter in the order of preference mass, first moment, inertia, others; one that depends on those before it
    (its pivot of R below ``tolerance`` times the largest) is folded into them.

    Args:
        Y: stacked regressor, shape (M, p) with M >= p; or its triangular factor.
        names: of the columns.
        tolerance: relative.

    Source: gautier1991.
    """
    names = tuple(names)
    order = np.array(sorted(range(len(names)), key=lambda i: (_preference(names[i]), -i)))
    norms = np.linalg.norm(Y, axis=0)
    scaled = Y[:, order] / np.where(norms > 0, norms, 1.0)[order]
    triangle = qr(scaled, mode="r")[0][: len(names)]
    independent = np.abs(np.diag(triangle)) > tolerance * np.abs(np.diag(triangle)).max()
    kept = np.sort(order[independent])
    weights = np.linalg.lstsq(Y[:, kept], Y, rcond=None)[0]
    weights[np.abs(weights) < 1e-9 * max(np.abs(weights).max(), 1.0)] = 0.0
    return BaseParameters(names, kept, weights)


def _preference(name: str) -> int:
    letters = name.rstrip("0123456789")
    return _PREFERENCE.get(letters, 2 if letters.startswith("I") and len(letters) == 3 else 3)


def _expression(row: np.ndarray, names: Sequence[str], tolerance: float) -> str:
    parts = []
    for value, name in zip(row, names, strict=True):
        if abs(value) <= tolerance:
            continue
        size = "" if abs(abs(value) - 1) <= tolerance else f"{abs(value):.6g} "
        sign = ("-" if value < 0 else "") if not parts else (" - " if value < 0 else " + ")
        parts.append(f"{sign}{size}{name}")
    return "".join(parts)
