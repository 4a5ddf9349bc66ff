"""An arm that predicts as files have it: possible bodies, a data sheet, effects, and what is left of its bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.arm.dynamics.inertial_scale import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.ident.model.physical_parameters import nearest_possible
from gapscope.ident.output.identified_arm import urdf_text
from gapscope.model.design import BODIES, FreeArm
from gapscope.model.rows import Rows
from gapscope.model.terms import Terms


@dataclass(frozen=True)
class PossibleArm:
    """An arm whose bodies can be, the nearest to those that predict best.

    Attributes:
        arm: the nominal arm with the data sheet that was found; its bodies are in ``urdf``.
        urdf: text of a URDF of its bodies.
        theta: coordinates of the effects that it has beside its data sheet, (P,).
        remainder: of the inertial parameters of each link, which the bodies lack to predict best, (n, 10).
        lacking: RMS torque of it on the first group [N m], (n,).
        torque_ratio: torque of the bodies that predict best over that of the nominal ones, by least squares [1].
    """

    arm: NominalArm
    urdf: str
    theta: np.ndarray
    remainder: np.ndarray
    lacking: np.ndarray
    torque_ratio: float


def possible_arm(
    free: FreeArm, sheet: NominalArm, rows: Rows, noise2: np.ndarray
) -> PossibleArm:
    """The possible arm nearest to one that predicts, by the torque of the first group.

    Args:
        free: the arm that predicts.
        sheet: the nominal arm with its data sheet.
        rows: of all groups.
        noise2: variance of the noise of each joint, over the square of its scale [1], (n,).

    Raises:
        GapscopeError: the solver finds no possible bodies.
    """
    n, scale = sheet.n_joints, inertial_scale(free.body)
    squares = _squares(free.body, rows)
    by_noise = squares / (noise2 * rows.scale**2)[:, None, None]
    normal = np.diag((BODIES * scale) ** -2.0) + by_noise.sum(axis=0)
    nominal = free.body.inertial_parameters()
    right = normal @ free.increments.ravel()
    value = nearest_possible(normal, right, nominal, n)
    change = (value - nominal).reshape(n, 10)
    body: RigidBody = free.body.changed(change)
    terms, theta = Terms(n, {}, sheet.coupled_motors), free.theta.copy()
    drives: dict[str, Any] = {}
    for effect in terms.definitions:
        name = effect.fitted.data_sheet
        if name is not None:
            own = terms.block(effect.name)[0]
            drives[name] = np.maximum(theta[own], 0.0)
            theta[own] = 0.0
    arm = replace(sheet, **drives, friction_source="the reference, identified")
    remainder = free.increments - change
    count = np.count_nonzero(rows.of(0))
    lacking = np.einsum("jpq,p,q->j", squares, remainder.ravel(), remainder.ravel())
    of_all = squares.sum(axis=0) @ nominal
    return PossibleArm(
        arm,
        urdf_text(arm, body),
        theta,
        remainder,
        np.sqrt(np.maximum(lacking, 0.0) / count),
        float(
            (nominal + free.increments.ravel()) @ of_all / max(nominal @ of_all, 1e-12)
        ),
    )


def _squares(body: RigidBody, rows: Rows) -> np.ndarray:
    """Sums over the rows of the first group of the products of the inertial columns, per joint, (n, 10 n, 10 n)."""
    n = body.n_joints
    out = np.zeros((n, 10 * n, 10 * n))
    for k, segment in enumerate(rows.segments):
        if rows.group_of[k]:
            continue
        motion = segment.motion
        regressor = body.regressor(motion.q, motion.dq, motion.ddq)
        x = rows.thin(regressor, segment)
        for j in range(n):
            out[j] += x[:, j].T @ x[:, j]
    return out
