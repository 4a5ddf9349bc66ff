"""States and friction of an identified arm together, by the unscented filter, from encoders and torque alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.ident.kalman.track import Track
from gapscope.ident.kalman.unscented import Unscented
from gapscope.ident.model.regressor import Regressor

RATE = 100.0
"""Measurements of the encoders are used at about this rate [Hz]."""
LONGEST = 20.0
"""A recording is followed for at most this long [s]: a second takes about a second of computing."""
UNSURE = 0.3
"""Standard deviation of friction before the first sample, over its identified value [1]."""
LEAST_SHARE = 0.02
"""The same at least, as a share of the joint's RMS torque [1]."""
WANDER = 0.1
"""How far friction wanders in one second, over that standard deviation [1/sqrt(s)]."""


@dataclass(frozen=True)
class StatesAndFriction:
    """What the unscented filter saw of one recording, n joints.

    Attributes:
        recording: its name.
        track: ``q1..``, ``dq1..``, then friction ``b1.. c1..`` as gains over ``start``.
        start: identified b [N m s/rad] and c [N m], shape (2 n,).
    """

    recording: str
    track: Track
    start: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the friction parameters, shape (2 n,)."""
        return self.track.names[-len(self.start) :]

    @property
    def friction(self) -> np.ndarray:
        """Viscous and Coulomb friction after each sample, shape (N, 2 n)."""
        return np.asarray(self.start + self.track.value[:, -len(self.start) :])

    @property
    def deviation(self) -> np.ndarray:
        """Its standard errors, shape (N, 2 n)."""
        return self.track.deviation[:, -len(self.start) :]


def follow_states(
    arm: NominalArm,
    recording: Recording,
    identified: Mapping[str, float],
    noise: np.ndarray,
) -> StatesAndFriction:
    """Filter position, velocity and friction of every joint (``gapscope.ident.kalman.unscented``).

    Args:
        arm: without motors that turn several joints.
        recording: with torque; its first ``LONGEST`` seconds are used.
        identified: parameters by the names of ``gapscope.ident.model.regressor``, such as ``m3`` or ``c2``.
        noise: RMS residual of the identified arm [N m], shape (n,).

    Raises:
        InputError: coupled motors, no torque, or a known payload.
        GapscopeError: the filter lost the arm.
    """
    if arm.coupling is not None:
        raise InputError(
            "the unscented filter knows no motor that turns several joints",
            "leave --filter unscented out; the recursive filter follows such an arm",
            where="--filter",
        )
    if recording.tau is None:
        raise InputError("has no torque", "give columns tau1..", file=recording.name)
    recording = _beginning(recording)
    regressor = Regressor(arm)
    prior = np.array([identified.get(name, 0.0) for name in regressor.names])
    names = tuple(f"{kind}{j}" for kind in "bc" for j in range(1, arm.n_joints + 1))
    start = prior[[regressor.names.index(name) for name in names]]
    spread = np.maximum(UNSURE * np.abs(start), _least(recording))
    unscented = Unscented(
        regressor=regressor,
        names=names,
        spread=spread,
        drift=WANDER * spread,
        position_noise=_encoder_noise(recording, arm),
        torque_noise=noise,
        prior=prior,
    )
    every = max(1, round(recording.rate / RATE))
    return StatesAndFriction(recording.name, unscented.follow(recording, every), start)


def _beginning(recording: Recording) -> Recording:
    """The first ``LONGEST`` seconds."""
    return recording.part(recording.t <= recording.t[0] + LONGEST)


def _least(recording: Recording) -> np.ndarray:
    """Least standard deviation of b and c, which a share of the joint's torque at its RMS speed sets, shape (2 n,)."""
    torque = LEAST_SHARE * np.sqrt(np.mean(np.asarray(recording.tau) ** 2, axis=0))
    speed = np.gradient(recording.q, recording.t, axis=0)
    typical = np.maximum(np.sqrt(np.mean(speed**2, axis=0)), 0.05)
    return np.concatenate([torque / typical, torque])


def _encoder_noise(recording: Recording, arm: NominalArm) -> float:
    """Noise of the encoders [rad]: of the second differences, or of rounding, whichever is more."""
    # white noise of deviation s has second differences of sqrt(6) s
    second = np.diff(recording.q, 2, axis=0)
    seen = float(np.median(np.std(second, axis=0))) / np.sqrt(6)
    rounding = (arm.encoder_step or 0.0) / np.sqrt(12)
    return max(seen, rounding, 1e-6)
