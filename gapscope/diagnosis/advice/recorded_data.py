"""The recordings at hand, as the hypotheses are fitted to them and compared on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.diagnosis.advice.hypothesis import Hypothesis
from gapscope.diagnosis.advice.parameter_vector import (
    bounds,
    scales,
    vector,
    with_values,
)
from gapscope.diagnosis.thresholds import ADVICE_RATE, FIT_DRAWS, FIT_STARTS, FIT_STEPS
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.severity import draw
from gapscope.model.conditioning import (
    Segment,
    condition,
    thinned,
)
from gapscope.model.torque_gap import filtered_torque, torque_scale


@dataclass(frozen=True)
class RecordedData:
    """Conditioned recordings of one arm with n joints.

    Attributes:
        body: dynamics of the nominal arm.
        segments: with torque, at about ``ADVICE_RATE``.
        measured: recorded torque of each, filtered and trimmed as the gap is [N m], each (M, n).
        floor: RMS that a healthy arm would leave on them [N m], (n,).
    """

    body: RigidBody
    segments: tuple[Segment, ...]
    measured: tuple[np.ndarray, ...]
    floor: np.ndarray

    @classmethod
    def of(cls, case: Case, floor: np.ndarray) -> RecordedData:
        """Of a case whose floor, as a share of ``gapscope.model.torque_gap.torque_scale``, is given; (n,).

        Raises:
            GapscopeError: no recording has a torque.
        """
        recordings = tuple(r for r in case.recordings if r.tau is not None)
        if not recordings:
            raise GapscopeError(
                f"{case.name}: no recording carries a torque",
                "give torque in column tau1..",
            )
        segments = tuple(
            thinned(s, ADVICE_RATE) for r in recordings for s in condition(r)
        )
        measured = tuple(filtered_torque(s) for s in segments)
        return cls(
            RigidBody(case.arm),
            segments,
            measured,
            floor * torque_scale(np.vstack(measured)),
        )

    def residual(self, hypothesis: Hypothesis) -> np.ndarray:
        """Predicted minus recorded torque over the floor [1], all samples and joints in a row."""
        parts = []
        for segment, measured in zip(self.segments, self.measured, strict=True):
            body = segment.bodies(self.body)
            predicted = hypothesis.predict(body, segment.motion)[segment.inner]
            parts.append(((predicted - measured) / self.floor).ravel())
        return np.concatenate(parts)

    def jacobian(self, hypothesis: Hypothesis) -> np.ndarray:
        """Derivative of ``residual`` by the parameters in units of their scales, (M n, P)."""
        parts = []
        for segment in self.segments:
            body = segment.bodies(self.body)
            here = hypothesis.predict(body, segment.motion)
            slopes = hypothesis.jacobian(body, segment.motion, here)[segment.inner]
            in_floors = slopes / self.floor[:, None]
            parts.append(in_floors.reshape(-1, slopes.shape[2]))
        return np.vstack(parts)


def fitted(present: RecordedData, hypothesis: Hypothesis) -> tuple[Hypothesis, float]:
    """A hypothesis with the values that explain the recordings best, and the mean square it leaves in floors [1]."""
    effects, scale = hypothesis.effects, scales(hypothesis.effects)
    if not len(scale):
        return hypothesis, float(np.mean(present.residual(hypothesis) ** 2))

    def at(x: np.ndarray) -> Hypothesis:
        return Hypothesis(
            hypothesis.words, hypothesis.arm, with_values(effects, x * scale)
        )

    def slope(x: np.ndarray) -> np.ndarray:
        here = at(x)
        return present.jacobian(here) * (scale / scales(here.effects))

    low, high = (bound / scale for bound in bounds(effects))
    # least_squares wants a start strictly inside the bounds
    margin = 1e-6 * np.minimum(high - low, 1.0)
    start = np.clip(vector(effects) / scale, low + margin, high - margin)
    done = least_squares(
        lambda x: present.residual(at(x)), start, slope, (low, high), max_nfev=FIT_STEPS
    )
    return at(done.x), float(np.mean(done.fun**2))


def with_unknown(
    present: RecordedData,
    hypothesis: Hypothesis,
    name: str,
    joints: tuple[int, ...],
    rng: np.random.Generator,
) -> Hypothesis:
    """A hypothesis with one more effect, whose values are found from several starts of the size of real arms'."""
    scale = ArmScale.of(hypothesis.arm)
    tried: list[tuple[float, int, Hypothesis]] = []
    for number in range(FIT_DRAWS):
        drawn: AppliedEffect = draw(name, rng, scale, joints or None)
        effects = (*hypothesis.effects, drawn)
        started = Hypothesis(hypothesis.words, hypothesis.arm, effects)
        mean_square = float(np.mean(present.residual(started) ** 2))
        tried.append((mean_square, number, started))
    best = [fitted(present, started) for _, _, started in sorted(tried)[:FIT_STARTS]]
    return min(best, key=lambda pair: pair[1])[0]
