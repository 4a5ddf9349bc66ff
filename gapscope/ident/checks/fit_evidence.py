"""What the troubleshooting table looks at: the data, the nominal arm, and the fit."""

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
    """Compare recorded torque with the nominal arm's, joint by joint."""
    columns, torque, n = samples.columns, samples.torque, samples.torque.shape[1]
    smooth = samples.smooth
    rigid = smooth[:, :, : columns.links] @ columns.body.inertial_parameters()
    own = [
        np.einsum(
            "mjj->mj", smooth[:, :, columns.links + k * n : columns.links + (k + 1) * n]
        )
        for k in range(2)
    ]
    dry = samples.filtered_each(lambda motion: smooth_sign(motion.dq))
    parts = np.stack([rigid, *own, dry, np.ones_like(torque)], axis=2)
    gain, weight, loss = (np.zeros(n) for _ in range(3))
    explained = np.zeros((n, n))
    variance = torque.var(axis=0) + 1e-300
    for i in range(n):
        unit = np.linalg.norm(parts[:, i], axis=0)
        scaled = parts[:, i] / np.where(unit > 0, unit, 1.0)
        solution = np.linalg.lstsq(scaled, torque, rcond=1e-8)[0]
        explained[i] = 1 - (torque - scaled @ solution).var(axis=0) / variance
        value = solution[:, i] / np.where(unit > 0, unit, 1.0)
        rest = (
            scaled[:, 1:] @ np.linalg.lstsq(scaled[:, 1:], scaled[:, 0], rcond=1e-8)[0]
        )
        gain[i] = value[0]
        weight[i] = (
            value[0] ** 2
            * unit[0] ** 2
            * ((scaled[:, 0] - rest) ** 2).mean()
            / variance[i]
        )
        friction = parts[:, i, 2] * value[2] + parts[:, i, 3] * value[3]
        speed = samples.velocity[:, i]
        loss[i] = (friction * speed).mean() / max(
            float(np.abs(torque[:, i] * speed).mean()), 1e-300
        )
    nominal = (
        rigid
        + (dry * columns.arm.coulomb)
        + own[1] * columns.arm.viscous
        + own[0] * columns.arm.armature
    )
    size = np.sqrt((nominal**2).mean(axis=0))
    ratio = np.sqrt((torque**2).mean(axis=0)) / np.maximum(size, 1e-9)
    loaded = size > 0.05 * size.max()
    return NominalSimilarity(
        gain, weight, loss, explained, np.where(loaded, ratio, np.nan)
    )
