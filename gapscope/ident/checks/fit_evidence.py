"""Input of the troubleshooting table: the data, the nominal arm, and the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import Recording
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.joint_zero import JointZeros
from gapscope.ident.model.law_choice import Choice
from gapscope.ident.model.physical_parameters import Physical
from gapscope.ident.signals.samples import Samples

_RIGID, _ROTOR, _VISCOUS, _DRY = range(4)
"""Places of a joint's parts of the torque, see ``_torque_parts``."""


@dataclass(frozen=True)
class FitEvidence:
    """What is known after a fit, or before it as far as the fit is ``None``.

    Attributes:
        recordings: what was fitted.
        samples: their samples in the band.
        choice: friction law, pull and noise.
        base: base parameters of the samples.
        matrix: W in the band, shape (M, n, p).
        beta: estimated base parameters, shape (b,).
        deviation: their standard deviation, shape (b,).
        physical: consistent parameters.
        zeros: encoder zeros.
    """

    recordings: Sequence[Recording]
    samples: Samples
    choice: Choice
    base: BaseParameters
    matrix: np.ndarray
    beta: np.ndarray
    deviation: np.ndarray
    physical: Physical
    zeros: JointZeros

    @property
    def fitted(self) -> np.ndarray:
        """Torque by beta in the band [N m], shape (M, n)."""
        return np.asarray(self.matrix[:, :, self.base.kept] @ self.beta)


@dataclass(frozen=True)
class NominalSimilarity:
    """How far the nominal rigid bodies explain the torque of joint j by the motion of joint i, friction left free.

    Attributes:
        gain: g of tau_j = g rigid_j + I ddq_j + b dq_j + c sgn dq_j + o [1], shape (n,).
        weight: share of the torque's variance that only the rigid bodies explain [1], shape (n,).
        loss: power that friction takes over the power of torque times speed [1], shape (n,); negative if it gives.
        explained: share of the variance of tau_j explained with the columns of joint i [1], shape (n, n), rows i.
        ratio: RMS of the recorded torque over that of the nominal arm [1], shape (n,).
    """

    gain: np.ndarray
    weight: np.ndarray
    loss: np.ndarray
    explained: np.ndarray
    ratio: np.ndarray


def nominal_similarity(samples: Samples) -> NominalSimilarity:
    """Compare recorded torque with the nominal arm's, joint by joint.

    For each joint i, its rigid-body torque, rotor inertia, viscous and Coulomb friction and a constant are fitted to
    the torque of every joint j by least squares.
    """
    torque = samples.torque
    n = torque.shape[1]
    parts = _torque_parts(samples)
    variance = torque.var(axis=0) + 1e-300
    gain, weight, loss = np.zeros(n), np.zeros(n), np.zeros(n)
    explained = np.zeros((n, n))
    for i in range(n):
        columns = parts[:, i]
        norm = np.linalg.norm(columns, axis=0)
        unit = np.where(norm > 0, norm, 1.0)
        scaled = columns / unit
        solution = np.linalg.lstsq(scaled, torque, rcond=1e-8)[0]
        explained[i] = 1 - (torque - scaled @ solution).var(axis=0) / variance
        value = solution[:, i] / unit
        gain[i] = value[_RIGID]
        rigid_alone = norm[_RIGID] ** 2 * _unexplained(scaled)
        weight[i] = gain[i] ** 2 * rigid_alone / variance[i]
        friction = columns[:, _VISCOUS] * value[_VISCOUS]
        friction = friction + columns[:, _DRY] * value[_DRY]
        speed = samples.velocity[:, i]
        power = float(np.abs(torque[:, i] * speed).mean())
        loss[i] = (friction * speed).mean() / max(power, 1e-300)
    # a wrong unit shows without any fit
    ratio = _torque_ratio(samples, parts)
    return NominalSimilarity(
        gain=gain,
        weight=weight,
        loss=loss,
        explained=explained,
        ratio=ratio,
    )


def _torque_parts(samples: Samples) -> np.ndarray:
    """Rigid-body torque, rotor acceleration, velocity, direction and 1 of each joint, shape (M, n, 5)."""
    columns, smooth = samples.columns, samples.smooth
    n = samples.torque.shape[1]
    links = columns.links
    rigid = smooth[:, :, :links] @ columns.body.inertial_parameters()
    # the joints' own columns are diagonal blocks behind those of the links: rotor inertia, then viscous friction
    rotor = np.einsum("mjj->mj", smooth[:, :, links : links + n])
    viscous = np.einsum("mjj->mj", smooth[:, :, links + n : links + 2 * n])
    size = columns.arm.per_radian
    dry = samples.filtered_each(lambda motion: smooth_sign(motion.dq / size))
    return np.stack([rigid, rotor, viscous, dry, np.ones_like(rigid)], axis=2)


def _unexplained(scaled: np.ndarray) -> float:
    """Mean square of the first column less its projection on the others."""
    first, others = scaled[:, 0], scaled[:, 1:]
    projection = others @ np.linalg.lstsq(others, first, rcond=1e-8)[0]
    return float(((first - projection) ** 2).mean())


def _torque_ratio(samples: Samples, parts: np.ndarray) -> np.ndarray:
    """RMS of recorded over nominal torque, (n,); NaN for joints that the nominal arm hardly loads."""
    arm = samples.columns.arm
    nominal = (
        parts[:, :, _RIGID]
        + parts[:, :, _DRY] * arm.coulomb
        + parts[:, :, _VISCOUS] * arm.viscous
        + parts[:, :, _ROTOR] * arm.armature
    )
    size = np.sqrt((nominal**2).mean(axis=0))
    recorded = np.sqrt((samples.torque**2).mean(axis=0))
    loaded = size > 0.05 * size.max()
    return np.where(loaded, recorded / np.maximum(size, 1e-9), np.nan)
