"""Starts for compliant joints: elasticity and backlash are too nonlinear to linearise around none of it.

A link behind a soft or loose gear moves on its own. What that does to the torque is simulated on each joint for some
resonances and some widths of free play, and compared with the residual; the best are starting values of a fit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from gapscope.diagnosis.model.compliant_bodies import CompliantBodies
from gapscope.diagnosis.model.terms import Term, Terms
from gapscope.diagnosis.selection.fitted_model import Model
from gapscope.diagnosis.thresholds import (
    COMPLIANCE_RATIO,
    COMPLIANCE_START_GAIN,
    DAMPING_RATIOS,
    PLAY_WIDTHS,
    RESONANCES,
)
from gapscope.effects.corrected import CorrectedArm


@dataclass(frozen=True)
class Start:
    """A term with values to begin with.

    Attributes:
        term: elasticity or backlash of one joint.
        values: linear coordinates.
        gain: what these values explain of the residual [nats].
    """

    term: Term
    values: np.ndarray
    gain: float


def starts(model: Model, joints: Iterable[int] | None = None) -> list[Start]:
    """The best start of each effect on each joint that is not compliant yet, the most promising first.

    Args:
        model: the model whose residual is to be explained.
        joints: joints to look at, from 1; all if ``None``.
    """
    if model.data.arm.encoder != "motor":
        return []
    taken = {t.joint for t in model.fit.terms if not t.definition.locally_linear}
    looked_at = _joints_above_floor(model) - taken
    if joints is not None:
        looked_at &= set(joints)
    if not looked_at:
        return []
    arm = CorrectedArm(model.data.arm, model.terms.effects(model.linear.theta))
    bodies, best = model.data.compliance.of(arm), dict[Term, Start]()
    # recorded is what reaches the joint over the scale of its torque
    recorded = 1.0 / (1.0 + arm.value("torque_scale", "scale"))
    for joint in sorted(looked_at):
        j = joint - 1
        for term, values, torque in chain(
            _elastic(model.terms, bodies, j), _loose(model.terms, bodies, j)
        ):
            gain = model.linear.scan_residual.gain(torque * recorded)
            known = best[term].gain if term in best else 0.0
            if gain > max(known, COMPLIANCE_START_GAIN):
                best[term] = Start(term, values, gain)
    return sorted(best.values(), key=lambda start: -start.gain)


def _joints_above_floor(model: Model) -> set[int]:
    """Joints, from 1, whose residual exceeds the floor, or what a reference leaves, by enough to look for compliance.

    What bends or rattles shows on its own joint, whatever it does to the others.
    """
    rows, floor2 = model.evidence.rows, model.evidence.floor2
    if model.data.reference is not None:
        floor2 = np.maximum(floor2, model.data.reference.rest**2)
    residual2 = (model.fit.held_out_mse * rows).sum(axis=0)
    ratio2 = residual2 / (floor2 * rows).sum(axis=0)
    return {int(j) + 1 for j in np.flatnonzero(ratio2 >= COMPLIANCE_RATIO**2)}


Simulated = Iterator[tuple[Term, np.ndarray, np.ndarray]]
"""Terms with values to start from, and what these do to the torque of the bodies on all rows [N m], (M, n)."""


def _elastic(terms: Terms, bodies: CompliantBodies, j: int) -> Simulated:
    """Starts of one joint's elasticity: resonances of what it moves, with some damping ratios."""
    term, mass = terms.of("joint_elasticity")[j], bodies.mass[j]
    # intermediate links may have negative mass
    if mass <= 0:
        return
    for resonance in RESONANCES:
        stiffness = mass * (2 * np.pi * resonance) ** 2
        for ratio in DAMPING_RATIOS:
            damping = 2 * ratio * np.sqrt(stiffness * mass)
            values = np.array([1 / stiffness, damping / stiffness**2])
            yield term, values, bodies.elastic(j, stiffness, damping)


def _loose(terms: Terms, bodies: CompliantBodies, j: int) -> Simulated:
    """Starts of one joint's backlash; none if the torque never changes its sign, as the gear then stays on one side."""
    needed = np.concatenate([torque[:, j] for torque in bodies.torque])
    if bodies.mass[j] <= 0 or not needed.min() < 0 < needed.max():
        return
    term = terms.of("backlash")[j]
    for width in PLAY_WIDTHS:
        yield term, np.array([width]), bodies.loose(j, width)
