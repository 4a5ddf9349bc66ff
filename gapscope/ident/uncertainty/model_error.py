"""Model error distinguished from noise: the residual at the frequencies of the motion against those above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from gapscope.ident.model.linear_problem import Problem
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.effective_samples import group_slices

LOW, FLOOR = 1 / 4, (1 / 3, 1 / 2)
"""Bands of the motion and of the noise floor, as shares of the cut-off: up to 3 Hz and 4 to 6 Hz at 12 Hz."""
DOUBT = 1e-3
"""Chance, over all joints, below which noise alone is not believed."""
MATERIAL = 0.05
"""Share of the torque's deviation from which on model error is worth a warning, if it exceeds the noise [1]."""
TAPER = 0.1
"""Share of a series that is faded in and out before its spectrum is taken."""


@dataclass(frozen=True)
class ModelError:
    """The part of the residuals that is not noise, per joint.

    Attributes:
        systematic: standard deviation of the part that follows the motion [N m], shape (n,).
        noise: standard deviation of the rest [N m], shape (n,).
        p_value: how often noise alone would look like this, shape (n,).
        groups: number of groups that showed it.
        torque: standard deviation of the torque [N m], shape (n,).
    """

    systematic: np.ndarray
    noise: np.ndarray
    p_value: np.ndarray
    groups: int
    torque: np.ndarray

    @property
    def found(self) -> np.ndarray:
        """Joints, counted from 1, on which noise alone is not believed."""
        return np.flatnonzero(self.p_value * len(self.p_value) < DOUBT) + 1

    @property
    def material(self) -> np.ndarray:
        """Those of them, counted from 1, on which it is a visible part of the torque and exceeds the noise."""
        least = np.maximum(MATERIAL * self.torque, self.noise)
        visible = self.systematic > least
        return self.found[visible[self.found - 1]]

    def warnings(self) -> tuple[str, ...]:
        """A warning that names the joints on which model error is material, if there are any."""
        joints = self.material
        if not len(joints):
            return ()
        size = np.hypot(self.systematic, self.noise).clip(1e-300)
        share = (self.systematic / size)[joints - 1].max()
        return (
            f"the residual on joint {', '.join(map(str, joints))} is not noise ({share:.0%} of it follows the "
            "motion): the model lacks an effect, and s^2 (W^T W)^-1 states too small errors; use intervals that count "
            "model error, and `gapscope diagnose` to name the effect; record slow and fast motions apart, slow ones "
            "for friction and gravity, fast ones for inertia, and validate each on the other",
        )


def model_error(
    problem: Problem, residual: np.ndarray, cutoff: float = TORQUE_CUTOFF
) -> ModelError:
    """Split residuals into noise, level up to the cut-off, and model error, which lies where the motion lies.

    The periodogram's mean up to a quarter of the cut-off over its mean from a third to a half of it has Fisher's F
    distribution for noise, with twice the number of ordinates as degrees of freedom. What the low band holds above
    the floor is the variance of the model error.

    Args:
        problem: whose groups and interval count.
        residual: [N m], shape (N, n), better of groups that were not fitted.
        cutoff: of the low-pass that the torque passed [Hz]; Nyquist's frequency if that is lower.

    Source: pintelon2012.
    """
    cutoff = min(cutoff, 0.5 / problem.interval)
    low, floor = np.zeros(residual.shape[1]), np.zeros(residual.shape[1])
    low_count = floor_count = 0
    spans = group_slices(problem.group)
    for span in spans:
        frequency, power = _periodogram(residual[span], problem.interval)
        below = frequency <= LOW * cutoff
        above = (frequency >= FLOOR[0] * cutoff) & (frequency <= FLOOR[1] * cutoff)
        low += power[below].sum(axis=0)
        floor += power[above].sum(axis=0)
        low_count += int(below.sum())
        floor_count += int(above.sum())
    floor_count = max(floor_count, 1)
    low, floor = low / low_count, floor / floor_count
    ratio = low / np.maximum(floor, 1e-300)
    p_value = fisher.sf(ratio, 2 * low_count, 2 * floor_count)
    variance = (residual**2).mean(axis=0)
    # share of all frequencies, of which a real series has two of each
    band = 2 * LOW * cutoff * problem.interval
    systematic = np.minimum((band * (low - floor)).clip(0.0), variance)
    noise = np.sqrt(variance - systematic)
    return ModelError(
        systematic=np.sqrt(systematic),
        noise=noise,
        p_value=p_value,
        groups=len(spans),
        torque=problem.torque.std(axis=0),
    )


def _periodogram(series: np.ndarray, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and power of a tapered series, shape (F, n)."""
    taper = _taper(len(series))
    transform = np.fft.rfft(series * taper[:, None], axis=0)
    power = np.abs(transform) ** 2 / (taper**2).sum()
    return np.fft.rfftfreq(len(series), interval), power


def _taper(count: int) -> np.ndarray:
    """A window that rises and falls by half a cosine, shape (count,)."""
    place = np.arange(count) + 0.5
    from_nearer_end = np.minimum(place, count - place)
    edge = np.clip(from_nearer_end / (TAPER * count), 0, 1)
    return 0.5 * (1 - np.cos(np.pi * edge))
