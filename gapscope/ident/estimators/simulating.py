"""Estimators that simulate the loop: what they repeat, and instrumental variables, DIDIM, output error."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

from gapscope.arm.case import Case
from gapscope.arm.control import PD, SETTLE, Targets
from gapscope.arm.dynamics.rollout import (
    ClosedLoop,
    Commands,
)
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.table import GAP_STEPS
from gapscope.arm.nominal import FRICTION_SMOOTHING
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.arm.velocity_filter import VelocityFilter, rule_of
from gapscope.ident.estimators.linear import Estimate, weighted_least_squares
from gapscope.ident.intervals import jackknife
from gapscope.ident.model.base_parameters import TINY, WORTH, BaseParameters
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor
from gapscope.ident.samples import (
    AT_LIMIT,
    PER_CUTOFF,
    SMOOTH,
    FrictionLaw,
    Problem,
    Samples,
    check_bare,
    check_samples,
)
from gapscope.model.conditioning import TORQUE_CUTOFF, TRIM, low_pass

# Whether a recorded torque is what the declared controller commands; wrong gains ruin every simulated closed loop.


AGREES = 0.3
"""A torque whose feedback part differs by less than this share agrees with its controller [1]."""


def check_controller(
    recording: Recording,
    controller: PD,
    commands: Commands,
    rows: np.ndarray,
    limit: np.ndarray | None = None,
) -> list[str]:
    """Compare tau with feedforward + kp (q_ref - q) + kd (dq_ref - dq), both low-passed; warnings, one per joint.

    Args:
        recording: with q_ref and tau.
        controller: as declared.
        commands: its reference and feedforward at its ticks.
        rows: ticks of the recording's rows, (N,).
        limit: of the torque [N m], shape (n,); samples at it are not compared.

    Raises:
        InputError: other gains explain a joint's torque clearly better.
    """
    assert recording.tau is not None
    t, velocity = recording.t, recording.dq
    if velocity is None:
        # the controller's, at its ticks
        spline = make_interp_spline(t, recording.q, k=3)
        q = spline(np.clip(commands.t, t[0], t[-1]))
        filtered = VelocityFilter(
            controller.estimate,
            q[0],
            commands.dq[0],
        )
        velocity = np.array([filtered(row) for row in q])[rows]
    terms = [
        recording.tau - commands.torque[rows],
        controller.kp * (commands.q[rows] - recording.q),
        controller.kd * (commands.dq[rows] - velocity),
    ]
    edge = int(TRIM * recording.rate)
    inner = slice(edge, len(rows) - edge)
    feedback, stiff, damped = (
        low_pass(x, recording.rate, TORQUE_CUTOFF)[inner] for x in terms
    )
    most = np.inf if limit is None else AT_LIMIT * limit
    free = (np.abs(recording.tau) < most)[inner]
    spread = recording.tau.std(axis=0)
    found = []
    for j, rows_free in enumerate(free.T):
        own = feedback[rows_free, j]
        columns = np.column_stack([stiff[rows_free, j], damped[rows_free, j]])
        size, error = rms(own), rms(own - columns.sum(axis=1))
        # within what noise may do
        if error < max(AGREES * size, WORTH * spread[j]):
            continue
        scale = np.linalg.lstsq(columns, own, rcond=None)[0]
        # other gains that explain most of it: a wrong gain or unit; otherwise another controller
        if rms(own - columns @ scale) < error / 2:
            raise InputError(
                f"the torque of joint {j + 1} fits kp times {scale[0]:.3g} and kd times {scale[1]:.3g}",
                "correct the gains, or their unit, in controller:; a simulated closed loop needs those of the "
                "recording",
                file=recording.name,
                where="controller.kp, controller.kd",
            )
        found.append(
            f"{recording.name}: {error / size:.0%} of the feedback torque of joint {j + 1} is not what the controller "
            "commands; check feedforward, delay, and whether the recorded torque is the command"
        )
    return found


# What an estimator that simulates needs beside the linear problem: the arm, its controller and its commands.


@dataclass(frozen=True)
class Experiment:
    """Recordings under a known controller, and how to repeat them with other parameters.

    Attributes:
        regressor: of the nominal arm, with all of ``JOINT_COLUMNS``.
        base: its base parameters, which are the problem's.
        controller: that made the recordings' torque.
        recordings: with q_ref and tau, without gaps.
        build: from recordings to the problem; it made the problem from the measured ones, and is given simulated ones,
            so that filtering and differentiation change both alike.
        prior: parameters pi near which the simulated arm stays if the data do not decide, shape (p,).

    Raises:
        InputError: a recording has no reference, no torque or a gap, or its torque contradicts the controller.
    """

    regressor: Regressor
    base: BaseParameters
    controller: PD
    recordings: Sequence[Recording]
    build: Callable[[Sequence[Recording]], Problem]
    prior: np.ndarray

    def __post_init__(self) -> None:
        """Check the recordings."""
        assert self.warnings is not None

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What was noticed about controller and recordings."""
        found = []
        limit = self.regressor.arm.torque_limit
        for own, (commands, rows) in zip(self.recordings, self._commanded, strict=True):
            found += check_controller(own, self.controller, commands, rows, limit)
        return tuple(found)

    @property
    def start(self) -> np.ndarray:
        """Base parameters of the prior, shape (b,)."""
        return self.base.of(self.prior)

    def simulate(self, *betas: np.ndarray) -> tuple[Recording, ...]:
        """The recordings as arms with base parameters beta, without noise, would have made them, arm by arm.

        Raises:
            GapscopeError: an arm diverged.
        """
        runs = list(zip(self.recordings, self._commanded, strict=True)) * len(betas)
        arms = np.array([self._parameters(beta) for beta in betas])
        rolled = self._loop.roll_outs(
            np.repeat(arms, len(self.recordings), axis=0),
            [commands for _, (commands, _) in runs],
            # one that was held at rest begins on its reference
            [
                (commands.q[0] if rows[0] else own.q[0], commands.dq[0])
                for own, (commands, rows) in runs
            ],
        )
        return tuple(
            replace(own, q=x.q[rows], tau=x.tau[rows], dq=x.dq[rows], tau_sensor=None)
            for (own, (_, rows)), x in zip(runs, rolled, strict=True)
        )

    def problem(self, beta: np.ndarray) -> Problem:
        """The problem that the simulated recordings make."""
        return self.build(self.simulate(beta))

    def check(self, problem: Problem) -> None:
        """Check that a problem is one of these recordings and determines the parameters, or raise ``InputError``."""
        if problem.matrix.shape[2] != self.base.count:
            raise InputError(
                f"the problem has {problem.matrix.shape[2]} parameters, the experiment {self.base.count}",
                "make the problem with the base parameters of the experiment",
            )
        check_samples(problem)

    @cached_property
    def _loop(self) -> ClosedLoop:
        """The arm and its controller, which discretises its velocity filter as the longest recording shows."""
        longest = max(self.recordings, key=lambda recording: recording.duration)
        return ClosedLoop(
            self.regressor.body,
            self.controller,
            self.regressor.arm.torque_limit,
            rule_of(longest, self.controller),
        )

    @cached_property
    def _order(self) -> np.ndarray:
        """Places of the parameters in the order of ``ClosedLoop``, (14 n,)."""
        n, quantities = self.regressor.arm.n_joints, self.regressor.quantities
        blocks = [10 + quantities.index(name) for name in JOINT_COLUMNS]
        return np.concatenate(
            [np.arange(k * n, k * n + n) for k in (*range(10), *blocks)]
        )

    def _parameters(self, beta: np.ndarray) -> np.ndarray:
        """Those of the arm with base parameters beta, nearest to the prior, (14 n,)."""
        return self.base.nearest(beta, self.prior)[self._order]

    @cached_property
    def _commanded(self) -> list[tuple[Commands, np.ndarray]]:
        """Commands of each recording, held before a start at rest, and the ticks at which it has its rows, (N,)."""
        return [self._commands(recording) for recording in self.recordings]

    def _commands(self, recording: Recording) -> tuple[Commands, np.ndarray]:
        check_bare(
            recording,
            "leave the recording out, or use an estimator that does not simulate",
        )
        t = recording.t
        if recording.q_ref is None or recording.tau is None:
            raise InputError(
                "has no reference or no torque, which an estimator that simulates needs",
                "give columns q_ref1.. and tau1.., or use an estimator that does not simulate",
                file=recording.name,
            )
        if (np.diff(t) > GAP_STEPS / recording.rate).any():
            raise InputError(
                "has a gap in time",
                "cut it there into two recordings",
                file=recording.name,
            )
        rate = self.controller.rate
        before, rows = round(SETTLE * rate), ((t - t[0]) * rate + 1e-6).astype(int)
        ticks = t[0] + np.arange(-before, rows[-1] + 2) / rate
        arm = self.regressor.arm
        targets = Targets.recorded(arm, self.controller, recording, ticks)
        # slower than the smoothing of friction is at rest
        if np.abs(targets.dq[before]).max() < FRICTION_SMOOTHING:
            rows += before
        else:
            ticks, targets = ticks[before:], targets.at(slice(before, None))
        return Commands(ticks, targets.q, targets.dq, targets.torque), rows


def closed_loop(
    case: Case,
    fit: Sequence[Recording],
    samples: Samples,
    base: BaseParameters,
    problem: Problem,
) -> Experiment:
    """The fitted recordings of a case with their controller; estimators start from least squares.

    Raises:
        InputError: the controller is not known, or a recording cannot be repeated.
    """
    if case.controller is None:
        raise InputError(
            "an estimator that simulates needs the controller that moved the arm",
            "describe it in controller:, or use an estimator that does not simulate",
            file=case.file,
            where="controller",
        )
    if not isinstance(case.controller, PD):
        raise InputError(
            f"an estimator that simulates knows the law pd, not {case.controller.kind}",
            "use an estimator that does not simulate",
            file=case.file,
            where="controller.kind",
        )
    columns, law = samples.columns, FrictionLaw()
    if columns.coupled:
        raise InputError(
            "an estimator that simulates cannot have motors that turn several joints",
            "use an estimator that does not simulate",
            where="nominal.coupling",
        )

    def build(recordings: Sequence[Recording]) -> Problem:
        own = samples.of(recordings, samples.thinning)
        return own.problem(law, base.kept, problem.names)

    # the order of the columns of the model
    regressor = Regressor(case.arm, columns.body, (*SMOOTH, "friction"))
    first = weighted_least_squares(problem).value
    start = base.nearest(first, columns.nominal(law))
    return Experiment(regressor, base, case.controller, fit, build, start)


# What the estimators that simulate have in common: checks, steps, and how an iteration ends.


ITERATIONS = 25
"""Steps at most."""
SAME = 0.01
"""They end when the simulated torque moves by less than this share of the error [1]."""
NOT_SETTLED = (
    "did not settle: (a) gains, feedforward or reference may not be those of the recording, (b) the start may be too "
    "far from the arm, (c) an effect that the model lacks, such as elasticity or delay, may shape the motion"
)


class Simulated(NamedTuple):
    """Parameters, (b,), the problem that the arm simulated with them makes, and the RMS torque missed [N m], (n,)."""

    beta: np.ndarray
    problem: Problem
    error: np.ndarray


def _iterated(
    problem: Problem,
    experiment: Experiment,
    goal: Callable[[Simulated], np.ndarray],
) -> tuple[Simulated, bool]:
    """Repeat the recordings, beta by beta, until the simulated torque stays; and whether it does.

    Each step goes to what ``goal`` says of a simulation, (b,). It is halved while the arm diverges or the torque fits
    clearly worse.

    Raises:
        InputError: too few samples, or a problem that is not the experiment's.
        GapscopeError: the simulated arm diverges, at the start or after the last halving.
    """
    experiment.check(problem)

    def simulated(beta: np.ndarray) -> Simulated:
        own = experiment.problem(beta)
        if own.torque.shape != problem.torque.shape:
            raise InputError(
                f"the problem has samples {problem.torque.shape}, its recordings make {own.torque.shape}",
                "make the problem from the recordings of the experiment, in their order",
            )
        return Simulated(beta, own, rms(problem.torque - own.torque))

    with _divergence(0):
        now = simulated(experiment.start)
    for iteration in range(1, ITERATIONS + 1):
        before, step = now, goal(now) - now.beta
        share = 1.0
        # halved while the arm diverges or the torque fits worse, down to what counts as the same
        while now is before and share > SAME:
            last = share / 2 <= SAME
            with _divergence(iteration) if last else suppress(GapscopeError):
                there = simulated(before.beta + share * step)
                if np.mean((there.error / before.error) ** 2) < (1 + WORTH) ** 2:
                    now = there
            share /= 2
        moved = now.problem.torque - before.problem.torque
        if (rms(moved) <= SAME * now.error).all():
            return now, True
    return now, False


@contextmanager
def _divergence(iteration: int) -> Iterator[None]:
    """Say of a simulated arm that diverges in which iteration, and why that may be."""
    try:
        yield
    except InputError:
        raise
    except GapscopeError as error:
        raise GapscopeError(
            f"the simulated arm diverged in iteration {iteration} ({error.message})",
            "check (a) that gains, feedforward and reference are those of the recording, (b) that the start is near "
            "the arm: take the estimate of a linear estimator, or the data sheet, as the prior, (c) that the motion "
            "excites every parameter, so that no estimate makes the mass matrix negative",
        ) from error


def _estimate(
    problem: Problem,
    beta: np.ndarray,
    left: np.ndarray,
    equations: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    warnings: tuple[str, ...],
) -> Estimate:
    """The estimate that leaves an RMS [N m], (n,), with the interval of the equations that it solves.

    Without one stretch of time after the other: errors of a simulation follow the motion, so that samples are far from
    independent.
    """
    known = jackknife(*equations)
    return Estimate(
        problem.names, beta, known.covariance, left, warnings, known.freedom
    )


# DIDIM: direct and inverse dynamic identification; only the torque is compared, the motion is simulated.


def direct_inverse(problem: Problem, experiment: Experiment) -> Estimate:
    """Gauss-Newton on measured minus simulated torque, with the simulated motion's regressor as Jacobian.

    beta <- beta + argmin |S^-1/2 (tau - tau_s(beta) - W_s(beta) d)|, tau_s the torque of the closed loop simulated with
    beta, W_s the regressor of its motion, S the joints' error variances. Measured positions are not used at all, so
    that their noise cannot bias the result. The controller keeps the motion near the reference whatever beta is, which
    is why W_s serves as Jacobian.

    Raises:
        InputError, GapscopeError: see ``_iterated``.

    Source: gautier2013.
    """

    def weighted(now: Simulated) -> tuple[np.ndarray, np.ndarray]:
        """W_s, (N, n, b), and recorded less simulated torque, (N, n), over the error."""
        weight = 1.0 / np.maximum(now.error, TINY)
        residual = (problem.torque - now.problem.torque) * weight
        return now.problem.matrix * weight[:, None], residual

    def goal(now: Simulated) -> np.ndarray:
        matrix, residual = weighted(now)
        flat = matrix.reshape(residual.size, -1)
        return now.beta + np.linalg.lstsq(flat, residual.ravel(), rcond=None)[0]

    now, settled = _iterated(problem, experiment, goal)
    warnings = experiment.warnings + (() if settled else (f"DIDIM {NOT_SETTLED}",))
    matrix, residual = weighted(now)
    equations = matrix, matrix, residual, problem.group
    return _estimate(problem, now.beta, now.error, equations, warnings)


# IDIM-IV: the inverse dynamic model with instruments from a simulated, noise-free motion.


def instrumental_variables(problem: Problem, experiment: Experiment) -> Estimate:
    """beta <- (Z^T S^-1 W)^-1 Z^T S^-1 tau, with Z the regressor of the closed loop simulated with the beta before.

    W is made from measured positions, whose noise enters their derivatives and, through the controller, the torque;
    least squares are biased by it. Z does not depend on that noise, and is correlated with the true W.

    Raises:
        InputError, GapscopeError: see ``_iterated``.

    Source: janot2014.
    """

    def goal(now: Simulated) -> np.ndarray:
        weight = 1.0 / np.maximum(rms(problem.residual(now.beta)), TINY)
        Z = now.problem.matrix * weight[:, None] ** 2
        gram = np.einsum("ija,ijb->ab", Z, problem.matrix)
        right = np.einsum("ija,ij->a", Z, problem.torque)
        own = np.einsum("ija,ija->a", Z, now.problem.matrix)
        scale = np.sqrt(np.abs(own))
        return np.linalg.solve(gram / np.outer(scale, scale), right / scale) / scale

    now, settled = _iterated(problem, experiment, goal)
    warnings = experiment.warnings + (() if settled else (f"IDIM-IV {NOT_SETTLED}",))
    beta = goal(now) if settled else now.beta
    residual = problem.residual(beta)
    error = np.maximum(rms(residual), TINY)
    left, right = (x / error[:, None] for x in (now.problem.matrix, problem.matrix))
    equations = left, right, residual / error, problem.group
    return _estimate(problem, beta, error, equations, warnings)


# Closed-loop output error: position and torque of the simulated closed loop against the measured ones.


ROUNDS = 2
"""Rounds of weighting."""
STEP = np.cbrt(np.finfo(float).eps)
"""Step of differences, of parameters above 1 their share: a roll-out is smooth, and loses some digits [1]."""


def output_error(problem: Problem, experiment: Experiment) -> Estimate:
    """Minimises the sum of ((q - q_s) / s_q)^2 + ((tau - tau_s) / s_tau)^2 over beta, by trust region.

    q_s and tau_s are those of the closed loop simulated with beta; their derivatives are forward differences. s_q and
    s_tau are the joints' RMS errors, computed anew in every round. Both sides pass the same low-pass.

    Raises:
        InputError: too few samples, or a problem that is not the experiment's.
        GapscopeError: the simulated arm diverges at the start.

    Source: walter1997.
    """
    experiment.check(problem)
    parts = _outputs(experiment.recordings)
    measured, beta = np.concatenate(parts), experiment.start

    def missed(*arms: np.ndarray) -> np.ndarray:
        simulated = np.concatenate(_outputs(experiment.simulate(*arms)))
        return measured - simulated.reshape(-1, *measured.shape)

    with _divergence(0):
        error = missed(beta)[0]

    def residual(x: np.ndarray, scale: np.ndarray) -> np.ndarray:
        try:
            return (missed(x) / scale).ravel()
        except GapscopeError:  # so that the step is taken back
            return np.full(measured.size, np.inf)

    def slopes(x: np.ndarray, scale: np.ndarray) -> np.ndarray:
        steps = STEP * np.maximum(np.abs(x), 1.0)
        arms = np.vstack([x, x + np.diag(steps)])
        # about as many at once as a joint has parameters: series of all might not fit
        parts = [missed(*some) for some in np.array_split(arms, problem.n_joints)]
        here, *moved = (np.concatenate(parts) / scale).reshape(len(arms), -1)
        return (np.array(moved) - here).T / steps

    for _ in range(ROUNDS):
        scale = np.maximum(rms(error), TINY)
        fit = least_squares(
            residual,
            beta,
            slopes,
            args=(scale,),
            x_scale="jac",
            ftol=SAME**2,
            max_nfev=ITERATIONS,
        )
        beta, error = fit.x, fit.fun.reshape(error.shape) * scale
    warnings = experiment.warnings
    if fit.status <= 0:
        warnings += (f"output error {NOT_SETTLED}",)
    tangents = fit.jac.reshape(*error.shape, -1)
    group = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    left = rms(error[:, problem.n_joints :])
    equations = tangents, tangents, error / scale, group
    return _estimate(problem, beta, left, equations, warnings)


def _outputs(recordings: Sequence[Recording]) -> list[np.ndarray]:
    """Position and torque of each recording, filtered, trimmed and decimated, (M, 2 n)."""
    found = []
    for own in recordings:
        series, rate = np.hstack([own.q, np.asarray(own.tau)]), own.rate
        edge, step = int(TRIM * rate), max(1, int(rate / (PER_CUTOFF * TORQUE_CUTOFF)))
        inner = slice(edge, len(series) - edge, step)
        found.append(low_pass(series, rate, TORQUE_CUTOFF)[inner])
    return found
