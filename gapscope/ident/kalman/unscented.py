"""State and parameters at once: an unscented filter over position, velocity and what the arm's parameters gained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from gapscope.arm.dynamics.rollout import LONGEST_STEP, Plant, Stepper
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.recording import Recording
from gapscope.ident.checks.plausible_samples import check_bare
from gapscope.ident.kalman.track import Track
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor


@dataclass(frozen=True)
class Unscented:
    """Unscented Kalman filter over x = (q, dq, theta), with the recorded torque as input and the encoders as output.

    q and dq follow the arm's forward dynamics with parameters pi + E theta, E the columns of the parameters named;
    theta is a random walk. It needs neither differentiated positions nor zero-phase filters, so it may run while
    recording; and it does not use the controller.

    Attributes:
        regressor: of the nominal arm, with all columns of ``gapscope.ident.model.regressor.JOINT_COLUMNS``.
        names: of the parameters that are estimated, such as ``m7`` or ``b2``, shape (s,).
        spread: standard deviation of theta before the first sample, shape (s,).
        drift: random walk of theta in a second, per square root of s, shape (s,).
        position_noise: standard deviation of the encoders [rad].
        torque_noise: standard deviation of torque that is not modelled [N m], shape (n,), per sample.
        prior: pi at theta = 0; that of the nominal arm by default.

    Raises:
        InputError: a name is no parameter of the regressor, or a list does not fit.

    Source: julier2004.
    """

    regressor: Regressor
    names: tuple[str, ...]
    spread: np.ndarray
    drift: np.ndarray
    position_noise: float
    torque_noise: np.ndarray
    prior: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Check names and lengths."""
        known = self.regressor.names
        unknown = [name for name in self.names if name not in known]
        if unknown:
            raise InputError(
                f"{', '.join(unknown)} is no parameter of the regressor", where="names"
            )
        if self.regressor.effects != JOINT_COLUMNS:
            raise InputError(
                "the filter needs a regressor with the columns of all joint effects",
                where="regressor",
            )
        for field, length in (("spread", len(self.names)), ("drift", len(self.names))):
            if len(getattr(self, field)) != length:
                raise InputError(
                    f"expected {length} numbers, one per name", where=field
                )

    def follow(self, recording: Recording, every: int = 1) -> Track:
        """The filter over a recording: names ``q1..``, ``dq1..`` and the parameters', these as gains over the prior.

        Args:
            recording: with torque.
            every: only each row of this number is used as a measurement.

        Raises:
            InputError: a recording without torque, or with a known payload.
            GapscopeError: the filter lost the arm.
        """
        check_bare(recording)
        if recording.tau is None:
            raise InputError(
                "has no torque", "give columns tau1..", file=recording.name
            )
        rows = np.arange(0, len(recording.t), every)
        t, q = recording.t[rows], recording.q[rows]
        tau = (
            np.add.reduceat(recording.tau, rows)
            / np.diff([*rows, len(recording.t)])[:, None]
        )
        n, size = (
            self.regressor.arm.n_joints,
            2 * self.regressor.arm.n_joints + len(self.names),
        )
        kalman = self._filter(q[0], float(np.median(np.diff(t))))
        value, spread = np.empty((len(t), size)), np.empty((len(t), size, size))
        innovation, whitened = np.zeros((len(t), n)), np.zeros((len(t), n, size))
        value[0], spread[0] = kalman.x, kalman.P
        for k in range(1, len(t)):
            try:
                kalman.predict(dt=t[k] - t[k - 1], torque=tau[k - 1])
                seen = self._shown(kalman.P)
                kalman.update(q[k])
            except np.linalg.LinAlgError as error:
                raise GapscopeError(
                    f"the filter lost the arm at t = {t[k]:.3g} s",
                    "check (a) units and signs of the torque, (b) that the spread of the parameters leaves masses "
                    "positive, (c) that noise is not stated too small",
                ) from error
            root = np.linalg.cholesky(kalman.S)
            innovation[k] = np.linalg.solve(root, kalman.y)
            whitened[k, :, 2 * n :] = np.linalg.solve(root, seen)
            value[k], spread[k] = kalman.x, kalman.P
        names = tuple(f"{kind}{j}" for kind in ("q", "dq") for j in range(1, n + 1))
        walk = np.diff(t, append=t[-1])[:, None] * np.concatenate(
            [np.zeros(2 * n), np.asarray(self.drift) ** 2]
        )
        return Track(
            (*names, *self.names), t, value, spread, innovation, whitened, walk
        )

    def _shown(self, covariance: np.ndarray) -> np.ndarray:
        """How parameters that are off by one unit show in the predicted positions, P_q,theta P_theta^-1, (n, s)."""
        n = self.regressor.arm.n_joints
        own, cross = covariance[2 * n :, 2 * n :], covariance[:n, 2 * n :]
        scale = np.sqrt(np.diag(own))
        return (
            np.linalg.solve(own / np.outer(scale, scale), (cross / scale).T).T / scale
        )

    def _filter(self, start: np.ndarray, period: float) -> UnscentedKalmanFilter:
        n, s = len(start), len(self.names)
        points = MerweScaledSigmaPoints(2 * n + s, alpha=0.3, beta=2.0, kappa=0.0)
        dynamics = self._dynamics(period)
        kalman = UnscentedKalmanFilter(
            2 * n + s, n, period, hx=lambda x: x[:n], fx=dynamics, points=points
        )
        kalman.x = np.concatenate([start, np.zeros(n + s)])
        still = np.full(n, 0.1)
        kalman.P = np.diag(
            np.concatenate([np.full(n, self.position_noise), still, self.spread]) ** 2
        )
        kalman.R = self.position_noise**2 * np.eye(n)
        mass = self.regressor.body.mass_matrix(start) + np.diag(
            self.regressor.arm.armature
        )
        jitter = np.asarray(self.torque_noise) / np.diag(mass) * period
        process = [
            np.full(n, 0.1 * self.position_noise),
            jitter,
            np.asarray(self.drift) * np.sqrt(period),
        ]
        kalman.Q = np.diag(np.concatenate(process) ** 2)
        return kalman

    def _dynamics(self, period: float):  # type: ignore[no-untyped-def]
        """The state after some time [s] under a torque [N m], as the filter wants it."""
        regressor, places = (
            self.regressor,
            [self.regressor.names.index(name) for name in self.names],
        )
        prior = (
            regressor.nominal()
            if self.prior is None
            else np.asarray(self.prior, dtype=float)
        )
        n, count = regressor.arm.n_joints, max(1, round(period / (2 * LONGEST_STEP)))
        order, back = regressor.body.order, regressor.body.places
        stepper = Stepper(regressor.body, Plant.of(prior), period / count)

        def after(x: np.ndarray, dt: float, torque: np.ndarray) -> np.ndarray:
            parameters = prior.copy()
            parameters[places] += x[2 * n :]
            stepper.set_plant(Plant.of(parameters))
            stepper.dt = dt / count
            q, dq, held = (
                x[:n][None, order],
                x[n : 2 * n][None, order],
                torque[None, order],
            )
            for _ in range(count):
                q, dq = stepper(q, dq, held)
            return np.concatenate([q[0, back], dq[0, back], x[2 * n :]])

        return after
