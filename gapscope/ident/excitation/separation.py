"""How well a trajectory separates effects from each other and from the base parameters."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg import subspace_angles

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.severity import draw


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
    first, second = _without_zeros(first), _without_zeros(second)
    if not first.size or not second.size:
        return 0.0
    return float(subspace_angles(first, second).min())


def _without_zeros(columns: np.ndarray) -> np.ndarray:
    return columns[:, np.linalg.norm(columns, axis=0) > 1e-9]
