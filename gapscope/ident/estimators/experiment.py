"""What an estimator that simulates needs beside the linear problem: the arm, its controller and its commands."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from gapscope.arm.control import PD, feedforward
from gapscope.arm.dynamics.rollout import (
    Commands,
    Plant,
    RollOut,
    roll_outs,
    sensitivity,
    ticks_per_step,
)
from gapscope.arm.errors import InputError
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
SETTLE = 0.5
"""How long a reference that starts at rest was held before the recording [s]."""


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
        pairs = zip(self.recordings, self.commands, strict=True)
        limit = self.regressor.arm.torque_limit
        found = (check_controller(r, self.controller, c, limit) for r, c in pairs)
        return tuple(itertools.chain.from_iterable(found))

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
        pairs = zip(self.recordings, self._rolled(beta), strict=True)
        return tuple(
            replace(
                own,
                q=rolled.q[rows],
                tau=rolled.tau[rows],
                dq=rolled.dq[rows],
                tau_sensor=None,
            )
            for rows, (own, rolled) in zip(self._rows, pairs, strict=True)
        )

    def problem(self, beta: np.ndarray) -> Problem:
        """The problem that the simulated recordings make."""
        return self.build(self.simulate(beta))

    def tangents(
        self, beta: np.ndarray
    ) -> tuple[tuple[Recording, np.ndarray, np.ndarray], ...]:
        """Simulated recordings with d q / d beta [rad] and d tau / d beta [N m], each of shape (N, n, b)."""
        along = sensitivity(
            self.regressor.body,
            self.plant(beta),
            self.controller,
            self._rolled(beta),
            self._directions(),
            self.regressor.arm.torque_limit,
            self._rule,
        )
        out = []
        whole = zip(self.simulate(beta), self._rows, along, strict=True)
        for simulated, rows, both in whole:
            # numbers between two rows of a series interpolated
            steps = np.arange(len(both[0]))
            at = np.minimum(rows / ticks_per_step(self.controller), steps[-1])
            by_q, by_tau = (make_interp_spline(steps, x, k=1)(at) for x in both)
            out.append((simulated, by_q, by_tau))
        return tuple(out)

    def check(self, problem: Problem) -> None:
        """Check that a problem is one of these recordings and determines the parameters, or raise ``InputError``."""
        if problem.matrix.shape[2] != self.base.count:
            raise InputError(
                f"the problem has {problem.matrix.shape[2]} parameters, the experiment {self.base.count}",
                "make the problem with the base parameters of the experiment",
            )
        check_samples(problem)

    @cached_property
    def _rule(self) -> str:
        """How the controller discretises its velocity filter: what the longest recording shows."""
        longest = max(self.recordings, key=lambda recording: recording.duration)
        return rule_of(longest, self.controller)

    @cached_property
    def _last(self) -> dict[bytes, tuple[RollOut, ...]]:
        """Roll-outs of the last parameters: an estimator asks for those of one point more than once."""
        return {}

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
        key = beta.tobytes()
        if key not in self._last:
            self._last.clear()
            begun = map(self._begun, range(len(self.recordings)))
            commands, starts = zip(*begun, strict=True)
            self._last[key] = roll_outs(
                self.regressor.body,
                self.plant(beta),
                self.controller,
                commands,
                self.regressor.arm.torque_limit,
                starts,
                self._rule,
            )
        return self._last[key]

    def _begun(self, k: int) -> tuple[Commands, tuple[np.ndarray, np.ndarray]]:
        """Commands of a recording, held before a start at rest, and the position and velocity at their start."""
        commands, ticks = self.commands[k], self._held[k]
        if not ticks:
            return commands, (self.recordings[k].q[0], commands.dq[0])
        q, dq, torque = (
            np.pad(series, ((ticks, 0), (0, 0)), mode="edge")
            for series in (commands.q, commands.dq, commands.torque)
        )
        step = commands.t[1] - commands.t[0]
        t = commands.t[0] + step * np.arange(-ticks, len(commands.t))
        return Commands(t=t, q=q, dq=dq, torque=torque), (q[0], dq[0])

    @cached_property
    def _held(self) -> list[int]:
        """Ticks for which a reference that starts at rest was held before each recording."""
        rest = [np.abs(commands.dq[0]).max() < AT_REST for commands in self.commands]
        return [round(SETTLE * self.controller.rate) if still else 0 for still in rest]

    @cached_property
    def _rows(self) -> list[np.ndarray]:
        """Ticks of a roll-out at which each recording has its rows, (N,)."""
        rate, times = self.controller.rate, [r.t - r.t[0] for r in self.recordings]
        return [
            ticks + (t * rate + 1e-6).astype(int)
            for ticks, t in zip(self._held, times, strict=True)
        ]

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
        rate = self.controller.rate
        ticks = t[0] + np.arange(int((t[-1] - t[0]) * rate + 1e-6) + 2) / rate
        held, dq_ref = np.minimum(ticks, t[-1]), recording.dq_ref
        if dq_ref is None:
            dq_ref = make_interp_spline(t, q_ref, k=3)(t, 1)
        velocity = make_interp_spline(t, dq_ref, k=3)
        q = CubicHermiteSpline(t, q_ref, dq_ref)(held)
        dq, ddq = velocity(held), velocity(held, 1)
        arm, body = self.regressor.arm, self.regressor.body
        torque = feedforward(arm, body, self.controller.feedforward, q, dq, ddq)
        return Commands(t=ticks, q=q, dq=dq, torque=torque)
