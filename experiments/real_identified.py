"""What an arm's model leaves, and the arm that is identified, for the benchmark of real arms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from real_case_files import write_piece
from real_motion import at_samples, smooth_motion

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.nominal import smooth_sign
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.identification import IdentificationSettings
from gapscope.ident.output.identified_arm import (
    effects,
    identified_bodies,
    sheet,
    urdf_text,
)
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    condition,
    low_pass,
    position_cutoff,
)
from gapscope.model.torque_gap import torque_gap, torque_scale

SMALLEST_DIRECTION = 3e-3
"""Singular values below this share of the largest are directions that a motion does not show [1]."""
BLOCKS = 10
"""Blocks of time, every other one of which belongs to the same half, for what a full model leaves."""


def identified(case: Case, other: Case, folder: Path) -> None:
    """Identify the arm of a case, and write another case of the same arm with it as the nominal one.

    What a data sheet cannot state, constant offsets and Stribeck friction, is taken off the torque of the other case,
    so that it is healthy as far as the identified arm is right.

    Args:
        case: recordings to identify from.
        other: recordings that the new case gets.
        folder: of the new case.
    """
    # judged by its last recording, but fitted to all
    case = replace(case, judged=case.recordings[-1:])
    result = gapscope.identify(case, IdentificationSettings(plain=True)).identification
    urdf = folder.parent / f".{folder.name}.urdf"
    with atomic_write(urdf) as aside:
        aside.write_text(
            urdf_text(result.case.arm, identified_bodies(result)), encoding="utf-8"
        )
    stated = sheet(result)
    # the other case declares the same coupled motors
    stated.pop("coupling", None)
    given = {k: np.array(v) for k, v in stated.items() if isinstance(v, list)}
    arm = replace(other.arm, urdf=urdf, **given)
    plain, full = CorrectedArm(arm), CorrectedArm(arm, effects(result))
    body = RigidBody(arm)
    recordings = []
    for recording in other.recordings:
        motion = smooth_motion(recording)
        extra = full.predict(body, motion) - plain.predict(body, motion)
        torque = np.asarray(recording.tau) - at_samples(extra, motion, recording.t)
        recordings.append(replace(recording, tau=torque))
    healthy = replace(other, arm=arm, recordings=tuple(recordings))
    write_piece(healthy, folder)
    urdf.unlink()


def model_residual(case: Case) -> np.ndarray:
    """RMS that a full least-squares model leaves on the half that it was not fitted to [N m], (n,).

    All inertial parameters, rotor, viscous and Coulomb friction and offset of each joint, as a change from the nominal
    bodies; joints weighted by their torque's deviation; the longest recording in two halves of alternate blocks of
    time, each half judged once.
    """
    longest = max(case.recordings, key=lambda r: r.duration)
    segments = condition(longest, position_cutoff((longest,)))
    body = RigidBody(case.arm)
    matrices, targets = [], []
    for segment in segments:
        m, inner = segment.motion, segment.inner
        own = [m.ddq, m.dq, smooth_sign(m.dq), np.ones_like(m.q)]
        joints = [x[:, :, None] * np.eye(case.arm.n_joints) for x in own]
        links = body.regressor(m.q, m.dq, m.ddq)
        matrix = np.concatenate([links, *joints], axis=2)
        gap = segment.torque - links @ body.inertial_parameters()
        matrices.append(low_pass(matrix, m.rate, TORQUE_CUTOFF)[inner])
        targets.append(low_pass(gap, m.rate, TORQUE_CUTOFF)[inner])
    matrix, target = np.concatenate(matrices), np.concatenate(targets)
    scale = torque_scale(target)
    odd = np.arange(len(target)) * BLOCKS // len(target) % 2 == 1
    squares = np.zeros(case.arm.n_joints)
    for fit, judge in ((odd, ~odd), (~odd, odd)):
        value = _least_squares(matrix[fit], target[fit], scale)
        squares += ((target[judge] - matrix[judge] @ value) ** 2).sum(axis=0)
    return np.sqrt(squares / len(target))


def left(case: Case) -> np.ndarray:
    """RMS of the torque gap of a case's nominal arm on its first recording [N m], (n,)."""
    segments = condition(case.recordings[0], position_cutoff(case.recordings))
    return torque_gap(CorrectedArm(case.arm), RigidBody(case.arm), segments).rmse


def _least_squares(
    matrix: np.ndarray, target: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Weighted least squares of minimum norm in columns of equal length: matrix (N, n, p), target (N, n)."""
    weighted = (matrix / scale[:, None]).reshape(-1, matrix.shape[2])
    norms = np.linalg.norm(weighted, axis=0)
    norms[norms < 1e-9 * norms.max()] = np.inf
    value = np.linalg.lstsq(
        weighted / norms, (target / scale).ravel(), rcond=SMALLEST_DIRECTION
    )[0]
    return value / norms
