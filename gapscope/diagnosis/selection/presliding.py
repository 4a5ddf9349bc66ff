"""Presliding beside the dry friction that was found: over what distance it builds up after a reversal.

It is no cause of a gap but part of how dry friction acts: sgn v says nothing of a joint that rests or turns round
slowly, where most of what dry friction leaves lies. The search trusts these samples least and does without; the
distance of each joint then comes from a grid, with the values as fitted. It has to narrow the gap of all samples, and
the trusted ones decide: a distance that suits rests alone does harm on motions without any.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.selection.fitted_model import Model
from gapscope.diagnosis.thresholds import PRESLIDING_GAIN
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw
from gapscope.effects.friction import PRESLIDING_DISTANCES
from gapscope.model.terms import Term


def presliding_distances(model: Model) -> np.ndarray:
    """Distance of each joint [rad], (n,); 0 without dry friction found, or where the gap does not fall decisively."""
    at_once = np.zeros(model.data.arm.n_joints)
    dry = has_dry_friction(model.fit.terms, len(at_once))
    if not dry.any():
        return at_once
    size = model.data.arm.per_radian
    grid = np.array(
        [np.where(dry, d * size, 0.0) for d in (0.0, *PRESLIDING_DISTANCES)]
    )
    squares = np.array([_squared_gap(model, distance) for distance in grid])
    everywhere, trusted = squares[:, 0], squares[:, 1]
    trusted = np.where(everywhere <= everywhere[0], trusted, np.inf)
    best = np.argmin(trusted, axis=0)
    samples = model.evidence.torque.independent.sum(axis=0)
    gain = 0.5 * samples * np.log(trusted[0] / trusted.min(axis=0))
    chosen = grid[best, np.arange(len(best))]
    return np.where(gain > PRESLIDING_GAIN, chosen, 0.0)


def has_dry_friction(terms: Iterable[Term], n_joints: int) -> np.ndarray:
    """Which joints have a term of dry friction of their own, shape (n,)."""
    dry = np.zeros(n_joints, dtype=bool)
    for term in terms:
        if isinstance(term.definition, DryLaw) and term.definition.reach == "joint":
            dry[term.joint - 1] = True
    return dry


def _squared_gap(model: Model, distance: np.ndarray) -> np.ndarray:
    """Squared gap if dry friction builds up over a distance, over all rows and by trust [N^2 m^2], (2, n)."""
    bent = replace(model.data.arm, presliding=distance)
    effects = model.terms.effects(model.fit.theta, model.fit.terms)
    return model.linear.squared_gap(CorrectedArm(bent, effects))
