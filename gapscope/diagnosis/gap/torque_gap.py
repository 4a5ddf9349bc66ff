"""The torque gap: what the arm predicts against what was recorded, per joint, and the floor under it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.thresholds import (
    EFFECT_FORM,
    FRICTION_FORM,
    MODEL_FORM,
    STICKING_SPEED,
    TIMING_SKEW,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import DryLaw
from gapscope.effects.friction import COULOMB
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF, Segment, low_pass


def torque_scale(torque: np.ndarray) -> np.ndarray:
    """Normalisation of the torque gap [N m], shape (n,): standard deviation, at least 5 % of the largest joint's."""
    deviation = torque.std(axis=0)
    return np.maximum(deviation, 0.05 * deviation.max())


@dataclass(frozen=True)
class TorqueGap:
    """Gap of several segments, filtered at 12 Hz and trimmed, stacked over time; n joints.

    Attributes:
        measured, predicted: torque [N m], shape (M, n).
        edges: row at which each segment begins, and the end.
    """

    measured: np.ndarray
    predicted: np.ndarray
    edges: tuple[int, ...]

    @property
    def error(self) -> np.ndarray:
        """Recorded minus predicted torque [N m], (M, n)."""
        return self.measured - self.predicted

    @property
    def rmse(self) -> np.ndarray:
        """Root mean square of the gap [N m], (n,)."""
        return np.sqrt((self.error**2).mean(axis=0))

    @property
    def nrmse(self) -> np.ndarray:
        """``torque_nrmse`` [1], (n,)."""
        return self.rmse / torque_scale(self.measured)


def torque_gap(
    corrected: CorrectedArm, body: RigidBody, segments: list[Segment]
) -> TorqueGap:
    """Torque gap of an arm on segments that carry a torque; ``body``: of the nominal arm without known loads."""
    measured, predicted = [], []
    for segment in segments:
        prediction = corrected.unlimited.predict(segment.bodies(body), segment.motion)
        measured.append(filtered_torque(segment, corrected))
        predicted.append(
            low_pass(prediction, segment.motion.rate, TORQUE_CUTOFF)[segment.inner]
        )
    edges = np.concatenate([[0], np.cumsum([len(m) for m in measured])])
    return TorqueGap(
        np.vstack(measured), np.vstack(predicted), tuple(int(e) for e in edges)
    )


def filtered_torque(
    segment: Segment, corrected: CorrectedArm | None = None
) -> np.ndarray:
    """Recorded torque of a segment as the gap sees it: filtered at 12 Hz and trimmed [N m], (M, n).

    Of an arm with saturation it is the torque that saturation lets through.
    """
    assert segment.torque is not None
    torque = (
        segment.torque if corrected is None else corrected.delivered(segment.torque)
    )
    return low_pass(torque, segment.motion.rate, TORQUE_CUTOFF)[segment.inner]


@dataclass(frozen=True)
class NoiseFloor:
    """What a healthy arm of this kind would leave on one segment after the 12 Hz filter, n joints.

    Attributes:
        steady: RMS of what is there all the time [N m], (n,): noise, sampling skew, form of the model.
        sticking: size of the doubt about dry friction at each trimmed sample [N m], (M, n), while the joint may stick.
    """

    steady: np.ndarray
    sticking: np.ndarray

    @property
    def floor(self) -> np.ndarray:
        """RMS over all samples [N m], (n,)."""
        return np.sqrt(self.steady**2 + (self.sticking**2).mean(axis=0))


def noise_floor(
    corrected: CorrectedArm, body: RigidBody, segment: Segment
) -> NoiseFloor:
    """Estimate what a healthy arm would leave on a segment, from the segment itself.

    *Noise*: the power density of the unfiltered gap above the band, taken as flat below. *Timing*: ``TIMING_SKEW``
    times the RMS rate of the torque. *Form of the model*: ``MODEL_FORM`` times the torque's deviation. *Dry
    friction*, of size L = c + mu |tau|, grown by its drift: anywhere in -L..L, so RMS L / sqrt 3, while the joint
    sticks, which it does to the degree 1 - |tanh(v / ``STICKING_SPEED``)|; ``FRICTION_FORM`` L while it slides.
    """
    assert segment.torque is not None
    body = segment.bodies(body)
    gap = corrected.delivered(segment.torque) - corrected.unlimited.predict(
        body, segment.motion
    )
    dry = dry_friction(corrected, segment)
    simplified = simplified_forms(
        corrected, segment, lambda arm: arm.unlimited.predict(body, segment.motion)
    )
    form = np.hypot(
        FRICTION_FORM * np.sqrt((dry**2).mean(axis=0)), EFFECT_FORM * simplified
    )
    stuck = (
        1.0 - np.abs(np.tanh(segment.motion.dq[segment.inner] / STICKING_SPEED))
    ) / np.sqrt(3.0)
    return NoiseFloor(steady(gap, segment.torque, segment, form), dry * stuck)


def steady(
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
    noise = _noise_density(gap[inner], rate) * min(TORQUE_CUTOFF, rate / 2)
    torque = low_pass(torque, rate, TORQUE_CUTOFF)[inner]
    timing = TIMING_SKEW * np.sqrt(
        (np.gradient(torque, 1 / rate, axis=0) ** 2).mean(axis=0)
    )
    return np.sqrt(
        noise + timing**2 + (MODEL_FORM * torque_scale(torque)) ** 2 + np.square(form)
    )


def dry_friction(corrected: CorrectedArm, segment: Segment) -> np.ndarray:
    """Size of dry friction at each trimmed sample, c + d + mu |tau| and the like at rest [N m], (M, n)."""
    load = filtered_torque(segment)
    still = np.zeros_like(load)
    nominal = corrected.arm.coulomb + corrected.value(COULOMB.name, "torque")
    dry = np.abs(nominal) + still
    for law, values in corrected.of_kind(DryLaw):
        if law is not COULOMB:
            dry = dry + np.abs(law.amplitude(still, load, *values))
    return np.asarray(dry * corrected.drift(segment.motion.t[segment.inner]))


def simplified_forms(
    corrected: CorrectedArm,
    segment: Segment,
    torque: Callable[[CorrectedArm], np.ndarray],
) -> np.ndarray:
    """RMS of what the effects of simplified form do to a torque that an arm predicts [N m], (n,)."""
    power = np.zeros(corrected.arm.n_joints)
    for effect in corrected.effects:
        if effect.effect.simplified:
            others = CorrectedArm(
                corrected.arm, tuple(e for e in corrected.effects if e is not effect)
            )
            does = torque(corrected) - torque(others)
            does = low_pass(does, segment.motion.rate, TORQUE_CUTOFF)[segment.inner]
            power += (does**2).mean(axis=0)
    return np.sqrt(power)


def _noise_density(gap: np.ndarray, rate: float) -> np.ndarray:
    """Power density of the noise in a gap [(N m)^2/Hz], shape (n,).

    The lowest of the median densities in 13 to 25, 25 to 50 and 50 to 100 Hz, as far as the rate goes (or the top third
    of the band); the median over stretches of time keeps impacts out.
    """
    frequency, density = welch(
        gap, rate, nperseg=min(len(gap), int(rate)), axis=0, average="median"
    )
    top = 0.9 * rate / 2
    bands = [
        (low, min(high, top))
        for low, high in ((13.0, 25.0), (25.0, 50.0), (50.0, 100.0))
        if min(high, top) > low + 5
    ]
    levels = [
        np.median(density[(frequency >= low) & (frequency <= high)], axis=0)
        for low, high in bands or [(0.67 * rate / 2, rate / 2)]
    ]
    return np.min(levels, axis=0)
