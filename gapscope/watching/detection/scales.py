"""How large changes of each parameter are, by which it may wander, and what the error of the model is worth in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.ident.kalman.online.block import LEAST_NOISE, Equations
from gapscope.watching.detection.watched_arm import WatchedArm
from gapscope.watching.thresholds import (
    FORM_ANGLE,
    FORM_FRICTION,
    FORM_INERTIA,
    FORM_TORQUE,
    PRIOR_ANGLE,
    PRIOR_INERTIA,
    PRIOR_TORQUE,
    WALK_FRICTION,
    WALK_HORIZON,
)

TORQUES = "Ibco"
"""First letters of parameters of joints whose scale is a torque: rotor, viscous and Coulomb friction, offset."""
WARMING = "bco"
"""First letters of those that wander as the arm warms up."""


@dataclass(frozen=True)
class Scales:
    """Standard deviations of p parameters, each in its unit, and torque levels of n joints.

    Attributes:
        prior: of what may be wrong from the start, and of a plausible change, shape (p,).
        form: by which values that fit two motions best differ without a change, (p,).
        walk: by which they wander in a second [1/sqrt(s)], (p,).
        torque: RMS of the recorded torque [N m], (n,).
        friction: RMS of the friction torque [N m], (n,).
        speed: RMS speed while the joint moves [rad/s], (n,).
    """

    prior: np.ndarray
    form: np.ndarray
    walk: np.ndarray
    torque: np.ndarray
    friction: np.ndarray
    speed: np.ndarray

    @classmethod
    def of(
        cls, arm: WatchedArm, blocks: Sequence[Equations], friction: np.ndarray
    ) -> Scales:
        """The scales on the motion of some blocks.

        Args:
            arm: that is watched.
            blocks: of the motion that is learnt from.
            friction: RMS of the friction torque on it [N m], (n,).
        """
        torque = _rms([block.rms(block.torque) for block in blocks])
        speed = _rms([block.rms(block.velocity) for block in blocks])
        torque = np.maximum(torque, LEAST_NOISE * max(float(torque.max()), 1e-6))
        n = arm.arm.n_joints
        # what a unit of each parameter does to its own joint's torque, RMS
        columns = [np.einsum("kja->ja", block.matrix**2) for block in blocks]
        count = sum(len(block.gap) for block in blocks)
        unit = np.sqrt(sum(columns) / count)
        inertial = arm.columns.scale(arm.law)
        size = len(arm.names)
        load = range(10 * arm.body.last_link, 10 * arm.body.last_link + 4)
        prior, form, walk = np.zeros(size), np.zeros(size), np.zeros(size)
        for place, name in enumerate(arm.names):
            if name[0] == "e":
                prior[place], form[place] = PRIOR_ANGLE, FORM_ANGLE
            elif place < 10 * n:
                prior[place] = PRIOR_INERTIA * inertial[place]
                if place in load and unit[:, place].any():
                    # a load may be heavier than the link that carries it
                    carried = float(np.hypot.reduce(unit[:, place]))
                    heavy = PRIOR_TORQUE * float(np.hypot.reduce(torque)) / carried
                    prior[place] = max(prior[place], heavy)
                form[place] = FORM_INERTIA * inertial[place]
                walk[place] = form[place] / np.sqrt(WALK_HORIZON)
            else:
                joint = int(name.strip("Ibcom")) - 1
                gain = float(unit[joint, place])
                # a joint that never moved says nothing: any scale will do
                per_torque = 1.0 / gain if gain > 0 else 1.0
                prior[place] = PRIOR_TORQUE * torque[joint] * per_torque
                by_form = np.hypot(
                    FORM_FRICTION * friction[joint], FORM_TORQUE * torque[joint]
                )
                form[place] = by_form * per_torque
                walk[place] = form[place] / np.sqrt(WALK_HORIZON)
                if name[0] in WARMING:
                    walk[place] = WALK_FRICTION * friction[joint] * per_torque
        return cls(prior, form, walk, torque, friction, speed)


def _rms(series: Sequence[np.ndarray]) -> np.ndarray:
    """Root of the mean of squares over the blocks in which a joint moved, shape (n,)."""
    stacked = np.array(series)
    count = np.maximum((stacked > 0).sum(axis=0), 1)
    return np.sqrt((stacked**2).sum(axis=0) / count)
