"""State and parameters at once: an unscented filter over position, velocity and what the arm's parameters gained."""

from __future__ import annotations

from collections.abc import Callable
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
    recording; and it does not need the controller.

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
        if self.regressor.quantities != JOINT_COLUMNS:
            raise InputError(
                "the filter needs a regressor with the columns of all quantities of drives",
                where="regressor",
            )
        for name, length in (("spread", len(self.names)), ("drift", len(self.names))):
            if len(getattr(self, name)) != length:
                raise InputError(f"expected {length} numbers, one per name", where=name)

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
        # mean torque between two measurements
        counts = np.diff([*rows, len(recording.t)])
        tau = np.add.reduceat(recording.tau, rows) / counts[:, None]
        n = self.regressor.arm.n_joints
        size = 2 * n + len(self.names)
        kalman = self._filter(q[0], float(np.median(np.diff(t))))
        value, spread = np.empty((len(t), size)), np.empty((len(t), size, size))
        innovation = np.zeros((len(t), n))
        value[0], spread[0] = kalman.x, kalman.P
        for k in range(1, len(t)):
            try:
                kalman.predict(dt=t[k] - t[k - 1], torque=tau[k - 1])
                kalman.update(q[k])
            except np.linalg.LinAlgError as error:
                raise GapscopeError(
                    f"the filter lost the arm at t = {t[k]:.3g} s",
                    "check (a) units and signs of the torque, (b) that the spread of the parameters leaves masses "
                    "positive, (c) that noise is not stated too small",
                ) from error
            # L^-1 with S = L L^T gives innovations unit variance
            root = np.linalg.cholesky(kalman.S)
            innovation[k] = np.linalg.solve(root, kalman.y)
            value[k], spread[k] = kalman.x, kalman.P
        joints = range(1, n + 1)
        states = [f"{kind}{j}" for kind in ("q", "dq") for j in joints]
        variance_rate = np.concatenate([np.zeros(2 * n), np.asarray(self.drift) ** 2])
        walk = np.diff(t, append=t[-1])[:, None] * variance_rate
        names = (*states, *self.names)
        return Track(
            names=names,
            t=t,
            value=value,
            covariance=spread,
            innovation=innovation,
            walk=walk,
        )

    def _filter(self, start: np.ndarray, period: float) -> UnscentedKalmanFilter:
        n, s = len(start), len(self.names)
        points = MerweScaledSigmaPoints(2 * n + s, alpha=0.3, beta=2.0, kappa=0.0)
        kalman = UnscentedKalmanFilter(
            2 * n + s,
            n,
            period,
            hx=lambda x: x[:n],
            fx=self._dynamics(period),
            points=points,
        )
        kalman.x = np.concatenate([start, np.zeros(n + s)])
        encoder = np.full(n, self.position_noise)
        nearly_at_rest = np.full(n, 0.1)  # [rad/s]
        deviation = np.concatenate([encoder, nearly_at_rest, self.spread])
        kalman.P = np.diag(deviation**2)
        kalman.R = self.position_noise**2 * np.eye(n)
        # torque that is not modelled acts on the velocities
        body, arm = self.regressor.body, self.regressor.arm
        inertia = np.diag(body.mass_matrix(start) + np.diag(arm.armature))
        jitter = np.asarray(self.torque_noise) / inertia * period
        wander = np.asarray(self.drift) * np.sqrt(period)
        process = np.concatenate([0.1 * encoder, jitter, wander])
        kalman.Q = np.diag(process**2)
        return kalman

    def _dynamics(self, period: float) -> Callable[..., np.ndarray]:
        """The state after some time [s] under a torque [N m], in the form that the filter calls."""
        regressor = self.regressor
        places = [regressor.names.index(name) for name in self.names]
        prior = regressor.nominal() if self.prior is None else self.prior
        prior = np.asarray(prior, dtype=float)
        n = regressor.arm.n_joints
        count = max(1, round(period / (2 * LONGEST_STEP)))
        # the stepper counts joints in the order of the bodies, the case in its own
        to_body, to_case = regressor.body.order, regressor.body.places
        stepper = Stepper(regressor.body, Plant.of(prior), period / count)

        def after(x: np.ndarray, dt: float, torque: np.ndarray) -> np.ndarray:
            parameters = prior.copy()
            parameters[places] += x[2 * n :]
            # each sigma point has its own arm
            stepper.set_plant(Plant.of(parameters))
            stepper.dt = dt / count
            q = x[:n][None, to_body]
            dq = x[n : 2 * n][None, to_body]
            held = torque[None, to_body]
            for _ in range(count):
                q, dq = stepper(q, dq, held)
            return np.concatenate([q[0, to_case], dq[0, to_case], x[2 * n :]])

        return after
