"""The velocity that a controller has: position through a second-order low-pass differentiator."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

from gapscope.arm.controller import Controller
from gapscope.arm.recording import Recording


class FilterGains(NamedTuple):
    """v[k] = b0 q[k] + b1 q[k-1] + b2 q[k-2] + a1 v[k-1] + a2 v[k-2]; b in 1/s, a in 1."""

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


def bilinear(rate: float, cutoff: float, damping: float) -> FilterGains:
    """Gains of w^2 s / (s^2 + 2 zeta w s + w^2), s = 2 rate (z - 1) / (z + 1); delay 2 zeta / w at low frequency."""
    w = 2 * np.pi * cutoff
    k = 2 * rate
    lead = k**2 + 2 * damping * w * k + w**2
    gain = w**2 * k / lead
    a1 = 2 * (k**2 - w**2) / lead
    a2 = -(k**2 - 2 * damping * w * k + w**2) / lead
    return FilterGains(gain, 0.0, -gain, a1, a2)


def semi_implicit(rate: float, cutoff: float, damping: float) -> FilterGains:
    """Gains of v += h (w^2 (q - x) - 2 zeta w v), x += h v at each tick of h = 1 / rate: half a tick faster."""
    wh, h = 2 * np.pi * cutoff / rate, 1.0 / rate
    gain = wh**2 / h
    return FilterGains(
        gain, -gain, 0.0, 2 - 2 * damping * wh - wh**2, 2 * damping * wh - 1
    )


def backward(rate: float, cutoff: float, damping: float) -> FilterGains:
    """Gains of the same with v and x on the right-hand side taken after the tick: half a tick slower."""
    wh, h = 2 * np.pi * cutoff / rate, 1.0 / rate
    lead = 1 + 2 * damping * wh + wh**2
    gain = wh**2 / h / lead
    return FilterGains(gain, -gain, 0.0, (2 + 2 * damping * wh) / lead, -1 / lead)


RULES: dict[str, Callable[[float, float, float], FilterGains]] = {
    "bilinear": bilinear,
    "semi_implicit": semi_implicit,
    "backward": backward,
}
"""How controllers discretise the filter; a case does not say which, but a recorded velocity does."""


def filter_gains(
    rate: float, cutoff: float | None, damping: float, rule: str = "bilinear"
) -> FilterGains:
    """Gains at a rate [Hz] by one of ``RULES``; those of the backward difference without a cut-off."""
    if cutoff is None:
        return FilterGains(rate, -rate, 0.0, 0.0, 0.0)
    return RULES[rule](rate, cutoff, damping)


def stable(gains: FilterGains) -> bool:
    """Whether both roots of z^2 - a1 z - a2 lie inside the unit circle."""
    return abs(gains.a2) < 1 and abs(gains.a1) < 1 - gains.a2


class VelocityFilter:
    """Second-order low-pass differentiator, w^2 s / (s^2 + 2 zeta w s + w^2), discretised by one of ``RULES``.

    Without a cut-off it is the backward difference. Delay at low frequency: 2 zeta / w, or half a period.

    Args:
        estimate: sampling rate [Hz]; cut-off w / 2 pi [Hz], or ``None``; damping zeta [1].
        position: position at the start [rad], shape (n,).
        velocity: velocity until the start [rad/s], shape (n,).
        rule: one of ``RULES``.
        first: what the first call gives for ``position`` [rad/s], shape (n,), if it is known that the filter had
            not settled; the velocity until then by default.

    Attributes:
        past: rows q[k], q[k-1], q[k-2] [rad], v[k-1], v[k-2] [rad/s], as the gains are ordered, shape (5, n).
    """

    def __init__(
        self,
        estimate: tuple[float, float | None, float],
        position: np.ndarray,
        velocity: np.ndarray,
        rule: str = "bilinear",
        first: np.ndarray | None = None,
    ) -> None:
        gains = filter_gains(*estimate, rule)
        self._gains = np.array(gains)
        # as if it had moved at that velocity forever
        moved = np.asarray(velocity, dtype=float) / estimate[0]
        self.past = np.array(
            [position, position - moved, position - 2 * moved, velocity, velocity]
        )
        self._next = np.empty_like(self.past)
        # v[k-2] is set so that the first call gives what was recorded
        if first is not None and gains.a2:
            flat = self.past.reshape(5, -1)
            flat[4] += (np.ravel(first) - self._gains @ flat) / gains.a2

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Filtered velocity [rad/s] for the next position q [rad], each of the shape of the position at the start."""
        past, after = self.past, self._next
        past[0] = q
        # fast: joints in a row need not be put in one
        flat = past if past.ndim == 2 else past.reshape(5, -1)
        v = self._gains.dot(flat).reshape(past.shape[1:])
        # from one array into another: numpy takes longer to move rows within one
        after[1:] = past[:-1]
        after[3] = v
        # the two arrays change places: what was written becomes the past
        self.past, self._next = after, past
        return v


def rule_of(recording: Recording, controller: Controller) -> str:
    """The rule whose velocity, from the recorded positions, comes nearest to the recorded one; else ``bilinear``.

    A rule that would be unstable at this rate and cut-off cannot be the controller's.
    """
    cutoff, damping = controller.velocity_cutoff, controller.velocity_damping
    if recording.dq is None or cutoff is None:
        return "bilinear"
    # until its start is forgotten to the last digit, by the slower of the poles
    decay = 2 * np.pi * cutoff * min(damping, 1 / (2 * damping))
    settled = recording.t > recording.t[0] - np.log(np.finfo(float).eps) / decay
    if not settled.any():
        return "bilinear"
    h = 1.0 / controller.rate
    # at the ticks of the controller, of which a recording may hold some only
    t = recording.t[0] + h * np.arange(int(recording.duration / h + 1e-6) + 1)
    # from zero, so that the filter does not start with a leap
    q = make_interp_spline(recording.t, recording.q - recording.q[0], k=3)(t)
    mean_square = {}
    for name, rule in RULES.items():
        gains = rule(controller.rate, cutoff, damping)
        if not stable(gains):
            continue
        b0, b1, b2, a1, a2 = gains
        filtered = lfilter([b0, b1, b2], [1.0, -a1, -a2], q, axis=0)
        v = make_interp_spline(t, filtered, k=1)(recording.t[settled])
        mean_square[name] = float(np.mean((v - recording.dq[settled]) ** 2))
    return min(mean_square, key=lambda name: mean_square[name])
