"""Symptoms of an identification: what its fit says by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import welch

from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.ident.model.friction import Choice
from gapscope.ident.samples import Samples
from gapscope.model.conditioning import uniform

# Input of the troubleshooting table: the data, the nominal arm, and the fit.


_RIGID, _ROTOR, _VISCOUS, _DRY = range(4)
"""Places of a joint's parts of the torque, see ``_torque_parts``."""


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
    size = rms(nominal)
    recorded = rms(samples.torque)
    loaded = size > 0.05 * size.max()
    return np.where(loaded, recorded / np.maximum(size, 1e-9), np.nan)


# A gain that recorded torque has over the nominal arm's common to all joints: another unit, or another scale.


CLEAR = 0.05
"""A joint counts if only the rigid bodies explain this share of its torque's variance [1]."""
ALIKE = 1.25
"""Gains within this factor of their median agree [1]."""
MOSTLY = 0.75
"""Share of the joints that count whose gains have to agree [1]."""
GAIN = 1.3
"""Gains beyond this, or below its inverse, are not those of torque in N m [1]."""
UNITS = {
    "mN m": 1e3,
    "ozf in": 141.6,
    "N cm": 1e2,
    "kgf cm": 10.2,
    "lbf in": 8.851,
    "lbf ft": 0.7376,
    "kgf m": 0.102,
}
"""What 1 N m is in other units."""


@dataclass(frozen=True)
class TorqueGain:
    """Gain of the nominal rigid bodies' torque in the recorded one, friction left free.

    Attributes:
        gain: median over the joints that count [1]; 1 if fewer than two do.
        alike: whether those joints agree.
        joints: those joints, from 1.
    """

    gain: float
    alike: bool
    joints: tuple[int, ...]

    @property
    def size(self) -> float:
        """The gain or its inverse, whichever is larger, of joints that agree [1]; 1 if they do not."""
        return max(self.gain, 1 / self.gain) if self.alike else 1.0

    @property
    def found(self) -> bool:
        """Whether the torque is another by a common factor."""
        return self.size > GAIN

    def warning(self) -> str:
        """What is wrong, the factor, and what to do."""
        near = [
            unit for unit, value in UNITS.items() if 1 / 1.03 < self.gain / value < 1.03
        ]
        guess = f", as if it were in {near[0]}" if near else ""
        return (
            f"the recorded torque is {self.gain:.3g} times the nominal arm's on joint "
            f"{', '.join(map(str, self.joints))} alike{guess}: masses and friction come out off by that factor if "
            "the unit is wrong; say in the case import: {tau: {scale: [...]}}, torque constants and gear ratios "
            "included, or correct the URDF"
        )


def torque_gain(found: NominalSimilarity) -> TorqueGain:
    """The common gain, of the joints on which the rigid bodies show."""
    clear = np.flatnonzero((found.weight > CLEAR) & (found.gain > 0))
    # one joint alone may have an error of its own
    if len(clear) < 2:
        return TorqueGain(1.0, False, ())
    gains = found.gain[clear]
    median = float(np.median(gains))
    factor = np.maximum(gains / median, median / gains)
    alike = factor < ALIKE
    joints = tuple(int(j) + 1 for j in clear[alike])
    return TorqueGain(median, bool(alike.mean() >= MOSTLY), joints)


# Measurements behind the troubleshooting table, each one number per joint.


FLAT = 3
"""Equal samples in a row at a joint's largest torque that count as clipped."""


def spectral(
    recordings: Sequence[Recording], cutoff: float
) -> tuple[np.ndarray, np.ndarray]:
    """RMS of the noise in ddq over that of ddq below a cut-off [Hz], and share of the power of dq beyond it; each (n,).

    The noise density of q is the median one in the upper half of the band; differentiating twice multiplies it by
    (2 pi f)^4. Only power that exceeds it counts beyond the cut-off.
    """
    n = recordings[0].n_joints
    noise, acceleration, lost, speed = (np.zeros(n) for _ in range(4))
    for recording in recordings:
        frequency, density = _position_spectrum(recording)
        floor = np.median(density[frequency > recording.rate / 4], axis=0)
        # d/dt multiplies the density by (2 pi f)^2; the bin width turns it into power
        derivative = (2 * np.pi * frequency[:, None]) ** 2
        velocity_power = derivative * (frequency[1] - frequency[0])
        acceleration_power = velocity_power**2
        inside = frequency <= cutoff
        above_floor = np.where(density > 10 * floor, density - floor, 0.0)
        noise += (acceleration_power * floor)[inside].sum(axis=0)
        acceleration += (acceleration_power * density)[inside].sum(axis=0)
        lost += (velocity_power * above_floor)[~inside].sum(axis=0)
        speed += (velocity_power * density)[inside].sum(axis=0)
    noise_share = np.sqrt(noise / np.maximum(acceleration, 1e-300))
    return noise_share, lost / np.maximum(speed + lost, 1e-300)


def _position_spectrum(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and power density of q [rad^2/Hz], shape (F, n)."""
    _, q = uniform(recording.t, recording.q, recording.rate)
    # a motion that does not end where it began would leak over the whole spectrum
    drift = np.linspace(0, 1, len(q))[:, None] * (q[-1] - q[0])
    frequency, density = welch(
        q - drift,
        recording.rate,
        nperseg=min(len(q), int(4 * recording.rate)),
        axis=0,
        detrend="linear",
    )
    return frequency, density


def clipped(recordings: Sequence[Recording], limit: np.ndarray | None) -> np.ndarray:
    """Share of the samples at which a joint's torque is at its limit [1], shape (n,).

    At 99 % of the limit [N m] if the data sheet has one; and in any case if the torque stays exactly at its largest
    or smallest value for several samples.
    """
    torques = [np.asarray(r.tau) for r in recordings if r.tau is not None]
    total = sum(len(tau) for tau in torques)
    n = torques[0].shape[1]
    share = np.zeros(n)
    for j in range(n):
        series = [tau[:, j] for tau in torques]
        highest = max(x.max() for x in series)
        lowest = min(x.min() for x in series)
        for x in series:
            extreme = np.isclose(x, highest, rtol=1e-6) | np.isclose(
                x, lowest, rtol=1e-6
            )
            at_limit = _in_runs(extreme)
            if limit is not None:
                at_limit |= np.abs(x) >= 0.99 * limit[j]
            share[j] += at_limit.sum() / total
    return share


def _in_runs(at: np.ndarray) -> np.ndarray:
    """Samples that are part of at least ``FLAT`` in a row."""
    padded = np.concatenate([[0], at.astype(int), [0]])
    edges = np.flatnonzero(np.diff(padded))
    starts, stops = edges[::2], edges[1::2]
    long_enough = np.zeros(len(at), dtype=bool)
    for start, stop in zip(starts, stops, strict=True):
        long_enough[start:stop] = stop - start >= FLAT
    return long_enough


def exchanged(explained: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """Gain if torques are assigned to other joints' motions, per joint that changes, and those joints from 1.

    Args:
        explained: share of the variance of the torque of joint j explained by the motion of joint i, rows i.
    """
    motions, torques = linear_sum_assignment(-explained)
    # the assignment that explains most variance in all
    moved = np.flatnonzero(motions != torques)
    if not len(moved):
        return 0.0, ()
    own = np.diag(explained)[torques]
    gain = (explained[motions, torques] - own)[moved]
    return float(gain.sum()) / len(moved), tuple(int(j) + 1 for j in moved)


def near_rest(choice: Choice) -> float:
    """Share by which a Stribeck term lowers the error on held-out stretches [1]."""
    without: list[float] = []
    with_stribeck: list[float] = []
    for law, error in choice.tried:
        if "direction kept" in law:
            continue
        if "Stribeck" in law:
            with_stribeck.append(error)
        else:
            without.append(error)
    if not with_stribeck:
        return 0.0
    return 1 - min(with_stribeck) / without[0]
