"""Columns of the physics: what effects and inertial parameters can explain, which a network must not learn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor

NOT_LINEAR = ("link", "start", "end", "cycles")
"""Parameters that the torque has no useful derivative by."""
STEP = 1e-3
"""Step of the differences, over the parameter's typical size."""


def physics_columns(
    corrected: CorrectedArm, body: RigidBody, motion: Motion
) -> np.ndarray:
    """Columns of the inertial parameters, of ``JOINT_COLUMNS`` and of the effects, shape (N, n, p).

    They depend on each other; what counts is what they span together.
    """
    regressor = Regressor(corrected.arm, body, JOINT_COLUMNS)
    of_effects = effect_columns(corrected, body, motion)
    return np.concatenate([regressor.matrix(motion), of_effects], axis=2)


def effect_columns(
    corrected: CorrectedArm, body: RigidBody, motion: Motion
) -> np.ndarray:
    """Derivatives of the predicted torque by the parameters of the effects, (N, n, k)."""
    physical = replace(corrected.unlimited, residual=None)
    columns = [
        _derivative(physical, k, name, i, body, motion)
        for k, name, i in _places(physical)
    ]
    if not columns:
        return np.zeros((*motion.q.shape, 0))
    return np.stack(columns, axis=2)


def _places(corrected: CorrectedArm) -> list[tuple[int, str, int]]:
    """Effect, parameter and entry of each column."""
    return [
        (k, name, i)
        for k, applied in enumerate(corrected.effects)
        for name, values in applied.parameters.items()
        if name not in NOT_LINEAR
        for i in range(np.atleast_1d(values).size)
    ]


def _derivative(
    corrected: CorrectedArm, k: int, name: str, i: int, body: RigidBody, motion: Motion
) -> np.ndarray:
    """Central difference by one parameter, one-sided at its bound; shape (N, n)."""
    applied = corrected.effects[k]
    parameter = next(p for p in applied.effect.parameters if p.name == name)
    value = abs(float(np.atleast_1d(applied.parameters[name])[i]))
    size = max(value, abs(parameter.typical[1]), 1e-6)
    torques, steps = [], []
    for step in (-STEP * size, STEP * size):
        try:
            moved = _moved(applied, name, i, step)
        except (
            InputError
        ):  # beyond the bound: the difference is taken from the value itself
            moved, step = applied, 0.0
        effects = (*corrected.effects[:k], moved, *corrected.effects[k + 1 :])
        torques.append(replace(corrected, effects=effects).predict(body, motion))
        steps.append(step)
    return np.asarray((torques[1] - torques[0]) / (steps[1] - steps[0]))


def _moved(applied: AppliedEffect, name: str, i: int, step: float) -> AppliedEffect:
    """The effect with one parameter a step further."""
    value = np.array(applied.parameters[name], dtype=float)
    value.reshape(-1)[i] += step
    parameters = {**applied.parameters, name: value}
    return AppliedEffect(applied.name, applied.joints, parameters)
