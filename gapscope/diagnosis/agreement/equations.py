"""Normal equations of tau = W beta by stretch of time and joint, all that a comparison of recordings needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    AGREEMENT_SAMPLES,
    AGREEMENT_STRETCH,
    LEAST_STRETCHES,
    MOST_STRETCHES,
    STICKING_SPEED,
)
from gapscope.ident.estimators.linear_estimator import joint_noise
from gapscope.ident.estimators.partial_update import PartialUpdate, default_spread
from gapscope.ident.model.base_parameters import BaseParameters, base_parameters
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.law_choice import choose
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    position_cutoff,
)
from gapscope.ident.signals.effective_samples import variance_inflation
from gapscope.ident.signals.samples import Band, Samples
from gapscope.model.torque_gap import torque_scale

LEAST_NOISE = 1e-4
"""Noise of a joint is at least this share of its torque's scale [1]: recordings without noise have finite weights."""
LEAST_FREE = 0.25
"""A fit is taken to leave at least this share of the independent samples free [1]."""


@dataclass(frozen=True)
class Equations:
    """Weighted normal equations of K stretches, n joints, b base parameters, from R recordings.

    The weight of a joint in a recording is 1 / (s^2 f): s^2 the mean square that the recording's own fit leaves, and
    f = 1 + 2 sum rho_k, by how many samples of that residual count as one. A joint's samples at which it rests are
    left out: dry friction may take any value there.

    Attributes:
        gram: sum of w W_j^T W_j, (K, n, b, b).
        right: sum of w W_j^T tau_j, (K, n, b).
        recording: number of the recording of each stretch, (K,).
        power: mean of W_j^T W_j over the square of the joint's torque scale, (n, b, b).
        speed: mean |dq| of each joint in each recording [rad/s], (R, n).
        load: mean |torque of the rigid bodies| there [N m], (R, n).
        base: the base parameters of all recordings together.
        units: of the base parameters, (b,).
        value: of the base parameters, all recordings together, (b,).
        spread: standard deviation that they have before any recording, (b,).
        columns, law: the model.
    """

    gram: np.ndarray
    right: np.ndarray
    recording: np.ndarray
    power: np.ndarray
    speed: np.ndarray
    load: np.ndarray
    base: BaseParameters
    units: tuple[str, ...]
    value: np.ndarray
    spread: np.ndarray
    columns: ModelColumns
    law: FrictionLaw

    @property
    def count(self) -> int:
        """Number R of recordings."""
        return int(self.recording[-1]) + 1


def equations(case: Case, recordings: Sequence[Recording]) -> Equations:
    """Equations of recordings with torque.

    Raises:
        InputError: a recording is too short, or there are too few samples.
    """
    samples, owner = _samples(case, recordings)
    columns, law = samples.columns, choose(samples, presliding=False).law
    recording = owner[samples.group]
    moves = np.abs(samples.velocity) > STICKING_SPEED * case.arm.per_radian
    full = samples.matrix(law) * moves[:, :, None]
    torque = samples.torque * moves
    base = base_parameters(full.reshape(-1, full.shape[2]), columns.names(law))
    names = [base.names[k] for k in base.kept]
    matrix = full[:, :, base.kept]
    problem = Problem(matrix, torque, names, samples.group, samples.interval)
    value = PartialUpdate(base.of(columns.nominal(law))).estimate(problem).value
    spread = default_spread(problem, value)
    scale = torque_scale(samples.torque)
    weight = _weights(problem, recording, moves, value, spread, scale)
    gram, right, of_stretch = _by_stretch(problem, recording, weight)
    relative = matrix / scale[:, None]
    inertial = np.array([k < columns.links for k in base.kept])
    body_torque = np.abs(matrix[:, :, inertial] @ value[inertial])
    numbers = range(len(recordings))
    units = columns.units(law)
    return Equations(
        gram=gram,
        right=right,
        recording=of_stretch,
        power=np.einsum("mja,mjb->jab", relative, relative, optimize=True)
        / len(matrix),
        speed=np.array(
            [np.abs(samples.velocity[recording == r]).mean(axis=0) for r in numbers]
        ),
        load=np.array([body_torque[recording == r].mean(axis=0) for r in numbers]),
        base=base,
        units=tuple(units[k] for k in base.kept),
        value=value,
        spread=spread,
        columns=columns,
        law=law,
    )


def _samples(case: Case, recordings: Sequence[Recording]) -> tuple[Samples, np.ndarray]:
    """Samples of all recordings in one band, and the number of the recording of each segment."""
    cutoff = min(position_cutoff(tuple(recordings)), TORQUE_CUTOFF)
    band = Band(cutoff)
    segments: list[Segment] = []
    owner: list[int] = []
    # one by one: pieces of one file may share a name
    for number, recording in enumerate(recordings):
        own = band.segments([recording])
        segments += own
        owner += [number] * len(own)
    columns = ModelColumns(case.arm)
    bounded = band.bounded(segments, AGREEMENT_SAMPLES)
    return Samples(columns, segments, bounded), np.array(owner)


def _weights(
    problem: Problem,
    recording: np.ndarray,
    moves: np.ndarray,
    value: np.ndarray,
    spread: np.ndarray,
    scale: np.ndarray,
) -> np.ndarray:
    """Weight of each joint in each recording [1/(N m)^2], (R, n).

    Each recording is fitted alone, what it does not determine held at the value of all together.
    """
    weights = np.zeros((recording[-1] + 1, problem.n_joints))
    for number in range(len(weights)):
        rows = recording == number
        moving = moves[rows].mean(axis=0)
        if not moving.any():
            continue
        own = problem.rows(rows)
        estimate = PartialUpdate(value, spread).estimate(own)
        residual = own.residual(estimate.value)
        inflation = variance_inflation(residual, own.group)
        # the fit took up some of the independent samples
        taken = len(value) / (moving * len(residual) / inflation).sum()
        noise = joint_noise(own, estimate.value) / np.sqrt(np.maximum(moving, 1e-9))
        noise = np.maximum(noise, LEAST_NOISE * scale)
        variance = noise**2 / max(1.0 - taken, LEAST_FREE)
        weights[number] = np.where(moving > 0, 1.0 / (variance * inflation), 0.0)
    return weights


def _by_stretch(
    problem: Problem, recording: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gram matrices and right sides of stretches of about ``AGREEMENT_STRETCH``, and the recording of each."""
    grams, rights, owners = [], [], []
    for number, own in enumerate(weight):
        rows = np.flatnonzero(recording == number)
        seconds = len(rows) * problem.interval
        parts = round(seconds / AGREEMENT_STRETCH)
        for part in np.array_split(
            rows, np.clip(parts, LEAST_STRETCHES, MOST_STRETCHES)
        ):
            matrix = problem.matrix[part] * np.sqrt(own)[:, None]
            torque = problem.torque[part] * np.sqrt(own)
            by_joint = matrix.transpose(1, 2, 0)
            grams.append(by_joint @ by_joint.transpose(0, 2, 1))
            rights.append(np.einsum("jam,mj->ja", by_joint, torque))
            owners.append(number)
    return np.array(grams), np.array(rights), np.array(owners)
