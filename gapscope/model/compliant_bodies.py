"""What compliance of a joint would do to the torque of the bodies, simulated once for all that is asked of it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.deflection import Matrices
from gapscope.effects.effect import Transmission
from gapscope.model.decimated_segments import DecimatedSegments


class CompliantBodies:
    """The bodies of an arm, and what compliance of one joint would do to their torque.

    A search asks for the same resonances and widths of free play again and again; each is simulated once.

    Args:
        data: the segments.
        body: dynamics of the nominal arm.
        arm: the arm; of its effects only those on the bodies count.

    Attributes:
        torque: torque that the bodies need on each segment [N m], (N, n).
        mass: inertia that each joint moves, mean over the recordings [kg m^2 or kg], (n,).
    """

    def __init__(
        self, data: DecimatedSegments, body: RigidBody, arm: CorrectedArm
    ) -> None:
        self._data, self._segments = data, data.segments
        self._unit = np.eye(arm.arm.n_joints)
        laden = [s.bodies(body) for s in self._segments]
        pairs = list(zip(laden, self._segments, strict=True))
        self.torque = [arm.rigid_torque(one, s.motion) for one, s in pairs]
        self._matrices = [
            arm.body(one).sensitivities(s.motion.q, s.motion.dq, s.motion.ddq)
            for one, s in pairs
        ]
        inertias = [
            np.diagonal(mass, axis1=1, axis2=2).mean(axis=0)
            for _, _, mass in self._matrices
        ]
        self.mass = np.mean(inertias, axis=0)
        self._known: dict[tuple[str | float, ...], np.ndarray] = {}

    def added(self, effect: Transmission, j: int, x: np.ndarray) -> np.ndarray:
        """What a transmission of one joint, from 0, adds to the torque on the rows of all segments [N m], (M, n).

        Args:
            effect: elasticity, free play or the like.
            j: the joint.
            x: linear coordinates of the effect, (linear,).
        """
        key = (effect.name, j, *x.tolist())
        if key not in self._known:
            values = effect.values_at(x[:, None]).values()
            own = [value * self._unit[j] for value in values]
            added = [
                effect.behind(matrices, rate, torque, *own) - torque
                for matrices, rate, torque in self._by_segment()
            ]
            self._known[key] = self._data.rows(added).astype(np.float32)
        return self._known[key]

    def _by_segment(self) -> Iterator[tuple[Matrices, float, np.ndarray]]:
        rates = [s.motion.rate for s in self._segments]
        return zip(self._matrices, rates, self.torque, strict=True)
