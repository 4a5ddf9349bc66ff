"""Kalman filters over parameters and states: recursive, adaptive, unscented, with friction; and their review."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.stats import norm

from gapscope.arm.dynamics.rollout import LONGEST_STEP, Stepper
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.ident.estimators.linear import (
    MIN_NOISE,
    Estimate,
    finished,
    weighted_least_squares,
    whitened,
)
from gapscope.ident.intervals import (
    DOUBT,
    MAX_BLOCKS,
    Whiteness,
    whiteness,
)
from gapscope.ident.model.base_parameters import ROUNDING, TINY, WORTH, Factor
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.samples import MOVING, Problem, Samples, check_bare, equal_parts
from gapscope.model.changes import Change
from gapscope.model.effective_samples import group_slices, variance_inflation
from gapscope.model.rows import MODEL_RATE

# An estimate at every stretch of samples.


@dataclass(frozen=True)
class Track:
    """Estimates of b parameters at each of N times.

    Attributes:
        names: of the parameters, shape (b,).
        t: time [s], shape (N,).
        value: shape (N, b).
        covariance: shape (N, b, b).
    """

    names: tuple[str, ...]
    t: np.ndarray
    value: np.ndarray
    covariance: np.ndarray

    @property
    def deviation(self) -> np.ndarray:
        """Standard errors, shape (N, b)."""
        return np.sqrt(np.einsum("kii->ki", self.covariance).clip(0.0))


# Recursive estimation of base parameters: a Kalman filter whose state is beta, and whose noise comes from the data.
# Samples are gathered into stretches of time, each reduced to as many equations as there are parameters.


SHORTEST = 0.25
"""Least length of a stretch [s]; there are ``MAX_BLOCKS`` at most, which bounds time and memory of a filter."""
VAGUE = 10.0
"""Standard deviation of an unknown parameter: this many times the torque's RMS over that of its column [1]."""
WANDERS = "bcdso"
"""First letters of the parameters that may wander: friction and offsets warm up; masses and rotors stay."""
LEVELS = (0.0, 0.003, 0.01, 0.03, 0.1)
"""Process noise tried: share of its value by which a parameter wanders in one second [1/sqrt(s)]."""
AHEAD = 1.0
"""Stretches are predicted from those that end this long before [s]: errors of the model last for less."""


@dataclass(frozen=True)
class Followed:
    """What the filter saw, N samples of n joints in K stretches that follow each other within a group.

    Attributes:
        problem: what it followed.
        rows: the samples of each stretch, K slices.
        length: of a stretch, on average [s].
        track: the estimate after each stretch, by the time of the samples so far without gaps between groups.
        batch: weighted least squares of all samples, shape (b,).
        noise: RMS of the torque's noise [N m], shape (n,).
        inflation: f, how many samples count as one [1], shape (n,).
        level: process noise that was chosen, one of ``LEVELS``.
        innovation: each sample less its prediction from the stretches before its own, over the noise [1], (N, n).
    """

    problem: Problem
    rows: list[slice]
    length: float
    track: Track
    batch: np.ndarray
    noise: np.ndarray
    inflation: np.ndarray
    level: float
    innovation: np.ndarray


Openings = Sequence[tuple[int, np.ndarray]]
"""Moments at which some parameters became unknown again, as when a load is picked up, in the order of time: the first
sample after each, and the covariance that is added to the estimate's, shape (b, b)."""


def follow(problem: Problem, openings: Openings = ()) -> Followed:
    """Filter a problem, beta+ = beta + w, tau = W beta + v, stretch by stretch.

    The covariance of v is sigma_j^2 f_j per joint: sigma_j is the RMS residual of weighted least squares (of each part
    between openings, that of the filter's last estimate there) and f_j = 1 + 2 sum_k rho_k its variance inflation, so
    that errors of the model, which are smooth, count as few samples. By w friction and offsets wander by one of
    ``LEVELS`` times their values: the one with the least squared error of the torque predicted ``AHEAD`` seconds ahead,
    zero unless another gains ``WORTH``. Without wandering the last estimate is that of least squares with these
    weights.

    Args:
        problem: in the order of time.
        openings: where it is begun anew.

    Raises:
        InputError: the samples do not determine the parameters.

    Source: ljung1999.
    """
    batch = weighted_least_squares(problem).value
    rows = []
    for group in group_slices(problem.group):
        fewest = SHORTEST / problem.interval[group.start]
        samples = max(1, round(max(fewest, len(problem.torque) / MAX_BLOCKS)))
        rows += equal_parts(group, max(1, (group.stop - group.start) // samples))
    length = float(problem.interval.sum()) / len(rows)
    least = MIN_NOISE * rms(problem.torque) + 1e-9

    def noise_of(residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[Factor]]:
        """Its RMS [N m] and inflation, (n,) each; stretches as equations R beta = z + noise of unit variance."""
        size = np.maximum(rms(residual), least)
        inflation = variance_inflation(residual, problem.group)
        spread = size * np.sqrt(inflation)
        factors = [Factor.of(*whitened(problem.rows(own), spread)) for own in rows]
        return size, inflation, factors

    noise, inflation, factors = noise_of(problem.residual(batch))
    if openings:
        # what changed is no noise: its size comes from the estimate of each part
        # each part has its own values: none wanders within it
        track = _filtered(problem, rows, factors, openings, 0 * batch)
        stops = [own.stop for own in rows]
        edges = [0, *(sample for sample, _ in openings), len(problem.torque)]
        residual = np.empty_like(problem.torque)
        for start, stop in pairwise(edges):
            # the last stretch that ends within the part has seen most of it
            last = max(int(np.searchsorted(stops, stop, side="right")) - 1, 0)
            part = slice(start, stop)
            residual[part] = problem.rows(part).residual(track.value[last])
        noise, inflation, factors = noise_of(residual)
    wandering = np.abs(batch) * [name[0] in WANDERS for name in problem.names]
    # a record shorter than that is judged one stretch ahead
    lag = 1 + round(AHEAD / length)
    # at first the vague covariance decides, whatever the process noise
    first = max(lag, len(rows) // 2)
    if first >= len(rows):
        lag, first = 1, min(1, len(rows) - 1)
    best = np.inf
    for tried in LEVELS:
        own = _filtered(problem, rows, factors, openings, tried * wandering)
        ahead = _predicted_ahead(problem, rows, own, lag) / noise
        # the median over stretches: those of a motion that is new are not predicted yet, whatever the process noise
        error = np.median([np.mean(ahead[span] ** 2) for span in rows[first:]])
        # from none upward: more wandering has to be worth it
        if error < (1 - WORTH) * best:
            best, level, track = error, tried, own
    innovation = _predicted_ahead(problem, rows, track, 1) / noise
    return Followed(
        problem=problem,
        rows=rows,
        length=length,
        track=track,
        batch=batch,
        noise=noise,
        inflation=inflation,
        level=level,
        innovation=innovation,
    )


def _filtered(
    problem: Problem,
    rows: Sequence[slice],
    factors: Sequence[Factor],
    openings: Openings,
    drift: np.ndarray,
) -> Track:
    """The track under a random walk, per square root of s, (b,), with the covariance widened at each opening."""
    elapsed = np.cumsum(problem.interval) - problem.interval[0]
    ends = elapsed[[own.stop - 1 for own in rows]]
    b, count = len(drift), len(factors)
    columns = rms(np.array([factor.triangle for factor in factors]), axis=(0, 1))
    size = VAGUE * rms(np.array([factor.rotated for factor in factors]), axis=None)
    # equations of unit noise, as many as parameters: dim_z is b
    kalman = KalmanFilter(dim_x=b, dim_z=b)
    kalman.x, kalman.F, kalman.R = np.zeros(b), np.eye(b), np.eye(b)
    # a column of almost no content would be vaguer than digits allow
    kalman.P = np.diag((size / np.maximum(columns, 1e-9 * columns.max())) ** 2)
    stops = [own.stop for own in rows]
    # the stretch in which the first sample after the moment lies
    opened = [int(np.searchsorted(stops, sample + 1)) for sample, _ in openings]
    value, spread = np.empty((count, b)), np.empty((count, b, b))
    for k, factor in enumerate(factors):
        for cut, (_, covariance) in zip(opened, openings, strict=True):
            # the first stretch starts vague anyway
            if k and k == cut:
                kalman.P = kalman.P + covariance
        if k and k not in opened:
            # gaps between recordings let the parameters wander for longer
            kalman.predict(Q=np.diag(drift**2) * (ends[k] - ends[k - 1]))
        kalman.update(factor.rotated, H=factor.triangle)
        # rounding makes it lose its symmetry, and then its sign
        kalman.P = 0.5 * (kalman.P + kalman.P.T)
        value[k], spread[k] = kalman.x, kalman.P
    return Track(tuple(problem.names), ends, value, spread)


def _predicted_ahead(
    problem: Problem, rows: Sequence[slice], track: Track, lag: int
) -> np.ndarray:
    """Torque less its prediction from the estimate ``lag`` stretches before [N m], (N, n); zero where there is none."""
    out = np.zeros_like(problem.torque)
    # value k belongs to stretch k, and predicts the one ``lag`` later
    for own, value in zip(rows[lag:], track.value, strict=False):
        out[own] = problem.rows(own).residual(value)
    return out


def kalman(problem: Problem) -> Estimate:
    """The last estimate of ``follow``, with the covariance of the filter.

    If friction wanders, it is friction as it was at the end of the last recording.

    Raises:
        InputError: the samples do not determine the parameters.

    Source: ljung1999.
    """
    track = follow(problem).track
    return finished(problem, track.value[-1], track.covariance[-1])


# State and friction at once, by an unscented filter, from encoders and torque alone.


LONGEST = 20.0
"""A recording is followed for at most this long [s]: a second takes about a second of computing."""
UNSURE = 0.3
"""Standard deviation of friction before the first sample, over its identified value [1]."""
WANDER = 0.1
"""How far friction wanders in one second, over that standard deviation [1/sqrt(s)]."""


@dataclass(frozen=True)
class StatesAndFriction:
    """What the unscented filter saw of one recording, n joints, N measurements.

    Attributes:
        recording: its name.
        start: identified b [N m s/rad] and c [N m], shape (2 n,).
        friction: b and c: ``b1.. c1..``, with times [s] and covariance.
        state: q [rad] and dq [rad/s] after each measurement, shape (N, 2 n).
        innovation: measured minus predicted over its standard deviation [1], shape (N, n).
    """

    recording: str
    start: np.ndarray
    friction: Track
    state: np.ndarray
    innovation: np.ndarray


def check_followed(arm: NominalArm, recording: Recording) -> None:
    """Check that ``follow_states`` can follow an arm; raises ``InputError`` otherwise."""
    remedy = "leave --filter unscented out; the recursive filter follows such an arm"
    if arm.coupling is not None:
        raise InputError(
            "the unscented filter knows no motor that turns several joints",
            remedy,
            where="--filter",
        )
    check_bare(recording, remedy)
    if recording.tau is None:
        raise InputError("has no torque", "give columns tau1..", file=recording.name)


def follow_states(
    arm: NominalArm,
    recording: Recording,
    identified: Mapping[str, float],
    noise: np.ndarray,
) -> StatesAndFriction:
    """Unscented Kalman filter over x = (q, dq, theta), with the recorded torque as input and the encoders as output.

    q and dq follow the arm's forward dynamics with the friction of each joint moved by theta, a random walk. It needs
    neither differentiated positions nor zero-phase filters, so it may run while recording; and it does not need the
    controller.

    Args:
        arm: without motors that turn several joints.
        recording: with torque; its first ``LONGEST`` seconds are used.
        identified: parameters by the names of ``gapscope.ident.model.regressor``, such as ``m3`` or ``c2``.
        noise: RMS residual of the identified arm [N m], shape (n,).

    Raises:
        InputError: coupled motors, no torque, or a known payload.
        GapscopeError: the filter lost the arm.

    Source: julier2004.
    """
    check_followed(arm, recording)
    assert recording.tau is not None
    recording = recording.part(recording.t <= recording.t[0] + LONGEST)
    n, regressor = arm.n_joints, Regressor(arm)
    prior = np.array([identified.get(name, 0.0) for name in regressor.names])
    # b and c of the joints follow each other, behind ten parameters of each link and the rotors
    own = slice(11 * n, 13 * n)
    # torque between two measurements counts by its mean
    rows = np.arange(0, len(recording.t), max(1, round(recording.rate / MODEL_RATE)))
    t, q = recording.t[rows], recording.q[rows]
    counts = np.diff([*rows, len(recording.t)])
    tau = np.add.reduceat(np.asarray(recording.tau), rows) / counts[:, None]
    period = float(np.median(np.diff(t)))
    speed = rms(np.gradient(recording.q, recording.t, axis=0))
    # a joint without friction may have some worth naming
    torque = WORTH * rms(np.asarray(recording.tau))
    # b counts by its torque at the usual speed, c is a torque itself
    least = np.concatenate([torque / np.maximum(speed, MOVING), torque])
    spread = np.maximum(UNSURE * np.abs(prior[own]), least)
    count = max(1, round(period / (2 * LONGEST_STEP)))
    # the stepper counts joints in the order of the bodies, the case in its own
    to_body, to_case = regressor.body.order, regressor.body.places
    stepper = Stepper(regressor.body, prior[None], period / count)

    def after(x: np.ndarray, dt: float, torque: np.ndarray) -> np.ndarray:
        """The state after some time [s] under a torque [N m]."""
        parameters = prior.copy()
        parameters[own] += x[2 * n :]
        # each sigma point has its own arm
        stepper.set_parameters(parameters[None])
        stepper.dt = dt / count
        q, dq = x[:n][None, to_body], x[n : 2 * n][None, to_body]
        for _ in range(count):
            q, dq = stepper(q, dq, torque[None, to_body])
        return np.concatenate([q[0, to_case], dq[0, to_case], x[2 * n :]])

    # state: q, dq and the departures of b and c, n of each
    kalman = UnscentedKalmanFilter(
        4 * n,
        n,
        period,
        hx=lambda x: x[:n],
        fx=after,
        points=MerweScaledSigmaPoints(4 * n, alpha=0.3, beta=2.0, kappa=0.0),
    )
    # noise of the encoders: white noise of deviation s has second differences of sqrt(6) s; rounding, if that is more
    second = np.diff(recording.q, 2, axis=0)
    seen = np.median(np.std(second, axis=0)) / np.sqrt(6)
    rounding = (arm.encoder_step or 0.0) / np.sqrt(12)
    encoder = np.full(n, max(seen, rounding, ROUNDING))
    # velocity and departures start at zero: the prior is in the dynamics
    kalman.x = np.concatenate([q[0], np.zeros(3 * n)])
    # an arm that moves already may be as fast as it is on the whole
    kalman.P = np.diag(np.concatenate([encoder, speed, spread]) ** 2)
    kalman.R = np.diag(encoder**2)
    # torque that is not modelled acts on the velocities
    inertia = np.diag(regressor.body.mass_matrix(q[0])) + arm.armature
    wander = WANDER * spread * np.sqrt(period)
    # positions follow from velocities: beside the encoder they hardly err
    process = np.concatenate([0.1 * encoder, noise / inertia * period, wander])
    kalman.Q = np.diag(process**2)
    value, covariance = [kalman.x], [kalman.P]
    innovation = np.zeros((len(t), n))
    for k in range(1, len(t)):
        try:
            # the torque of a period acts until the next measurement
            kalman.predict(dt=t[k] - t[k - 1], torque=tau[k - 1])
            kalman.update(q[k])
        except np.linalg.LinAlgError as error:
            raise GapscopeError(
                f"the filter lost the arm at t = {t[k]:.3g} s",
                "check (a) units and signs of the torque, (b) that the identified bodies are possible, (c) the noise",
            ) from error
        # whitened by their own covariance: joints are independent then
        innovation[k] = np.linalg.solve(np.linalg.cholesky(kalman.S), kalman.y)
        value.append(kalman.x)
        covariance.append(kalman.P)
    start, states = prior[own], np.array(value)
    of_friction = np.array(covariance)[:, 2 * n :, 2 * n :]
    moved = start + states[:, 2 * n :]
    friction = Track(regressor.names[own], t, moved, of_friction)
    state = states[:, : 2 * n]
    return StatesAndFriction(recording.name, start, friction, state, innovation)


# The filter beside the batch: when it converged, where it departs, whether its innovations are white.


class Departure(NamedTuple):
    """A parameter whose estimate at some moment excludes the batch's.

    Its place among the base parameters, the stretch in which it is farthest off, and by how many of the filter's
    standard errors [1].
    """

    parameter: int
    stretch: int
    size: float


@dataclass(frozen=True)
class FilterReview(Followed):
    """A filter beside the batch estimate, K stretches of n joints, b parameters; ``batch`` is what it is compared with.

    Attributes:
        recordings: name of the recording of each stretch, K of them.
        times: time in it at the end of each stretch [s], shape (K,).
        converged: number of the first stretch from which on the uncertainty of the parameters adds less to the
            predicted torque than its noise; ``None`` if there is none.
        departures: after that, one for each parameter that departs by more than chance, the farthest first.
        whiteness: of the innovations after that.
        rms: RMS of the innovations after that over the RMS residual of the batch [1], shape (n,).
        changes: those that the filter was told of: there it started anew with what changed.
        moved: by how much each of them moved the parameters, shape (C, b).
    """

    recordings: tuple[str, ...]
    times: np.ndarray
    converged: int | None
    departures: tuple[Departure, ...]
    whiteness: Whiteness
    rms: np.ndarray
    changes: tuple[Change, ...]
    moved: np.ndarray


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
        here, time = names == found.recording, samples.times
        after = np.flatnonzero(here & (time > found.time))
        if len(after):
            # a unit of the change as parameters, as far as its torque looks like theirs
            D = _moved(found, problem, names, time)
            # unknown after the moment, and again where the recording ends if another follows
            # mean square value^2 + deviation^2: about as large as found, of any sign
            covariance = (D * (found.value**2 + found.deviation**2)) @ D.T
            openings += [(int(k), covariance) for k in (after[0], after[-1] + 1)]
            told.append(found)
            moved.append(D @ found.value)
    openings = [own for own in openings if own[0] < len(names)]
    openings.sort(key=lambda opening: opening[0])
    followed = follow(problem, openings)
    rows, track = followed.rows, followed.track
    batch = followed.batch if batch is None else batch
    # from which stretch on W P W^T, the variance that the estimate before it adds, is below that of the noise
    first = 1
    for k in range(1, len(rows)):
        W = problem.matrix[rows[k]]
        spread = W @ track.covariance[k - 1]
        added = np.einsum("mja,mja->mj", spread, W) / followed.noise**2
        if added.mean() > 1:
            first = k + 1
    converged = first if first < len(rows) else None
    departures = []
    # before that the estimate is too vague to contradict the batch
    if converged is not None:
        deviation = np.maximum(track.deviation[converged:], TINY)
        size = np.abs(track.value[converged:] - batch) / deviation
        # beyond this one parameter of all departs by chance
        most = norm.isf(DOUBT / (2 * len(batch)))
        for i, k in enumerate(size.argmax(axis=0)):
            if size[k, i] > most:
                departures.append(Departure(i, converged + int(k), float(size[k, i])))
        departures.sort(key=lambda departure: -departure.size)
    else:
        # innovations count from where it should have settled
        first = min(max(1, len(rows) // 2), len(rows) - 1)
    counted = slice(rows[first].start, None)
    ends = [own.stop - 1 for own in rows]
    innovation = followed.innovation[counted]
    white = whiteness(
        innovation,
        problem.group[counted],
        1.0 / problem.interval[counted],
        samples.cutoff,
    )
    return FilterReview(
        **vars(followed) | {"batch": batch},
        recordings=tuple(names[ends].tolist()),
        times=samples.times[ends],
        converged=converged,
        departures=tuple(departures),
        whiteness=white,
        rms=rms(innovation),
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
    # N n rows of equations, one for each joint
    W = problem.matrix.reshape(torque[..., 0].size, -1)
    scale = np.linalg.norm(W, axis=0)
    right = torque.reshape(len(W), -1)
    return np.linalg.lstsq(W / scale, right, rcond=ROUNDING)[0] / scale[:, None]
