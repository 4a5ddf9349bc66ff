"""Kalman filters over parameters and states: recursive, adaptive, unscented, with friction; and their review."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from filterpy.kalman import KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from gapscope.arm.dynamics.rollout import LONGEST_STEP, Plant, Stepper
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.ident.checks.plausible_samples import check_bare
from gapscope.ident.estimators.linear import WeightedLeastSquares
from gapscope.ident.examination import Whiteness, band_correlation, whiteness
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor
from gapscope.ident.samples import Samples
from gapscope.model.changes import Change
from gapscope.model.effective_samples import group_slices, variance_inflation

# Kalman filters over parameters and states: recursive, adaptive, unscented, with friction.


# What a recursive filter saw: an estimate at every sample.


@dataclass(frozen=True)
class Track:
    """Estimates of b parameters after each of N samples of n channels.

    Attributes:
        names: of the parameters, shape (b,).
        t: time [s], shape (N,).
        value: shape (N, b).
        covariance: shape (N, b, b).
        innovation: measured minus predicted over its standard deviation, white with unit variance if the model
            holds [1], shape (N, n).
    """

    names: tuple[str, ...]
    t: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    innovation: np.ndarray

    @property
    def deviation(self) -> np.ndarray:
        """Standard errors, shape (N, b)."""
        return np.sqrt(np.einsum("kii->ki", self.covariance).clip(0.0))

    def of(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Value and standard error of one parameter, shape (N,) each."""
        place = self.names.index(name)
        return self.value[:, place], self.deviation[:, place]


# Samples gathered into stretches of time, each reduced to as many equations as there are parameters.


SHORTEST = 0.25
"""Least length of a stretch [s]."""
MOST = 200
"""Stretches at most, which bounds time and memory of a filter over them."""


@dataclass(frozen=True)
class Stretches:
    """A problem as K stretches of samples that follow each other within a group.

    Attributes:
        rows: the samples of each stretch, K slices.
        reduced: R_k beta = z_k + noise of unit variance, from the QR of the stretch's W over the noise; matrix of shape
            (K, b, b), torque (K, b). What is left out does not depend on beta.
        ends: time at the last sample of each, counted over all groups without the gaps between them [s], shape (K,).
    """

    rows: tuple[slice, ...]
    reduced: Problem
    ends: np.ndarray

    @classmethod
    def of(cls, problem: Problem, noise: np.ndarray) -> Stretches:
        """Stretches of at least ``SHORTEST`` seconds, about ``MOST`` at most.

        Args:
            problem: N samples in the order of time.
            noise: standard deviation of the torque's noise [N m], shape (n,).
        """
        rows = _cut(problem)
        b = problem.matrix.shape[2]
        matrix, torque = np.zeros((len(rows), b, b)), np.zeros((len(rows), b))
        for k, own in enumerate(rows):
            columns = problem.matrix[own] / noise[:, None]
            right = problem.torque[own] / noise
            both = np.concatenate([columns, right[..., None]], axis=2)
            triangle = np.asarray(np.linalg.qr(both.reshape(-1, b + 1), mode="r"))
            # the last row, if there is one, holds what no beta explains
            upper = triangle[:b]
            matrix[k, : len(upper)] = upper[:, :b]
            torque[k, : len(upper)] = upper[:, b]
        ends = problem.interval * np.array([own.stop - 1 for own in rows])
        groups = np.array([problem.group[own.start] for own in rows])
        length = problem.interval * (rows[0].stop - rows[0].start)
        reduced = Problem(matrix, torque, problem.names, groups, length)
        return cls(rows, reduced, ends)

    @property
    def length(self) -> float:
        """Length of a stretch [s]."""
        return self.reduced.interval


def _cut(problem: Problem) -> tuple[slice, ...]:
    """Slices of about equal length within groups."""
    least = SHORTEST / problem.interval
    samples = max(1, round(max(least, len(problem.torque) / MOST)))
    rows = []
    for group in group_slices(problem.group):
        count = max(1, (group.stop - group.start) // samples)
        edges = np.linspace(group.start, group.stop, count + 1).astype(int)
        rows += [slice(start, stop) for start, stop in pairwise(edges.tolist())]
    return tuple(rows)


# Recursive estimation of base parameters: a Kalman filter whose state is beta.


VAGUE = 10.0
"""Standard deviation of an unknown parameter: this many times the torque's RMS over that of its column [1]."""


@dataclass(frozen=True)
class Recursive:
    """Kalman filter with beta as a random walk: beta+ = beta + w, tau = W beta + v.

    Without drift its last estimate is that of weighted least squares. Samples should lie
    no closer than the torque's low-pass leaves them independent: about half a period of its cut-off.

    Attributes:
        noise: standard deviation of the torque's noise [N m], shape (n,).
        drift: how far each parameter may wander in a second, in its unit per square root of s, shape (b,) or 0.
        start: estimate before the first sample, shape (b,); zeros by default.
        covariance: of it, shape (b, b); vague by default.

    Source: ljung1999.
    """

    noise: np.ndarray
    drift: np.ndarray | float = 0.0
    start: np.ndarray | None = None
    covariance: np.ndarray | None = None

    def follow(self, problem: Problem, t: np.ndarray | None = None) -> Track:
        """The estimate after each sample.

        Args:
            problem: in the order of time.
            t: times [s], shape (N,); by default from 0 on without gaps.
        """
        count, b = len(problem.torque), problem.matrix.shape[2]
        if t is None:
            t = problem.interval * np.arange(count)
        kalman = self._filter(problem)
        value, spread = np.empty((count, b)), np.empty((count, b, b))
        innovation = np.empty_like(problem.torque)
        # gaps between recordings let the parameters wander for longer
        steps = np.maximum(np.diff(t, prepend=t[0] - problem.interval), 1e-9)
        walk = np.diag(np.broadcast_to(self.drift, b) ** 2)
        for k in range(count):
            if k:
                kalman.predict(Q=walk * steps[k])
            kalman.update(problem.torque[k], H=problem.matrix[k])
            innovation[k] = _white(kalman)
            value[k] = kalman.x
            spread[k] = 0.5 * (kalman.P + kalman.P.T)
        return Track(tuple(problem.names), t, value, spread, innovation)

    def _filter(self, problem: Problem) -> KalmanFilter:
        b = problem.matrix.shape[2]
        kalman = KalmanFilter(dim_x=b, dim_z=problem.n_joints)
        kalman.F = np.eye(b)
        kalman.R = np.diag(self.noise**2)
        kalman.x = np.zeros(b) if self.start is None else self.start.copy()
        kalman.P = self.covariance
        if self.covariance is None:
            columns = rms(problem.matrix, axis=(0, 1))
            size = VAGUE * rms(problem.torque, axis=None)
            kalman.P = np.diag((size / np.maximum(columns, 1e-9 * columns.max())) ** 2)
        return kalman


def _white(kalman: KalmanFilter | UnscentedKalmanFilter) -> np.ndarray:
    """The innovation of a filter with unit variance: L^-1 y with S = L L^T, (n,)."""
    return np.linalg.solve(np.linalg.cholesky(kalman.S), kalman.y)


# A Kalman filter over base parameters and friction whose noise comes from the data.


WANDERS = "bcdso"
"""First letters of the parameters that may wander: friction and offsets warm up; masses and rotors stay."""
LEVELS = (0.0, 0.003, 0.01, 0.03, 0.1)
"""Process noise tried: share of its value by which a parameter wanders in one second [1/sqrt(s)]."""
WORTH = 0.02
"""Process noise has to lower the squared error of the torque predicted ahead by this share [1]."""
AHEAD = 1.0
"""Stretches are predicted from those that end this long before [s]: errors of the model last for less."""
SETTLED = 1 / 3
"""Share of the stretches after which predictions count in the choice of the process noise [1]."""


MIN_NOISE = 1e-3
"""Least noise over the RMS of a joint's torque [1]: beside none a vague first covariance loses its digits."""


@dataclass(frozen=True)
class Opening:
    """A moment at which some parameters became unknown again, as when a load is picked up.

    Attributes:
        sample: the first sample after it.
        covariance: that is added to the estimate's, shape (b, b).
    """

    sample: int
    covariance: np.ndarray


@dataclass(frozen=True)
class Followed:
    """What the filter saw, K stretches of N samples of n joints.

    Attributes:
        problem: what it followed.
        stretches: how the samples were gathered.
        track: the estimate after each stretch.
        batch: weighted least squares of all samples, shape (b,).
        noise: RMS of the torque's noise [N m], shape (n,).
        inflation: f, how many samples count as one [1], shape (n,).
        level: process noise that was chosen, one of ``LEVELS``.
        innovation: each sample less its prediction from the stretches before its own, over the noise [1], (N, n).
    """

    problem: Problem
    stretches: Stretches
    track: Track
    batch: np.ndarray
    noise: np.ndarray
    inflation: np.ndarray
    level: float
    innovation: np.ndarray


def follow(problem: Problem, openings: Sequence[Opening] = ()) -> Followed:
    """Filter a problem, beta+ = beta + w, tau = W beta + v, stretch by stretch.

    The covariance of v is sigma_j^2 f_j per joint: sigma_j is the RMS residual of weighted least squares (of each part
    between openings, that of the filter's last estimate there) and f_j = 1 + 2 sum_k rho_k its variance inflation, so
    that errors of the model, which are smooth, count as few samples. By w friction and offsets wander by one of
    ``LEVELS`` times their values: the one with the least squared error of the torque predicted ``AHEAD`` seconds ahead,
    zero unless another gains ``WORTH``. Without wandering the last estimate is that of least squares with these
    weights.

    Args:
        problem: in the order of time.
        openings: in the order of time.

    Raises:
        InputError: the samples do not determine the parameters.

    Source: ljung1999.
    """
    batch = WeightedLeastSquares().estimate(problem)
    noise, inflation = _noise(problem, problem.residual(batch.value))
    stretches = Stretches.of(problem, noise * np.sqrt(inflation))
    if openings:
        # what changed is no noise: its size comes from the estimate of each part
        track = _filtered(stretches, openings, np.zeros_like(batch.value))
        residual = _residual_by_part(problem, stretches, track, openings)
        noise, inflation = _noise(problem, residual)
        stretches = Stretches.of(problem, noise * np.sqrt(inflation))
    best: tuple[float, float, Track] | None = None
    for level in LEVELS:
        track = _filtered(stretches, openings, level * np.abs(batch.value))
        error = _error_ahead(problem, stretches, track, noise)
        if best is None or error < (1 - WORTH) * best[0]:
            best = (error, level, track)
    assert best is not None
    _, level, track = best
    innovation = _predicted_ahead(problem, stretches, track, 1) / noise
    return Followed(
        problem=problem,
        stretches=stretches,
        track=track,
        batch=batch.value,
        noise=noise,
        inflation=inflation,
        level=level,
        innovation=innovation,
    )


def _noise(problem: Problem, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """RMS of a residual [N m], never zero, and how many of its samples count as one [1], (n,) each."""
    least = MIN_NOISE * rms(problem.torque) + 1e-9
    return np.maximum(rms(residual), least), variance_inflation(residual, problem.group)


def _residual_by_part(
    problem: Problem, stretches: Stretches, track: Track, openings: Sequence[Opening]
) -> np.ndarray:
    """What the last estimate of each part between openings leaves of its torque [N m], (N, n)."""
    stops = [own.stop for own in stretches.rows]
    edges = [0, *(opening.sample for opening in openings), len(problem.torque)]
    residual = np.empty_like(problem.torque)
    for start, stop in pairwise(edges):
        last = max(int(np.searchsorted(stops, stop, side="right")) - 1, 0)
        part = slice(start, stop)
        residual[part] = problem.rows(part).residual(track.value[last])
    return residual


def _filtered(
    stretches: Stretches, openings: Sequence[Opening], scale: np.ndarray
) -> Track:
    """The track under a process noise, with the covariance widened at each opening."""
    reduced = stretches.reduced
    drift = scale * [name[0] in WANDERS for name in reduced.names]
    kalman = Recursive(np.ones(reduced.n_joints), drift)
    stops = [own.stop for own in stretches.rows]
    cuts = [int(np.searchsorted(stops, opening.sample + 1)) for opening in openings]
    edges = [0, *cuts, len(stops)]
    tracks: list[Track] = []
    for k, (start, stop) in enumerate(pairwise(edges)):
        if tracks:
            last, added = tracks[-1], openings[k - 1].covariance
            spread = last.covariance[-1] + added
            kalman = replace(kalman, start=last.value[-1], covariance=spread)
        if stop > start:
            own = slice(start, stop)
            tracks.append(kalman.follow(reduced.rows(own), stretches.ends[own]))
    return _joined(tracks)


def _joined(tracks: list[Track]) -> Track:
    """Tracks one after the other."""
    series = zip(
        *((x.t, x.value, x.covariance, x.innovation) for x in tracks), strict=True
    )
    return Track(tracks[0].names, *map(np.concatenate, series))


def _predicted_ahead(
    problem: Problem, stretches: Stretches, track: Track, lag: int
) -> np.ndarray:
    """Torque less its prediction from the estimate ``lag`` stretches before [N m], (N, n); zero where there is none."""
    out = np.zeros_like(problem.torque)
    for k in range(lag, len(stretches.rows)):
        own = stretches.rows[k]
        predicted = problem.matrix[own] @ track.value[k - lag]
        out[own] = problem.torque[own] - predicted
    return out


def _error_ahead(
    problem: Problem, stretches: Stretches, track: Track, noise: np.ndarray
) -> float:
    """Squared error of the torque predicted ``AHEAD`` seconds ahead, over the noise [1].

    The mean within a stretch, of which the median over the stretches: those of a motion that is new are not predicted
    yet, whatever the process noise.
    """
    lag = 1 + round(AHEAD / stretches.length)
    first = max(lag, int(SETTLED * len(stretches.rows)))
    # a record shorter than that is judged one stretch ahead
    if first >= len(stretches.rows):
        lag, first = 1, min(1, len(stretches.rows) - 1)
    error = _predicted_ahead(problem, stretches, track, lag) / noise
    squares = [np.mean(error[own] ** 2) for own in stretches.rows[first:]]
    return float(np.median(squares))


# State and parameters at once: an unscented filter over position, velocity and what the arm's parameters gained.


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
        for name in ("spread", "drift"):
            if len(getattr(self, name)) != (count := len(self.names)):
                raise InputError(f"expected {count} numbers, one per name", where=name)

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
            innovation[k] = _white(kalman)
            value[k], spread[k] = kalman.x, kalman.P
        states = [f"{kind}{j}" for kind in ("q", "dq") for j in range(1, n + 1)]
        return Track((*states, *self.names), t, value, spread, innovation)

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


# States and friction of an identified arm together, by the unscented filter, from encoders and torque alone.


RATE = 100.0
"""Measurements of the encoders are used at about this rate [Hz]."""
LONGEST = 20.0
"""A recording is followed for at most this long [s]: a second takes about a second of computing."""
UNSURE = 0.3
"""Standard deviation of friction before the first sample, over its identified value [1]."""
MIN_SHARE = 0.02
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
    """Filter position, velocity and friction of every joint (``gapscope.ident.kalman``).

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
    recording = recording.part(recording.t <= recording.t[0] + LONGEST)
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


def _least(recording: Recording) -> np.ndarray:
    """Least standard deviation of b and c, which a share of the joint's torque at its RMS speed sets, shape (2 n,)."""
    torque = MIN_SHARE * rms(np.asarray(recording.tau))
    speed = np.gradient(recording.q, recording.t, axis=0)
    typical = np.maximum(rms(speed), 0.05)
    return np.concatenate([torque / typical, torque])


def _encoder_noise(recording: Recording, arm: NominalArm) -> float:
    """Noise of the encoders [rad]: of the second differences, or of rounding, whichever is more."""
    # white noise of deviation s has second differences of sqrt(6) s
    second = np.diff(recording.q, 2, axis=0)
    seen = float(np.median(np.std(second, axis=0))) / np.sqrt(6)
    rounding = (arm.encoder_step or 0.0) / np.sqrt(12)
    return max(seen, rounding, 1e-6)


# The filter beside the batch: when it converged, where it departs, whether its innovations are white.


BAND = 4.0
"""Standard errors by which the filter departs from the batch; 3.9 is reached once in 10 000 by chance."""
DETERMINED = 1e-6
"""Least singular value of the columns in which a change moves parameters, over the largest [1]. (numerics)"""
WIDER = 3.0
"""Variance of a parameter that changed, over the squared size of the change [1]."""


@dataclass(frozen=True)
class Departure:
    """A parameter whose estimate at some moment excludes the batch's.

    Attributes:
        parameter: its place among the base parameters.
        stretch: where it is farthest off.
        size: distance over the filter's standard error [1].
    """

    parameter: int
    stretch: int
    size: float


@dataclass(frozen=True)
class FilterReview:
    """A filter beside the batch estimate, K stretches of n joints, b parameters.

    Attributes:
        followed: what the filter saw.
        batch: the estimate it is compared with, shape (b,).
        recordings: name of the recording of each stretch, K of them.
        times: time in it at the end of each stretch [s], shape (K,).
        converged: number of the first stretch from which on the uncertainty of the parameters adds less to the
            predicted torque than its noise; ``None`` if there is none.
        departures: after that, one for each parameter that departs, the farthest first.
        whiteness: of the innovations after that.
        changes: those that the filter was told of: there it started anew with what changed.
        moved: by how much each of them moved the parameters, shape (C, b).
    """

    followed: Followed
    batch: np.ndarray
    recordings: tuple[str, ...]
    times: np.ndarray
    converged: int | None
    departures: tuple[Departure, ...]
    whiteness: Whiteness
    changes: tuple[Change, ...]
    moved: np.ndarray

    @property
    def elapsed(self) -> np.ndarray:
        """Time of the samples so far, all recordings together [s], shape (K,)."""
        return self.followed.stretches.ends

    @property
    def rms(self) -> np.ndarray:
        """RMS of the innovations after convergence over the RMS residual of the batch [1], shape (n,)."""
        counted = self.followed.innovation[_first_sample(self.followed, self.converged)]
        return rms(counted)


def review(
    samples: Samples,
    problem: Problem,
    batch: np.ndarray | None,
    changes: Sequence[Change],
) -> FilterReview:
    """Filter the samples of an identification, and compare with its estimate.

    Args:
        samples: that were fitted.
        problem: the same in the base columns.
        batch: the estimate of all samples, shape (b,); weighted least squares if ``None``.
        changes: found during recordings; of those in the samples the filter is told.
    """
    names = np.array([samples.segments[k].recording for k in samples.group])
    told, moved, openings = [], [], []
    for found in changes:
        after = np.flatnonzero(
            (names == found.recording) & (samples.times > found.time)
        )
        if len(after):
            D = _moved(found, problem, names, samples.times)
            openings += _openings(found, D, after)
            told.append(found)
            moved.append(D @ found.value)
    openings = [some for some in openings if some.sample < len(names)]
    openings.sort(key=lambda opening: opening.sample)
    followed = follow(problem, openings)
    ends = np.array([own.stop - 1 for own in followed.stretches.rows])
    batch = followed.batch if batch is None else batch
    converged = _converged(followed)
    return FilterReview(
        followed=followed,
        batch=batch,
        recordings=tuple(names[ends].tolist()),
        times=samples.times[ends],
        converged=converged,
        departures=_departures(followed, batch, converged),
        whiteness=_whiteness(followed, samples.band.cutoff, converged),
        changes=tuple(told),
        moved=np.array(moved),
    )


def _moved(
    found: Change, problem: Problem, names: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """By how much each coordinate of a change moves the parameters, as far as its torque can be theirs, (b, linear).

    Args:
        found: the change.
        problem: in the base columns.
        names: of the recordings of its samples, (N,).
        times: of its samples [s], (N,).
    """
    torque = np.zeros((*problem.torque.shape, len(found.value)))
    for name, (t, columns) in found.columns.items():
        here = np.flatnonzero(names == name)
        for j, k in np.ndindex(columns.shape[1:]):
            torque[here, j, k] = np.interp(times[here], t, columns[:, j, k])
    # a joint that does not count there has a row of zeros
    torque *= np.any(problem.matrix, axis=2, keepdims=True)
    W = problem.matrix.reshape(torque[..., 0].size, -1)
    scale = np.linalg.norm(W, axis=0)
    right = torque.reshape(len(W), -1)
    return np.linalg.lstsq(W / scale, right, rcond=DETERMINED)[0] / scale[:, None]


def _openings(found: Change, moved: np.ndarray, after: np.ndarray) -> list[Opening]:
    """What changed is unknown after the moment, and again where the recording ends if another follows."""
    variance = WIDER * (found.value**2 + found.deviation**2)
    covariance = (moved * variance) @ moved.T
    return [Opening(int(k), covariance) for k in (after[0], after[-1] + 1)]


def _converged(followed: Followed) -> int | None:
    """The first stretch from which on W P W^T, the variance that the estimate adds, is below that of the noise."""
    problem, rows = followed.problem, followed.stretches.rows
    first = 1
    for k in range(1, len(rows)):
        W = problem.matrix[rows[k]]
        # P of the estimate before the stretch
        spread = W @ followed.track.covariance[k - 1]
        added = np.einsum("mja,mja->mj", spread, W) / followed.noise**2
        if added.mean() > 1:
            first = k + 1
    return first if first < len(rows) else None


def _first_sample(followed: Followed, converged: int | None) -> slice:
    """The samples after convergence; of a filter that did not converge those after it settled."""
    rows = followed.stretches.rows
    first = converged
    if first is None:
        first = min(max(1, int(SETTLED * len(rows))), len(rows) - 1)
    return slice(rows[first].start, None)


def _departures(
    followed: Followed, batch: np.ndarray, converged: int | None
) -> tuple[Departure, ...]:
    if converged is None:
        return ()
    track = followed.track
    deviation = np.maximum(track.deviation[converged:], 1e-300)
    size = np.abs(track.value[converged:] - batch) / deviation
    farthest = size.argmax(axis=0)
    found = [
        Departure(i, converged + int(k), float(size[k, i]))
        for i, k in enumerate(farthest)
        if size[k, i] > BAND
    ]
    return tuple(sorted(found, key=lambda departure: -departure.size))


def _whiteness(followed: Followed, cutoff: float, converged: int | None) -> Whiteness:
    """Of the innovations sampled at the cut-off, as in the validation."""
    rate = 1.0 / followed.problem.interval
    step = max(1, round(rate / cutoff))
    counted = _first_sample(followed, converged)
    series = followed.innovation[counted][::step]
    group = followed.problem.group[counted][::step]
    return whiteness(series, group, band_correlation(rate, cutoff, step))
