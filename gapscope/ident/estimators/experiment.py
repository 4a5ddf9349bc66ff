"""What an estimator that simulates needs beside the linear problem: the arm, its controller and its commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from gapscope.arm.control import PD, feedforward
from gapscope.arm.dynamics.rigid_body import ArrayCache
from gapscope.arm.dynamics.rollout import (
    Commands,
    Plant,
    RollOut,
    roll_outs,
    sensitivity,
    ticks_per_step,
)
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.recording import Recording
from gapscope.arm.velocity_filter import rule_of
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.checks.plausible_samples import check_bare, check_controller
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.linear_problem import Problem, check_samples
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor
from gapscope.model.conditioning import GAP_STEPS

AT_REST = 1e-3
"""A reference that starts slower than this starts at rest [rad/s]."""


@dataclass(frozen=True)
class Experiment:
    """Recordings under a known controller, and how to repeat them with other parameters.

    Attributes:
        regressor: of the nominal arm.
        base: its base parameters, which are the problem's.
        controller: that made the recordings' torque.
        recordings: with q_ref and tau, without gaps.
        build: from recordings to the problem; it made the problem from the measured ones, and is given simulated ones,
            so that filtering and differentiation change both alike.
        prior: parameters pi near which the simulated arm stays if the data do not decide, shape (p,); those of the
            nominal arm by default.
        settle: how long a reference that starts at rest was held before the recording [s].
        warnings: what was noticed about controller and recordings.

    Raises:
        InputError: a recording has no reference, no torque or a gap, or its torque contradicts the controller.
    """

    regressor: Regressor
    base: BaseParameters
    controller: PD
    recordings: Sequence[Recording]
    build: Callable[[Sequence[Recording]], Problem]
    prior: np.ndarray = None  # type: ignore[assignment]
    settle: float = 0.5
    warnings: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        """Check the recordings and fill in the prior."""
        if self.prior is None:
            object.__setattr__(self, "prior", self.regressor.nominal())
        warnings: list[str] = []
        for recording, commands in zip(self.recordings, self.commands, strict=True):
            warnings += check_controller(
                recording, self.controller, commands, self._limit
            )
        object.__setattr__(self, "warnings", tuple(warnings))

    @property
    def _limit(self) -> np.ndarray | None:
        return self.regressor.arm.torque_limit

    @cached_property
    def commands(self) -> tuple[Commands, ...]:
        """Reference and feedforward of each recording at the controller's ticks from the recording's first row on."""
        return tuple(self._commands(recording) for recording in self.recordings)

    @property
    def start(self) -> np.ndarray:
        """Base parameters of the prior, shape (b,)."""
        return self.base.of(self.prior)

    def plant(self, beta: np.ndarray) -> Plant:
        """The arm with base parameters beta, nearest to the prior."""
        return Plant.of(self._full(self.base.nearest(beta, self.prior)))

    def simulate(self, beta: np.ndarray) -> tuple[Recording, ...]:
        """The recordings as an arm with base parameters beta, without noise, would have made them.

        Raises:
            GapscopeError: the arm diverged.
        """
        return tuple(
            self._recorded(k, rolled) for k, rolled in enumerate(self._rolled(beta))
        )

    def problem(self, beta: np.ndarray) -> Problem:
        """The problem that the simulated recordings make."""
        return self.build(self.simulate(beta))

    def tangents(
        self, beta: np.ndarray
    ) -> tuple[tuple[Recording, np.ndarray, np.ndarray], ...]:
        """Simulated recordings with d q / d beta [rad] and d tau / d beta [N m], each of shape (N, n, b)."""
        rolled = self._rolled(beta)
        directions = self._directions()
        every = ticks_per_step(self.controller)
        out: dict[int, tuple[Recording, np.ndarray, np.ndarray]] = {}
        for rule, members in self._alike.items():
            along = sensitivity(
                self.regressor.body,
                self.plant(beta),
                self.controller,
                [rolled[k] for k in members],
                directions,
                self._limit,
                rule,
            )
            for k, (by_q, by_tau) in zip(members, along, strict=True):
                rows = self._rows(k) / every
                simulated = self._recorded(k, rolled[k])
                out[k] = (simulated, _at(rows, by_q), _at(rows, by_tau))
        return tuple(out[k] for k in range(len(self.recordings)))

    def check(self, problem: Problem) -> None:
        """Check that a problem is one of these recordings and determines the parameters, or raise ``InputError``."""
        if problem.matrix.shape[2] != self.base.count:
            raise InputError(
                f"the problem has {problem.matrix.shape[2]} parameters, the experiment {self.base.count}",
                "make the problem with the base parameters of the experiment",
            )
        check_samples(problem)

    @cached_property
    def _alike(self) -> dict[str, list[int]]:
        """Numbers of the recordings whose controller discretised its filter alike, by that rule."""
        rules = [rule_of(recording, self.controller) for recording in self.recordings]
        return {
            rule: [k for k, own in enumerate(rules) if own == rule]
            for rule in dict.fromkeys(rules)
        }

    @cached_property
    def _recent(self) -> ArrayCache:
        """Roll-outs of the last parameters: an estimator asks for those of one point more than once."""
        return ArrayCache()

    def _full(self, parameters: np.ndarray) -> np.ndarray:
        """Parameters in the order of ``Plant.of``; quantities without a column keep the sheet's values; (14 n,)."""
        arm = self.regressor.arm
        n = arm.n_joints
        nominal = CorrectedArm(arm)
        laws = {name: nominal.quantity(name) for name in JOINT_COLUMNS}
        for k, name in enumerate(self.regressor.quantities):
            laws[name] = parameters[(10 + k) * n : (11 + k) * n]
        return np.concatenate([parameters[: 10 * n], *laws.values()])

    def _directions(self) -> np.ndarray:
        """Change of the parameters of ``_full`` per unit of each base parameter, shape (14 n, b)."""
        increments = np.linalg.pinv(self.base.combination)
        # the sheet's values that are not estimated cancel
        constant = self._full(np.zeros(len(increments)))
        columns = [self._full(column) - constant for column in increments.T]
        return np.stack(columns, axis=1)

    def _rolled(self, beta: np.ndarray) -> tuple[RollOut, ...]:
        """Roll-outs of all recordings, computed or remembered."""
        flat = self._recent.get("roll-outs", (beta,), lambda: self._computed(beta))
        return tuple(
            RollOut(*flat[5 * k : 5 * k + 5]) for k in range(len(self.recordings))
        )

    def _computed(self, beta: np.ndarray) -> tuple[np.ndarray, ...]:
        """The arrays of the roll-outs, one after the other."""
        body, plant = self.regressor.body, self.plant(beta)
        rolled: dict[int, RollOut] = {}
        for rule, members in self._alike.items():
            commands, starts = zip(*map(self._begun, members), strict=True)
            found = roll_outs(
                body, plant, self.controller, commands, self._limit, starts, rule
            )
            rolled |= dict(zip(members, found, strict=True))
        arrays: list[np.ndarray] = []
        for k in sorted(rolled):
            one = rolled[k]
            arrays += [one.t, one.q, one.dq, one.tau, one.speed]
        return tuple(arrays)

    def _begun(self, k: int) -> tuple[Commands, tuple[np.ndarray, np.ndarray]]:
        """Commands of a recording, held before a start at rest, and the position and velocity at their start."""
        commands, recording = self.commands[k], self.recordings[k]
        ticks = self._ticks_held(k)
        if ticks:
            return _held(commands, ticks), (commands.q[0], commands.dq[0])
        return commands, (recording.q[0], commands.dq[0])

    def _ticks_held(self, k: int) -> int:
        """Ticks for which a reference that starts at rest was held before the recording."""
        rests = np.abs(self.commands[k].dq[0]).max() < AT_REST
        return round(self.settle * self.controller.rate) if rests else 0

    def _rows(self, k: int) -> np.ndarray:
        """Ticks of a roll-out at which the recording has its rows, shape (N,)."""
        t = self.recordings[k].t
        ticks = (t - t[0]) * self.controller.rate + 1e-6
        return self._ticks_held(k) + ticks.astype(int)

    def _recorded(self, k: int, rolled: RollOut) -> Recording:
        own, rows = self.recordings[k], self._rows(k)
        return Recording(
            name=own.name,
            t=own.t,
            q=rolled.q[rows],
            tau=rolled.tau[rows],
            dq=rolled.dq[rows],
            q_ref=own.q_ref,
            dq_ref=own.dq_ref,
        )

    def _commands(self, recording: Recording) -> Commands:
        check_bare(recording)
        t, q_ref = recording.t, recording.q_ref
        if q_ref is None or recording.tau is None:
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
        ticks = (
            t[0]
            + np.arange(int((t[-1] - t[0]) * self.controller.rate + 1e-6) + 2)
            / self.controller.rate
        )
        held = np.minimum(ticks, t[-1])
        dq_ref = (
            make_interp_spline(t, q_ref, k=3)(t, 1)
            if recording.dq_ref is None
            else recording.dq_ref
        )
        velocity = make_interp_spline(t, dq_ref, k=3)
        q, dq, ddq = (
            CubicHermiteSpline(t, q_ref, dq_ref)(held),
            velocity(held),
            velocity(held, 1),
        )
        arm, body = self.regressor.arm, self.regressor.body
        return Commands(
            t=ticks,
            q=q,
            dq=dq,
            torque=feedforward(arm, body, self.controller.feedforward, q, dq, ddq),
        )


def _at(rows: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Rows of a series, numbers between two of them interpolated."""
    last = len(series) - 1
    below = np.minimum(rows.astype(int), last)
    share = (rows - below)[:, None, None]
    if not share.any():
        return series[below]
    above = np.minimum(below + 1, last)
    return (1 - share) * series[below] + share * series[above]


def _held(commands: Commands, ticks: int) -> Commands:
    """Commands after the first one was held for some ticks."""
    step = commands.t[1] - commands.t[0]
    earlier = commands.t[0] + step * np.arange(-ticks, 0)

    def extended(series: np.ndarray) -> np.ndarray:
        return np.concatenate([np.repeat(series[:1], ticks, axis=0), series])

    return Commands(
        t=np.concatenate([earlier, commands.t]),
        q=extended(commands.q),
        dq=extended(commands.dq),
        torque=extended(commands.torque),
    )


def diverged(error: GapscopeError, iteration: int) -> GapscopeError:
    """The error of an estimator whose simulated arm diverged, with its causes."""
    return GapscopeError(
        f"the simulated arm diverged in iteration {iteration} ({error.message})",
        "check (a) that gains, feedforward and reference are those of the recording, (b) that the start is near the "
        "arm: take the estimate of a linear estimator, or the data sheet, as the prior, (c) that the motion excites "
        "every parameter, so that no estimate makes the mass matrix negative",
    )
