"""Neighbouring joints that share friction as the joints of one motor do, on an arm whose case declares no such motor.

A motor that turns joints j and k = j + 1 has friction of its own speed dq_k + r dq_j, r = 1 or -1, which no friction of
either joint can stand in for. Both signs are tried, for all pairs at once: a hypothetical coupling gives each motor k
the row e_k + r e_j, and the terms of these motors are weighed beside all that the search has found.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.selection.evidence import Evidence, Fit, likeliest_evidence
from gapscope.diagnosis.selection.fitted_model import Selection
from gapscope.diagnosis.thresholds import COUPLING_CLOSES


@dataclass(frozen=True)
class UndeclaredCoupling:
    """Two joints that seem to be turned by one motor.

    Attributes:
        joint: the first of them, from 1.
        motor: the second, by whose number the motor goes.
        ratio: turns of the motor for one turn of the first joint, 1 or -1.
        gain: evidence of the motor's friction beside that of both joints [nats].
    """

    joint: int
    motor: int
    ratio: float
    gain: float

    @property
    def declaration(self) -> dict[str, float]:
        """The entry of ``nominal.coupling`` that declares it."""
        return {"motor": self.motor, "joint": self.joint, "ratio": self.ratio}


def undeclared_coupling(
    selection: Selection, open_joints: Collection[int]
) -> UndeclaredCoupling | None:
    """The pair of neighbours whose residual shows a common motor most clearly; ``None`` if no pair's does.

    Args:
        selection: result of the search on an arm without coupled motors.
        open_joints: joints above their floor, from 1; both of a pair have to be.
    """
    linear = selection.evidence.linear
    pairs = [(j, j + 1) for j in open_joints if j + 1 in open_joints]
    if linear.arm.coupled_motors or not pairs:
        return None
    found = []
    for ratio in (1.0, -1.0):
        evidence = _with_motors(selection, [k for _, k in pairs], ratio)
        found += [_weighed(selection, evidence, *pair, ratio) for pair in pairs]
    clear = [one for one in found if one is not None and one.gain > 0]
    return max(clear, key=lambda one: one.gain, default=None)


def _with_motors(selection: Selection, motors: list[int], ratio: float) -> Evidence:
    """The evidence on an arm with hypothetical coupled motors, around the values of the selection."""
    old = selection.evidence.linear
    coupling = np.eye(old.arm.n_joints)
    for motor in motors:
        coupling[motor - 1, motor - 2] = ratio
    data = old.data.on(replace(old.arm, coupling=coupling))
    terms = replace(old.terms, motors=data.arm.coupled_motors)
    # the terms of motors come last
    theta = np.zeros(terms.size)
    theta[: len(old.theta)] = old.theta
    linear = Linearisation(data, theta, terms)
    fit = selection.fit
    return likeliest_evidence(linear, fit.scored_mse, fit.terms)


def _weighed(
    selection: Selection, evidence: Evidence, joint: int, motor: int, ratio: float
) -> UndeclaredCoupling | None:
    """A pair of joints with the evidence of a common motor; ``None`` if that closes too little on either."""
    every = evidence.terms.all
    # friction of the motor, and that which both joints may have beside what they share
    frictions = [t for t in every if t.definition.family == "friction"]
    shared = {t for t in frictions if t.definition.on_joint and t.joint == motor}
    alike = {t.definition.on_joint for t in shared}
    own = {t for t in frictions if t.effect in alike and t.joint in (joint, motor)}
    apart = evidence.fit_possible(selection.fit.terms | own)
    common = evidence.fit_possible(apart.terms | shared)
    if not common.terms & shared:
        return None
    places = [joint - 1, motor - 1]
    closed = 1.0 - _rms(evidence, common)[places] / _rms(evidence, apart)[places]
    if closed.min() < COUPLING_CLOSES:
        return None
    return UndeclaredCoupling(joint, motor, ratio, common.score - apart.score)


def _rms(evidence: Evidence, fit: Fit) -> np.ndarray:
    """RMS of the held-out gap of a fit over all folds [N m], (n,)."""
    mean_square = (fit.held_out_mse * evidence.rows).sum(axis=0)
    return np.asarray(np.sqrt(mean_square / evidence.rows.sum(axis=0)))
