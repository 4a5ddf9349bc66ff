"""The torque that an arm leaves on a piece of a recording, and what small changes of its parameters would add."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.kalman.online.block import Equations
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals.samples import Band
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, thinned
from gapscope.watching.thresholds import MOVING, RATE

REMEMBERED = 2**20
"""Results of rigid bodies that are kept [bytes]: no motion of a stream comes twice."""


class WatchedArm:
    """The arm that is watched, with the columns of what may change on it.

    The columns are those of identification (``ModelColumns``: links, rotors, friction, offsets), and for each joint
    ``e``: an encoder that reads more by delta lets the arm need -(d tau / d q) delta beside its prediction.

    Args:
        corrected: the arm with its effects.

    Attributes:
        names: of the parameters, shape (p,).
        combination: the identity, shape (p, p): hypotheses are about the parameters themselves.
        columns: the model.
    """

    def __init__(self, corrected: CorrectedArm) -> None:
        self.corrected = corrected
        self.arm = corrected.arm
        self.body = RigidBody(self.arm, REMEMBERED)
        self.columns = ModelColumns(self.arm, self.body)
        self.law = FrictionLaw()
        joints = range(1, self.arm.n_joints + 1)
        encoders = tuple(f"e{joint}" for joint in joints)
        self.names = (*self.columns.names(self.law), *encoders)
        self.combination = np.eye(len(self.names))
        none = np.zeros(self.arm.n_joints)
        bare = replace(self.arm, coulomb=none, viscous=none)
        others = tuple(e for e in corrected.effects if e.effect.family != "friction")
        self._frictionless = CorrectedArm(bare, others)

    def places(self, symbol: str) -> np.ndarray:
        """Places of a parameter of all joints, such as ``c``; shape (n,)."""
        joints = range(1, self.arm.n_joints + 1)
        return np.array([self.names.index(f"{symbol}{joint}") for joint in joints])

    def equations(self, segment: Segment) -> Equations:
        """Gap and columns of a segment with torque, in the band of the torque gap, thinned to what the band holds."""
        segment = thinned(segment, RATE)
        motion, body = segment.motion, segment.bodies(self.body)
        # a torque in saturation says what reached the joint
        recorded = self.corrected.delivered(np.asarray(segment.torque))
        predicted = self.corrected.unlimited.predict(body, motion)
        recorded, gap, W = (
            _in_band(series, segment)
            for series in (recorded, recorded - predicted, self._columns(motion))
        )
        velocity = _kept(motion.dq, segment)
        moving = np.abs(velocity) > MOVING * self.arm.per_radian
        return Equations(
            matrix=W * moving[..., None],
            gap=gap * moving,
            moving=moving,
            torque=recorded,
            velocity=velocity,
        )

    def friction(self, segment: Segment) -> np.ndarray:
        """Friction torque that the arm is believed to have at the samples of a segment's equations [N m], (M, n)."""
        segment = thinned(segment, RATE)
        body = segment.bodies(self.body)
        whole = self.corrected.unlimited.predict(body, segment.motion)
        without = self._frictionless.unlimited.predict(body, segment.motion)
        return _in_band(whole - without, segment)

    def _columns(self, motion: Motion) -> np.ndarray:
        """W of a motion, shape (N, n, p)."""
        by_position, _, _ = self.body.sensitivities(motion.q, motion.dq, motion.ddq)
        model = self.columns.matrix(motion, self.law)
        return np.concatenate([model, -by_position], axis=2)


def _band(segment: Segment) -> Band:
    return Band(min(TORQUE_CUTOFF, 0.4 * segment.motion.rate))


def _kept(series: np.ndarray, segment: Segment) -> np.ndarray:
    """A series of a segment, trimmed and thinned."""
    band = _band(segment)
    return series[band.rows(segment)][:: band.step(segment)]


def _in_band(series: np.ndarray, segment: Segment) -> np.ndarray:
    """A series of a segment in the band, trimmed and thinned; a copy."""
    band = _band(segment)
    return band.filtered(series, segment)[:: band.step(segment)].copy()
