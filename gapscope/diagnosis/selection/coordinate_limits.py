"""How small the coordinates of terms may be, where they stop, and how large they usually are."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.joint_units import size_per_radian
from gapscope.arm.nominal import NominalArm
from gapscope.model.terms import Terms


def lowest_values(arm: NominalArm, body: RigidBody, terms: Terms) -> np.ndarray:
    """Lowest values, (P,): as the effects say; what adds to the data sheet may not fall below zero in total."""
    lowest = np.full(terms.size, -np.inf)
    masses = body.inertial_parameters()[::10]
    for effect in terms.definitions:
        fitted, places = effect.fitted, terms.block(effect.name)[0]
        least = fitted.lowest
        lowest[places] = least(masses, body.last_link) if callable(least) else least
        if fitted.data_sheet is not None:
            lowest[places] = -getattr(arm, fitted.data_sheet) - 1e-9
    return lowest


def stated_bounds(arm: NominalArm, terms: Terms) -> np.ndarray:
    """Lower bounds at which values stop, (P,): what the data sheet or the URDF states may be gone altogether.

    Others have none: a value that cannot be speaks against its term, the absence of what is stated does not.
    """
    bounds = np.full(terms.size, -np.inf)
    for effect in terms.definitions:
        stated = effect.fitted.data_sheet
        if stated is not None:
            nominal = getattr(arm, stated)
            places = terms.block(effect.name)[0]
            bounds[places] = np.where(nominal > 0, -nominal, -np.inf)
    return bounds


def usual_sizes(arm: NominalArm, terms: Terms) -> np.ndarray:
    """Usual sizes of the coordinates, (P,), infinite for those that the torque alone bounds."""
    usual = np.full(terms.size, np.inf)
    for effect in terms.definitions:
        size: float | np.ndarray = effect.fitted.usual
        alone = effect.scope == "joint" and len(effect.parameters) == 1
        if alone and effect.reach != "motor":
            size = size * size_per_radian(effect.parameters[0].unit, arm.sliding)
        usual[terms.block(effect.name)] = size
    return usual
