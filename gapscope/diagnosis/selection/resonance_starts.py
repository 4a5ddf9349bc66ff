"""Starts for compliant joints: elasticity and backlash are too nonlinear to linearise around none of it.

A link behind a soft or loose gear moves on its own. What that does to the torque is simulated on each joint for some
resonances and some widths of free play, and compared with the residual; the best are starting values of a fit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.fitted_model import Model
from gapscope.diagnosis.thresholds import (
    COMPLIANCE_RATIO,
    COMPLIANCE_START_GAIN,
    DAMPING_RATIOS,
    PLAY_WIDTHS,
    RESONANCES,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.deflection import Matrices, through_springs
from gapscope.effects.free_play import through_play


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
    bodies, best = CompliantBodies(model), dict[Term, Start]()
    for joint in sorted(looked_at):
        j = joint - 1
        for start in chain(_elastic(model, bodies, j), _loose(model, bodies, j)):
            known = best[start.term].gain if start.term in best else 0.0
            if start.gain > max(known, COMPLIANCE_START_GAIN):
                best[start.term] = start
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


class CompliantBodies:
    """The bodies of a model, and what compliance of one joint would do to their torque.

    Attributes:
        torque: torque that the bodies need on each segment [N m], (N, n).
        mass: inertia that each joint moves, mean over the recordings [kg m^2 or kg], (n,).
    """

    def __init__(self, model: Model) -> None:
        self.data = model.data
        self._segments, n = self.data.segments, self.data.arm.n_joints
        self._unit = np.eye(n)
        arm = CorrectedArm(self.data.arm, model.terms.effects(model.linear.theta))
        laden = [s.bodies(self.data.body) for s in self._segments]
        bodies = [arm.body(body) for body in laden]
        # recorded is what reaches the joint over the scale of its torque
        self._recorded = 1.0 / (1.0 + arm.value("torque_scale", "scale"))
        self.torque = [
            arm.rigid_torque(body, s.motion)
            for body, s in zip(laden, self._segments, strict=True)
        ]
        self._matrices = [
            body.sensitivities(s.motion.q, s.motion.dq, s.motion.ddq)
            for body, s in zip(bodies, self._segments, strict=True)
        ]
        inertias = [
            np.diagonal(mass, axis1=1, axis2=2).mean(axis=0)
            for _, _, mass in self._matrices
        ]
        self.mass = np.mean(inertias, axis=0)

    def elastic(self, j: int, stiffness: float, damping: float) -> np.ndarray:
        """What elasticity of one joint adds to the torque on the rows of all segments [N m], (M, n)."""
        on_joint = self._unit[j]
        series = [
            through_springs(
                matrices, rate, torque, stiffness * on_joint, damping * on_joint
            )
            for matrices, rate, torque in self._by_segment()
        ]
        return self._added(series)

    def loose(self, j: int, width: float) -> np.ndarray:
        """What free play of one joint adds to the torque on the rows of all segments [N m], (M, n)."""
        on_joint, none = self._unit[j], np.zeros(len(self._unit))
        series = [
            through_play(matrices, rate, torque, width * on_joint, none, none)
            for matrices, rate, torque in self._by_segment()
        ]
        return self._added(series)

    def _by_segment(self) -> Iterator[tuple[Matrices, float, np.ndarray]]:
        rates = [s.motion.rate for s in self._segments]
        return zip(self._matrices, rates, self.torque, strict=True)

    def _added(self, series: list[np.ndarray]) -> np.ndarray:
        """Torque of each segment less that of rigid joints, on the rows as recorded."""
        rows = [
            self.data.thin(torque - rigid, s)
            for torque, rigid, s in zip(
                series, self.torque, self._segments, strict=True
            )
        ]
        return np.vstack(rows) * self._recorded


def _elastic(model: Model, bodies: CompliantBodies, j: int) -> Iterator[Start]:
    """Starts of one joint's elasticity: resonances of what it moves, with some damping ratios."""
    term, mass = model.terms.of("joint_elasticity")[j], bodies.mass[j]
    # intermediate links may have negative mass
    if mass <= 0:
        return
    for resonance in RESONANCES:
        stiffness = mass * (2 * np.pi * resonance) ** 2
        for ratio in DAMPING_RATIOS:
            damping = 2 * ratio * np.sqrt(stiffness * mass)
            values = np.array([1 / stiffness, damping / stiffness**2])
            torque = bodies.elastic(j, stiffness, damping)
            yield Start(term, values, model.linear.scan_residual.gain(torque))


def _loose(model: Model, bodies: CompliantBodies, j: int) -> Iterator[Start]:
    """Starts of one joint's backlash; none if the torque never changes its sign, as the gear then stays on one side."""
    needed = np.concatenate([torque[:, j] for torque in bodies.torque])
    if bodies.mass[j] <= 0 or not needed.min() < 0 < needed.max():
        return
    term = model.terms.of("backlash")[j]
    for width in PLAY_WIDTHS:
        gain = model.linear.scan_residual.gain(bodies.loose(j, width))
        yield Start(term, np.array([width]), gain)
