"""Neighbouring joints that share friction as the joints of one motor do, on an arm whose case declares no such motor.

A motor that turns joints j and k = j + 1 has friction of its own speed dq_k + r dq_j, r = 1 or -1, which no friction of
either joint can stand in for. Both signs are tried, for all pairs at once: a hypothetical coupling gives each motor k
the row e_k + r e_j, and the friction of these motors is weighed beside all that the search has found.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.diagnosis.selection.search import SheetSearch
from gapscope.diagnosis.thresholds import COUPLING_CLOSES
from gapscope.model.difference import Fit
from gapscope.model.terms import Candidate


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

    def entry(self) -> dict[str, Any]:
        """The entry ``coupling`` of a document."""
        joints = [self.joint, self.motor]
        return {
            "joints": joints,
            "declare": self.declaration,
            "log_evidence": self.gain,
        }


def undeclared_coupling(
    searching: SheetSearch, fit: Fit, open_joints: Collection[int]
) -> UndeclaredCoupling | None:
    """The pair of neighbours whose residual shows a common motor most clearly; ``None`` if no pair's does.

    Args:
        searching: the search of an arm without coupled motors.
        fit: what it found.
        open_joints: joints above their floor, from 1; both of a pair have to be.
    """
    pairs = [(j, j + 1) for j in open_joints if j + 1 in open_joints]
    if searching.arm.arm.coupled_motors or not pairs:
        # of declared motors friction is searched already
        return None
    found = []
    for ratio in (1.0, -1.0):
        # row k of the coupling is motor k: it turns by q_k + r q_j
        coupling = np.eye(searching.arm.arm.n_joints)
        for _, motor in pairs:
            coupling[motor - 1, motor - 2] = ratio
        # other columns, and so another noise: what was found is fitted again
        coupled = searching.with_motors(coupling)
        known = coupled.beside_known(fit)
        found += [_weighed(coupled, known, *pair, ratio) for pair in pairs]
    clear = [one for one in found if one is not None and one.gain > 0]
    return max(clear, key=lambda one: one.gain, default=None)


def _weighed(
    searching: SheetSearch, fit: Fit, joint: int, motor: int, ratio: float
) -> UndeclaredCoupling | None:
    """A pair of joints with the evidence of a common motor; ``None`` if that closes too little on either."""
    every = [one for one in fit.own.candidates if not one.everybody]
    frictions = [one for one in every if one.term.definition.family == "friction"]

    def on_motor(one: Candidate) -> bool:
        return bool(one.term.definition.on_joint) and one.term.joint == motor

    # friction of the motor, and that which both joints may have beside what they share
    shared = [one for one in frictions if on_motor(one)]
    alike = {one.term.definition.on_joint for one in shared}
    own = [
        one
        for one in frictions
        if one.effect in alike and one.term.joint in (joint, motor)
    ]
    # joints get friction of their own first: what differs is the motor's alone
    apart = searching.with_some([*fit.mine, *own], fit.values)
    common = searching.with_some([*apart.mine, *shared], apart.values)
    if not set(shared) & set(common.mine):
        return None
    # one motor turns both joints: on each of them less has to be left
    places = [joint - 1, motor - 1]
    left = [searching.torque_nrmse(one.left)[places] for one in (common, apart)]
    if (1.0 - left[0] / left[1]).min() < COUPLING_CLOSES:
        return None
    return UndeclaredCoupling(joint, motor, ratio, common.total - apart.total)
