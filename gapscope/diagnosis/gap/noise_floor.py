"""The noise floor: what a healthy arm of this kind would leave of the torque gap, estimated from a segment itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.thresholds import (
    EFFECT_FORM,
    FRICTION_FORM,
    MIN_FLOOR,
    MODEL_FORM,
    STICKING_SPEED,
    TIMING_SKEW,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, low_pass
from gapscope.model.prediction import Prediction
from gapscope.model.torque_gap import filtered_torque, torque_scale

NOISE_BANDS = ((13.0, 25.0), (25.0, 50.0), (50.0, 100.0))
"""Bands above that of the torque gap in which noise is read [Hz]."""


@dataclass(frozen=True)
class NoiseFloor:
    """What a healthy arm of this kind would leave on one segment after the 12 Hz filter, n joints.

    Attributes:
        steady: RMS of what is there all the time [N m], (n,): noise, sampling skew, form of the model.
        sticking: RMS of what is unknown of dry friction at each trimmed sample [N m], (M, n), as far as the joint may
            stick.
    """

    steady: np.ndarray
    sticking: np.ndarray

    @property
    def floor(self) -> np.ndarray:
        """RMS over all samples [N m], (n,)."""
        return np.sqrt(self.steady**2 + (self.sticking**2).mean(axis=0))


def noise_floor(
    corrected: CorrectedArm,
    body: RigidBody,
    segment: Segment,
    prediction: Prediction | None = None,
) -> NoiseFloor:
    """Estimate what a healthy arm would leave on a segment, from the segment itself.

    ``prediction`` is what the arm predicts there, if it is known already.

    *Noise*: the power density of the unfiltered gap above the band, taken as flat below. *Steps*: what rounding the
    predicted torque to the steps of the recorded one leaves, which of a slow torque is no white noise. *Timing*:
    ``TIMING_SKEW`` times the RMS rate of the torque. *Form of the model*: ``MODEL_FORM`` times the torque's deviation.
    *Dry friction*, of size L = c + mu |tau|, grown by its drift: anywhere in -L..L while the joint sticks (see
    ``sticking_rms``), ``FRICTION_FORM`` L while it slides. *Form of other effects*: ``EFFECT_FORM`` times what those
    do whose form the catalogue simplifies.
    """
    assert segment.torque is not None
    if prediction is None:
        body = segment.bodies(body)
        prediction = Prediction.of(corrected, body, segment.motion)
    gap = segment.bridged(corrected.delivered(segment.torque) - prediction.torque)
    dry = dry_friction(corrected, segment)
    dry_rms = np.sqrt((dry**2).mean(axis=0))
    effect_rms = simplified_effect_rms(corrected, segment, prediction.share_of)
    form = np.hypot(FRICTION_FORM * dry_rms, EFFECT_FORM * effect_rms)
    form = np.hypot(form, _rounding_rms(prediction.torque, segment))
    return NoiseFloor(
        steady_floor(gap, segment.torque, segment, form),
        sticking_rms(dry, segment.motion.dq[segment.inner] / corrected.arm.per_radian),
    )


def steady_floor(
    gap: np.ndarray,
    torque: np.ndarray,
    segment: Segment,
    form: np.ndarray | float = 0.0,
) -> np.ndarray:
    """RMS of noise, timing, form of the model and the form of its effects, together [N m], (n,).

    Args:
        gap: unfiltered, for the noise above the band [N m], (N, n).
        torque: as measured, unfiltered, for timing and the form of the model [N m], (N, n).
        segment: where they were measured.
        form: RMS of what the form of friction and of other effects leaves [N m], (n,).
    """
    rate, inner = segment.motion.rate, segment.inner
    noise_power = _noise_density(gap[inner], rate) * min(TORQUE_CUTOFF, rate / 2)
    torque = low_pass(torque, rate, TORQUE_CUTOFF)[inner]
    timing = timing_error(torque, 1 / rate)
    model_form = MODEL_FORM * torque_scale(torque)
    floor = np.sqrt(noise_power + timing**2 + model_form**2 + np.square(form))
    return np.maximum(floor, MIN_FLOOR)


def timing_error(torque: np.ndarray, spacing: float | np.ndarray) -> np.ndarray:
    """RMS of the error of a torque [N m], (N, n), that is recorded ``TIMING_SKEW`` off [N m], (n,).

    Args:
        torque: [N m], (N, n).
        spacing: of the samples in time, or their times [s].
    """
    rate = np.gradient(torque, spacing, axis=0)
    return np.asarray(TIMING_SKEW * np.sqrt((rate**2).mean(axis=0)))


def sticking_rms(dry: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """RMS of unknown dry friction of size L (``dry`` [N m], of the shape of dq or (n,)), as the joint sticks.

    Friction of a joint at rest lies anywhere in -L..L, which has the RMS L / sqrt 3; a joint at speed v counts as at
    rest to the degree 1 - |tanh(v / ``STICKING_SPEED``)|. The speed dq of a slide counts in ``NominalArm.per_radian``.
    """
    sticks = (1.0 - np.abs(np.tanh(dq / STICKING_SPEED))) / np.sqrt(3.0)
    return dry * sticks


def dry_friction(corrected: CorrectedArm, segment: Segment) -> np.ndarray:
    """Size of dry friction at each trimmed sample, c + d + mu |tau| and the like at rest [N m], (M, n)."""
    load = filtered_torque(segment)
    still = np.zeros_like(load)
    dry = np.abs(corrected.quantity("friction")) + still
    for law, values in corrected.of_kind(DryLaw):
        # already with the nominal arm's
        if "friction" in law.quantities.values():
            continue
        amplitude = np.abs(law.amplitude(still, load, *values))
        if law.reach == "motor" and corrected.arm.coupling is not None:
            amplitude = amplitude @ np.abs(corrected.arm.coupling)
        dry = dry + amplitude
    return np.asarray(dry * corrected.drift(segment.motion.t[segment.inner]))


def simplified_effect_rms(
    corrected: CorrectedArm,
    segment: Segment,
    share_of: Callable[[AppliedEffect], np.ndarray],
) -> np.ndarray:
    """RMS of what the effects of simplified form do to a torque [N m], (n,); ``share_of`` one of them, (N, n)."""
    power = np.zeros(corrected.arm.n_joints)
    for applied in corrected.effects:
        if applied.effect.simplified:
            change = low_pass(share_of(applied), segment.motion.rate, TORQUE_CUTOFF)
            power += (change[segment.inner] ** 2).mean(axis=0)
    return np.sqrt(power)


def _rounding_rms(torque: np.ndarray, segment: Segment) -> np.ndarray:
    """RMS of what rounding a torque, (N, n), to a segment's steps leaves after the 12 Hz filter [N m], (n,)."""
    steps = segment.torque_step
    if steps is None:
        return np.zeros(torque.shape[1])
    coarse = np.flatnonzero(steps)
    own, step = torque[:, coarse], steps[coarse]
    error = low_pass(
        step * np.round(own / step) - own, segment.motion.rate, TORQUE_CUTOFF
    )
    out = np.zeros(torque.shape[1])
    out[coarse] = np.sqrt((error[segment.inner] ** 2).mean(axis=0))
    return out


def _noise_density(gap: np.ndarray, rate: float) -> np.ndarray:
    """Power density of the noise in a gap [(N m)^2/Hz], shape (n,).

    The lowest of the median densities in ``NOISE_BANDS``, as far as the rate goes (or the top third of the band); the
    median over stretches of time keeps impacts out.
    """
    frequency, density = welch(
        gap, rate, nperseg=min(len(gap), int(rate)), axis=0, average="median"
    )
    top = 0.9 * rate / 2
    bands = [
        (low, min(high, top)) for low, high in NOISE_BANDS if min(high, top) > low + 5
    ]
    if not bands:
        bands = [(0.67 * rate / 2, rate / 2)]
    levels = []
    for low, high in bands:
        inside = (frequency >= low) & (frequency <= high)
        levels.append(np.median(density[inside], axis=0))
    return np.min(levels, axis=0)
