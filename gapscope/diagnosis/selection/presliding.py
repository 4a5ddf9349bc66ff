"""Presliding beside the dry friction that was found: over what distance it builds up after a reversal.

It is no cause of a gap but part of how dry friction acts: sgn v says nothing of a joint that rests or turns round
slowly, where most of what dry friction leaves lies. The search trusts these samples least, so that it does without; the
distance of each joint then comes from a grid, by the gap that the arm with its fitted values leaves on all samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.fitted_model import Model
from gapscope.diagnosis.thresholds import PRESLIDING_DISTANCES, PRESLIDING_GAIN
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw


def presliding_distances(model: Model) -> np.ndarray:
    """Distance of each joint [rad], (n,); 0 without dry friction found, or where the gap does not fall decisively."""
    at_once = np.zeros(model.data.arm.n_joints)
    dry = has_dry_friction(model.fit.terms, len(at_once))
    if not dry.any():
        return at_once
    grid = np.array([np.where(dry, d, 0.0) for d in (0.0, *PRESLIDING_DISTANCES)])
    square = np.array([_gap_square(model, distance) for distance in grid])
    best = np.argmin(square, axis=0)
    samples = model.evidence.torque.independent.sum(axis=0)
    gain = 0.5 * samples * np.log(square[0] / square.min(axis=0))
    chosen = grid[best, np.arange(len(best))]
    return np.where(gain > PRESLIDING_GAIN, chosen, 0.0)


def has_dry_friction(terms: Iterable[Term], n_joints: int) -> np.ndarray:
    """Which joints have a term of dry friction of their own, shape (n,)."""
    dry = np.zeros(n_joints, dtype=bool)
    for term in terms:
        if isinstance(term.definition, DryLaw) and term.definition.reach == "joint":
            dry[term.joint - 1] = True
    return dry


def _gap_square(model: Model, distance: np.ndarray) -> np.ndarray:
    """Squared gap over all rows with the values fitted [N^2 m^2], (n,), if dry friction builds up over a distance."""
    data = model.data
    bent = replace(data.arm, presliding=distance)
    arm = CorrectedArm(bent, model.terms.effects(model.fit.theta, model.fit.terms))
    total = np.zeros(len(distance))
    for segment in data.segments:
        assert segment.torque is not None
        predicted = arm.predict(segment.bodies(data.body), segment.motion)
        gap = data.thin(arm.delivered(segment.torque) - predicted, segment)
        total += (gap**2).sum(axis=0)
    return total
