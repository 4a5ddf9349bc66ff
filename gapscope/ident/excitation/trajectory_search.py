"""A search for the best trajectory: what a candidate scores, what it costs, and the best ones that keep all limits."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.ident.excitation.candidate_model import ExcitationModel
from gapscope.ident.excitation.criteria import Criterion
from gapscope.ident.excitation.limits import Checker
from gapscope.ident.excitation.separation import Separator
from gapscope.ident.excitation.trajectory_parametrisation import Parametrisation

SAMPLES = 200
"""Samples of a candidate during the search."""
PENALTY = 10.0
"""Score for a limit broken by all of it; smaller breaches count in proportion."""
PENALISED = ("torque", "singular value", "distance")
"""Limits that candidates may break; the others are kept by construction."""
TOLERATED = np.array([0.005, 0.05, 0.05])
"""Breaches that still count as kept: half of what the limits are tightened by [1]. Up to there the penalty grows with
the square, so that a descent does not stall on the edge of what is allowed."""
DISTANCE_SCALE = 0.1
"""Distance by which a clearance counts as broken by all of it [m]."""


@dataclass(frozen=True)
class Budget:
    """When a search ends: at the first of these.

    Attributes:
        evaluations: candidates evaluated, one with its gradient counted as ``GRADIENT_COST``; ``None`` for any.
        seconds: time [s]; ``None`` for any, and then a search with the same seed gives the same result.

    Raises:
        InputError: neither is given, or one is not positive.
    """

    evaluations: int | None = 3000
    seconds: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in (
            ("evaluations", self.evaluations),
            ("seconds", self.seconds),
        ):
            if value is not None and not value > 0:
                raise InputError(
                    f"a budget of {value:g} is spent at once",
                    "give a positive number",
                    where=name,
                )
        if self.evaluations is None and self.seconds is None:
            raise InputError(
                "the search would never end",
                "give evaluations, seconds or both",
                where="budget",
            )


GRADIENT_COST = 8
"""Evaluations that one with a gradient counts as: what it takes on an arm with seven joints."""


@dataclass(frozen=True)
class Found:
    """A candidate that keeps all limits at the samples of the search.

    Attributes:
        x: its numbers, shape (d,).
        value: of the criterion.
        evaluations: when it was found.
    """

    x: np.ndarray
    value: float
    evaluations: int


class TrajectorySearch:
    """Scores candidates and keeps the best ones.

    The score is the value of the criterion plus a penalty for torque, singular values and distances that break their
    limits, which are somewhat tighter here than the final ones, for what lies between the samples.

    Args:
        parametrisation: of the trajectories.
        model: of the arm.
        criterion: to be made small; with ``signatures``, minus the log of the separation is made small instead.
        checker: of the limits, tightened.
        budget: when to end.
        signatures: of the effects to separate, or ``None``.
        progress: called with the share of the budget spent [1] and the best value so far, or infinity.
        samples: of a candidate during the search.

    Attributes:
        found: candidates that keep all limits, each better than those before it.
        evaluations: spent.
        judged: number of candidates scored.
        feasible: number of candidates that kept all limits.
    """

    def __init__(
        self,
        parametrisation: Parametrisation,
        model: ExcitationModel,
        criterion: Criterion,
        checker: Checker,
        budget: Budget,
        signatures: Separator | None = None,
        progress: Callable[[float, float], None] = lambda share, best: None,
        samples: int = SAMPLES,
    ) -> None:
        self.parametrisation = parametrisation
        self.model = model
        self.checker = checker
        self._criterion = criterion
        self._budget = budget
        self._signatures = signatures
        self._progress = progress
        self._t = np.linspace(0.0, parametrisation.family.duration, samples)
        self._basis = parametrisation.family.basis(self._t)
        self._start = time.monotonic()
        self.found: list[Found] = []
        self.evaluations = 0
        self.judged = 0
        self.feasible = 0
        self._broken = np.zeros(len(PENALISED), dtype=int)

    @property
    def spent(self) -> bool:
        """Whether the budget is spent."""
        return self.share >= 1

    @property
    def share(self) -> float:
        """Share of the budget that is spent [1]."""
        evaluations, seconds = self._budget.evaluations, self._budget.seconds
        share = 0.0
        if evaluations:
            share = self.evaluations / evaluations
        if seconds:
            share = max(share, (time.monotonic() - self._start) / seconds)
        return min(share, 1.0)

    @property
    def hardest(self) -> tuple[str, ...]:
        """Limits that half of the candidates broke, and the one that most broke, which comes first."""
        first, *others = np.argsort(-self._broken, kind="stable")
        often = [i for i in others if 2 * self._broken[i] >= self.judged]
        return tuple(PENALISED[i] for i in (first, *often))

    @property
    def has_gradient(self) -> bool:
        """Whether the criterion has an analytic gradient."""
        return self._signatures is None

    def score(self, x: np.ndarray) -> float:
        """Score of a candidate, shape (d,)."""
        self.evaluations += 1
        motion = self.parametrisation.motion(x, self._t, self._basis)
        value = self._value(motion, self.model.matrix(motion))
        torque, _ = self._torque_breach(self.model.torque(motion))
        breaches = [torque]
        for slack, scale in self._slacks(motion.q):
            breaches.append(max(0.0, -float(slack.min()) / scale))
        return self._note(x, value, breaches)

    def score_and_gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Score of a candidate and its gradient, shape (d,), exact but for distances, by central differences."""
        self.evaluations += GRADIENT_COST
        motion = self.parametrisation.motion(x, self._t, self._basis)
        matrix = self.model.matrix(motion)
        value = self._value(motion, matrix)
        torque, by_torque = self._torque_breach(self.model.torque(motion))
        breaches = [torque]
        # derivatives of the other breaches by q, which the worst sample alone decides
        by_position = np.zeros((2, *motion.q.shape))
        for k, (slack, scale) in enumerate(self._slacks(motion.q)):
            worst = int(slack.argmin())
            breaches.append(max(0.0, -float(slack[worst]) / scale))
            if slack[worst] < 0:
                by_position[k, worst] -= self._slope(motion.q[worst], k) / scale
        weight = PENALTY * np.minimum(np.array(breaches) / TOLERATED, 1.0)
        by_matrix = self._criterion.gradient(matrix, self.model.reference)
        by_q, by_dq, by_ddq = self.model.pullback(
            motion, by_matrix, weight[0] * by_torque
        )
        by_q += weight[1] * by_position[0] + weight[2] * by_position[1]
        gradient = self.parametrisation.pullback(x, self._basis, (by_q, by_dq, by_ddq))
        return self._note(x, value, breaches), gradient

    def _value(self, motion: Motion, matrix: np.ndarray) -> float:
        if self._signatures is None:
            return self._criterion.evaluate(matrix, self.model.reference)
        separation = self._signatures.separate(motion, matrix).least
        return -float(np.log(max(separation, 1e-12)))

    def _note(self, x: np.ndarray, value: float, breaches: list[float]) -> float:
        """The score; a candidate that keeps all limits is counted, and kept if it is the best so far."""
        breach = np.array(breaches)
        self.judged += 1
        self._broken += breach > TOLERATED
        if (breach <= TOLERATED).all():
            self.feasible += 1
            # the list is a record of improvements: the last is the best
            if not self.found or value < self.found[-1].value:
                self.found.append(Found(np.array(x), value, self.evaluations))
        best = self.found[-1].value if self.found else np.inf
        self._progress(self.share, best)
        # quadratic up to what is tolerated, linear beyond, with a continuous slope
        quadratic, linear = breach**2 / (2 * TOLERATED), breach - TOLERATED / 2
        penalties = np.where(breach < TOLERATED, quadratic, linear)
        return value + PENALTY * float(penalties.sum())

    def _torque_breach(self, torque: np.ndarray) -> tuple[float, np.ndarray]:
        """Sum over joints of the largest breach as a share of the limit, and its derivative by torque, (N, n)."""
        limit = self.checker.allowed.torque
        joints = np.arange(torque.shape[1])
        worst = np.abs(torque).argmax(axis=0)
        peak = torque[worst, joints]
        breach = np.maximum(np.abs(peak) / limit - 1, 0.0)
        slope = np.zeros_like(torque)
        slope[worst, joints] = np.where(breach > 0, np.sign(peak) / limit, 0.0)
        return float(breach.sum()), slope

    def _slacks(self, q: np.ndarray) -> list[tuple[np.ndarray, float]]:
        """Slack of singular value and distance at q, (N, n), each (N,), with what counts as broken by all of it."""
        allowed, checker = self.checker.allowed, self.checker
        unlimited = np.full(len(q), np.inf)
        singular = (
            checker.singular_value(q) - allowed.singular
            if allowed.singular > 0
            else unlimited
        )
        return [
            (singular, max(allowed.singular, 1e-3)),
            (checker.distance(q) - allowed.clearance, DISTANCE_SCALE),
        ]

    def _slope(self, q: np.ndarray, which: int, step: float = 1e-4) -> np.ndarray:
        """Derivative of one slack by q, shape (n,), by central differences."""
        shifts = step * np.eye(len(q))
        up, down = (self._slacks(q + shifts * sign)[which][0] for sign in (1, -1))
        return (up - down) / (2 * step)
