"""The direction of gravity that the torque shows: its three components are linear in the torque of every joint.

tau_j - (bodies without gravity)_j = G_j(q) g + c_j sgn dq_j + b_j dq_j + o_j,  g of known size

G is the regressor of ``RigidBody.gravity_regressor``; friction and offset are each joint's own. A base that was
mounted in another way than the case says, or a wrong sign of its gravity, is found without a search this way.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.environment import tilt
from gapscope.model.conditioning import Segment, thinned, torque_scale
from gapscope.model.rows import MODEL_RATE
from gapscope.model.torque_gap import torque_gap

GRAVITY_SIZE_FACTOR = 2.0
"""A vector fitted in gravity's place counts as gravity if its size is right within this factor [1]: inertials and
torque scales are off by less. (hand)"""
MIN_TURN = 0.4
"""Gravity off by less than this is a tilt, which a linearised search finds [rad]. (hand)"""
TURNED_BASE_FALL = 0.6
"""An arm that hangs or is mounted sideways is believed if that lowers the squared gap by this share [1]: nothing else
comes near. (hand)"""


def gravity_by_torque(
    torque: np.ndarray, regressor: np.ndarray, dq: np.ndarray, deviation: np.ndarray
) -> np.ndarray:
    """Gravity in the base frame [m/s^2], (3,), by least squares over all joints, each over its torque's deviation.

    Args:
        torque: recorded torque less what the nominal bodies need without gravity [N m], (M, n).
        regressor: G(q) [kg m], (M, n, 3).
        dq: [rad/s], (M, n).
        deviation: standard deviation of each joint's torque [N m], (n,).
    """
    gram, target = np.zeros((3, 3)), np.zeros(3)
    for j, size in enumerate(deviation):
        own = [smooth_sign(dq[:, j]), dq[:, j], np.ones(len(dq))]
        basis, _ = np.linalg.qr(np.column_stack(own))
        x, y = regressor[:, j] / size, torque[:, j] / size
        # what the joint's own friction and offset explain is taken out of both sides
        x, y = x - basis @ (basis.T @ x), y - basis @ (basis.T @ y)
        gram += x.T @ x
        target += x.T @ y
    # directions that no joint shows stay zero
    return np.linalg.lstsq(gram, target, rcond=1e-6)[0]


def turn_of_base(nominal: np.ndarray, found: np.ndarray) -> tuple[float, float] | None:
    """Roll and pitch [rad] of the base with R^T nominal along ``found``, R = Ry(pitch) Rx(roll).

    ``None`` if ``found`` is no gravity, its size off by more than ``GRAVITY_SIZE_FACTOR``; if it is turned by less than
    ``MIN_TURN``; or if no turn comes near it.

    Args:
        nominal: gravity in the base frame as the case has it [m/s^2], (3,).
        found: as the torque shows it [m/s^2], (3,).
    """
    size, size_found = np.linalg.norm(nominal), np.linalg.norm(found)
    if size == 0 or size_found == 0:
        return None
    if abs(np.log(size_found / size)) > np.log(GRAVITY_SIZE_FACTOR):
        return None
    direction = found / size_found
    if nominal @ direction / size > np.cos(MIN_TURN):
        return None

    def miss(turn: np.ndarray) -> np.ndarray:
        return tilt(*turn).T @ nominal / size - direction

    # the nearest of a coarse grid first: there are several minima
    starts = itertools.product(np.arange(-3, 4) * np.pi / 3, (-1.0, 0.0, 1.0))
    nearest = min(starts, key=lambda turn: float(np.sum(miss(np.array(turn)) ** 2)))
    bounds = np.array([np.pi, np.pi / 2])
    best = least_squares(miss, nearest, bounds=(-bounds, bounds))
    # what no turn of the base comes nearer to
    if np.linalg.norm(best.fun) > MIN_TURN:
        return None
    roll, pitch = best.x.tolist()
    return roll, pitch


def as_mounted(arm: NominalArm, segments: Sequence[Segment]) -> NominalArm:
    """The arm with the gravity that its torque shows, if its base is mounted turned."""
    segments = [thinned(s, MODEL_RATE) for s in segments if s.torque is not None]
    before = _gap(arm, segments) if segments else None
    if before is None:
        return arm
    body, predicting = RigidBody(arm), CorrectedArm(arm)
    torque, regressor, speed = [], [], []
    for segment in segments:
        motion, own = segment.motion, segment.bodies(body)
        assert segment.torque is not None
        of_gravity = own.gravity_regressor(motion.q)
        predicted = predicting.predict(own, motion)
        # what the arm needs but for gravity is taken off
        torque.append(segment.torque - predicted + of_gravity @ arm.gravity)
        regressor.append(of_gravity)
        speed.append(motion.dq)
    every = np.concatenate(torque), np.concatenate(regressor), np.concatenate(speed)
    deviation = torque_scale(np.concatenate([np.asarray(s.torque) for s in segments]))
    found = gravity_by_torque(*every, deviation)
    if turn_of_base(arm.gravity, found) is None:
        return arm
    # the size of gravity is known: only its direction is news
    found *= np.linalg.norm(arm.gravity) / np.linalg.norm(found)
    turned = replace(arm, gravity=found)
    after = _gap(turned, segments)
    fell = after is not None and after <= (1.0 - TURNED_BASE_FALL) * before
    return turned if fell else arm


def _gap(arm: NominalArm, segments: list[Segment]) -> float | None:
    """Squared gap of an arm, over the torque's variance, summed over joints [1]; ``None`` if it is not finite."""
    try:
        gap = torque_gap(CorrectedArm(arm), RigidBody(arm), segments).nrmse
    except (GapscopeError, ValueError):
        return None
    size = float((gap**2).sum())
    return size if np.isfinite(size) else None
