"""Where to begin with a joint that rings or plays: its torque is too far from linear in stiffness and free play.

A link behind a soft or loose gear moves on its own. What that does to the torque is simulated on each joint for some
resonances and some widths, and compared with what is left of the gap; the best are starts for a fit around them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.state import State
from gapscope.diagnosis.thresholds import (
    COMPLIANCE_RATIO,
    COMPLIANCE_START_GAIN,
    DAMPING_RATIOS,
    PLAY_WIDTHS,
    RESONANCES,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.deflection import behind_elasticity, behind_play


@dataclass(frozen=True)
class Start:
    """A term with values to begin with.

    Attributes:
        term: elasticity or backlash of one joint.
        values: linear coordinates.
        gain: what these values explain of the gap that is left [nats].
    """

    term: Term
    values: np.ndarray
    gain: float


def starts(state: State) -> list[Start]:
    """The best start of each effect on each joint that neither rings nor plays yet, the most promising first."""
    evidence = state.evidence
    left2 = (state.fit.held_out_mse * evidence.rows).sum(axis=0) / (
        evidence.floor2 * evidence.rows
    ).sum(axis=0)
    if state.data.arm.encoder != "motor" or left2.max() < COMPLIANCE_RATIO**2:
        return []
    taken = {t.joint for t in state.fit.terms if not t.definition.locally_linear}
    free = [j for j in range(state.data.arm.n_joints) if j + 1 not in taken]
    bodies = _Bodies(state)
    best: dict[Term, Start] = {}
    for start in (start for j in free for start in _candidates(state, bodies, j)):
        if start.gain > COMPLIANCE_START_GAIN and (
            start.term not in best or start.gain > best[start.term].gain
        ):
            best[start.term] = start
    return sorted(best.values(), key=lambda start: -start.gain)


class _Bodies:
    """The bodies of the model so far, and the torque that they need on each segment."""

    def __init__(self, state: State) -> None:
        self.data = state.data
        corrected = CorrectedArm(self.data.arm, state.terms.effects(state.linear.theta))
        laden = [s.bodies(self.data.body) for s in self.data.segments]
        self.bodies = [corrected.body(body) for body in laden]
        self.scale = 1.0 / (1.0 + corrected.value("torque_scale", "scale"))
        self.torque = [
            corrected.rigid_torque(body, s.motion)
            for body, s in zip(laden, self.data.segments, strict=True)
        ]
        self.mass = np.mean(
            [
                np.diagonal(
                    body.sensitivities(s.motion.q, s.motion.dq, s.motion.ddq)[2],
                    axis1=1,
                    axis2=2,
                ).mean(0)
                for body, s in zip(self.bodies, self.data.segments, strict=True)
            ],
            axis=0,
        )

    def elastic(self, j: int, stiffness: float, damping: float) -> np.ndarray:
        """What elasticity of one joint adds to the torque on the rows of all segments [N m], (M, n)."""
        of = np.eye(self.data.arm.n_joints)[j]
        return self._rows(
            [
                behind_elasticity(body, s.motion, torque, stiffness * of, damping * of)
                - torque
                for body, s, torque in zip(
                    self.bodies, self.data.segments, self.torque, strict=True
                )
            ]
        )

    def loose(self, j: int, width: float) -> np.ndarray:
        """What free play of one joint adds to the torque on the rows of all segments [N m], (M, n)."""
        of, none = np.eye(self.data.arm.n_joints)[j], np.zeros(self.data.arm.n_joints)
        return self._rows(
            [
                behind_play(body, s.motion, torque, width * of, none, none) - torque
                for body, s, torque in zip(
                    self.bodies, self.data.segments, self.torque, strict=True
                )
            ]
        )

    def _rows(self, series: list[np.ndarray]) -> np.ndarray:
        rows = [
            self.data.thin(x, s)
            for x, s in zip(series, self.data.segments, strict=True)
        ]
        return np.vstack(rows) * self.scale


def _candidates(state: State, bodies: _Bodies, j: int) -> Iterator[Start]:
    """Starts of one joint."""
    elasticity, backlash = (
        state.terms.of(name)[j] for name in ("joint_elasticity", "backlash")
    )
    mass = bodies.mass[j]
    if mass <= 0:  # links found lighter than nothing, on the way to something better
        return
    for resonance in RESONANCES:
        stiffness = mass * (2 * np.pi * resonance) ** 2
        for ratio in DAMPING_RATIOS:
            damping = 2 * ratio * np.sqrt(stiffness * mass)
            values = np.array([1 / stiffness, damping / stiffness**2])
            yield Start(
                elasticity,
                values,
                state.linear.scan_residual.gain(bodies.elastic(j, stiffness, damping)),
            )
    torque = np.concatenate([x[:, j] for x in bodies.torque])
    if torque.min() < 0 < torque.max():
        for width in PLAY_WIDTHS:
            yield Start(
                backlash,
                np.array([width]),
                state.linear.scan_residual.gain(bodies.loose(j, width)),
            )
