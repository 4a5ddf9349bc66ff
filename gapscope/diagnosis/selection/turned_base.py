"""Arms that hang or are mounted otherwise: too far from the nominal arm's gravity for its linearisation."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.selection.fitted_model import Model, fit_terms
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Turn
from gapscope.model.gravity_direction import (
    TURNED_BASE_FALL,
    gravity_by_torque,
    turn_of_base,
)


def add_turned_base(nominal: Model) -> Model:
    """The model with the turn of the base that takes most of the gap away, if one does, of the effect's starts."""
    gravity = nominal.data.body.gravity
    upright = _gap_square(nominal, gravity)
    for term in nominal.terms.all:
        effect = term.definition
        if not isinstance(effect, Turn):
            continue
        turns = [*map(np.array, effect.far), *_fitted_turn(nominal)]
        gaps = [_gap_square(nominal, effect.rotation(*x).T @ gravity) for x in turns]
        best = int(np.argmin(gaps))
        if gaps[best] > (1.0 - TURNED_BASE_FALL) * upright:
            continue
        turned = fit_terms(nominal, frozenset({term}), {term: turns[best]})
        if nominal.gain_of(turned) > 0:
            return turned
    return nominal


def _fitted_turn(model: Model) -> list[np.ndarray]:
    """Roll and pitch [rad] of the base that gives the gravity which the torque shows, if any does."""
    data = model.data
    arm = CorrectedArm(data.arm)
    gravity = data.body.gravity
    torque, regressor, speed = [], [], []
    for segment, bodies in zip(data.segments, data.bodies, strict=True):
        assert segment.torque is not None
        predicted = arm.predict(segment.bodies(data.body), segment.motion)
        without_gravity = segment.torque - predicted + bodies.gravity @ gravity
        torque.append(data.thin(without_gravity, segment))
        regressor.append(data.thin(bodies.gravity, segment))
        speed.append(data.thin(segment.motion.dq, segment))
    found = gravity_by_torque(
        np.concatenate(torque),
        np.concatenate(regressor),
        np.concatenate(speed),
        data.torque_deviation,
    )
    turn = turn_of_base(gravity, found)
    return [] if turn is None else [np.array(turn)]


def _gap_square(model: Model, gravity: np.ndarray) -> float:
    """Squared gap of the nominal arm under another gravity, over that of the torques, summed over rows [1]."""
    data = model.data
    arm = CorrectedArm(data.arm)
    change = gravity - data.body.gravity
    total = 0.0
    for segment, bodies in zip(data.segments, data.bodies, strict=True):
        assert segment.torque is not None
        predicted = arm.predict(segment.bodies(data.body), segment.motion)
        gap = segment.torque - predicted - bodies.gravity @ change
        scaled = data.thin(gap, segment) / data.torque_deviation
        total += float((scaled**2).sum())
    return total
