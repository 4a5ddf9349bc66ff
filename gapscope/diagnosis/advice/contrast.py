"""How far the predictions of hypotheses are apart on a motion, once each has been refitted as far as data allow.

Of two hypotheses the true one, A, predicts y_A; the other, B, y_B + J_B x when its parameters move by x, and the errors
v of the nominal inertials move it by N v. What B cannot follow is the contrast of the two, in units of the floor s:

    d^2 = min over x, v of [ |(y_B + J_B x + N v - y_A) / s|^2 over all data + |v / sigma|^2 ] - the same of the old

per independent sample of the new motion, summed over joints; the lesser of A, B and B, A counts. This is the
T-criterion for rival models, with what is known already as a part of the data [atkinson1975].
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.inertial_scale import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.advice.hypothesis import Hypothesis
from gapscope.diagnosis.advice.recorded_data import RecordedData
from gapscope.diagnosis.gap.noise_floor import sticking_rms, timing_error
from gapscope.diagnosis.thresholds import (
    ADVICE_INERTIALS,
    ADVICE_SAMPLE_STEP,
    MODEL_FORM,
)
from gapscope.ident.excitation.separation import Separated
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.effective_samples import band_samples
from gapscope.model.torque_gap import torque_scale

RIDGE = 1e-9
"""Keeps a parameter that the data do not show at its value [1]."""


class WeightedPredictions(NamedTuple):
    """Predictions on some data, in floors; H hypotheses.

    Attributes:
        torque: predictions, each row weighed, (H, M, n).
        slopes: per hypothesis the derivatives by its own parameters and by the inertials, (M, n, P + 10 n).
        samples: independent samples [1].
    """

    torque: np.ndarray
    slopes: list[np.ndarray]
    samples: float


class HypothesisContrast(NamedTuple):
    """Contrast of two hypotheses: their places, d on the present recordings and on the new motion [1], joint from 1."""

    first: int
    second: int
    present: float
    new: float
    joint: int


@dataclass(frozen=True)
class _Quadratic:
    """|r + S x|^2 as a function of x: S^T S, S^T r, |r|^2, over independent samples."""

    gram: np.ndarray
    slope: np.ndarray
    rest: float

    def plus(self, other: _Quadratic) -> _Quadratic:
        return _Quadratic(
            self.gram + other.gram, self.slope + other.slope, self.rest + other.rest
        )

    def least(self) -> tuple[float, np.ndarray]:
        """The least value and its x."""
        x = -np.linalg.solve(self.gram, self.slope)
        return max(self.rest + float(self.slope @ x), 0.0), x


class Contrast:
    """Contrast of hypotheses; the torque of a known payload may be a part of the new motion's bodies.

    Args:
        arm: the nominal arm.
        hypotheses: two or more, fitted to the present recordings.
        present: these recordings.
        body: dynamics of the arm on the new motion: the nominal arm's, or with a known payload.
    """

    def __init__(
        self,
        arm: NominalArm,
        hypotheses: list[Hypothesis],
        present: RecordedData,
        body: RigidBody,
    ) -> None:
        self._hypotheses, self._body, self._floor = hypotheses, body, present.floor
        self._coulomb = np.abs(arm.coulomb)
        self._inertial_scale = inertial_scale(present.body)
        self.pairs = list(itertools.permutations(range(len(hypotheses)), 2))
        known = self._on_recordings(present)
        self._known = [
            self._prior(b).plus(_following(known, a, b)) for a, b in self.pairs
        ]
        self._least = [quadratic.least()[0] for quadratic in self._known]
        self.present = [float(np.sqrt(least / known.samples)) for least in self._least]

    def on(self, motion: Motion) -> list[HypothesisContrast]:
        """Contrast of each two hypotheses on a new motion; the lesser of both directions."""
        new = self._on_motion(motion)
        out: dict[tuple[int, int], HypothesisContrast] = {}
        for index, (a, b) in enumerate(self.pairs):
            total, x = self._known[index].plus(_following(new, a, b)).least()
            increase = max(total - self._least[index], 0.0)
            contrast = float(np.sqrt(increase / new.samples))
            first, second = min(a, b), max(a, b)
            known = out.get((first, second))
            if known is None or contrast < known.new:
                residual = new.torque[b] - new.torque[a] + new.slopes[b] @ x
                joint = int((residual**2).mean(axis=0).argmax()) + 1
                out[first, second] = HypothesisContrast(
                    first, second, self.present[index], contrast, joint
                )
        return list(out.values())

    def separate(self, motion: Motion, matrix: np.ndarray) -> Separated:
        """The least contrast, in the place of what ``gapscope.ident.excitation.separation`` makes large."""
        return Separated(min(pair.new for pair in self.on(motion)), {})

    def _on_recordings(self, present: RecordedData) -> WeightedPredictions:
        """Predictions on all present recordings, thinned."""
        parts = []
        for segment in present.segments:
            body, motion = segment.bodies(present.body), segment.motion
            rows = np.arange(len(motion.t))[segment.inner][::ADVICE_SAMPLE_STEP]
            predictions = [_Prediction.of(h, body, motion) for h in self._hypotheses]
            parts.append(self._weighted(predictions, body, motion, present.floor, rows))
        slopes = [
            np.vstack([part.slopes[h] for part in parts])
            for h in range(len(self._hypotheses))
        ]
        torque = np.concatenate([part.torque for part in parts], axis=1)
        durations = [float(s.motion.t[-1] - s.motion.t[0]) for s in present.segments]
        samples = band_samples(sum(durations), TORQUE_CUTOFF)
        return WeightedPredictions(torque, slopes, samples)

    def _on_motion(self, motion: Motion) -> WeightedPredictions:
        """Predictions on a new motion, in floors that grow with its torque and the rate of it."""
        predictions = [
            _Prediction.elsewhere(h, self._body, motion) for h in self._hypotheses
        ]
        torque = predictions[0].torque
        timing = timing_error(torque, motion.t)
        model_form = MODEL_FORM * torque_scale(torque)
        floor = np.sqrt(self._floor**2 + timing**2 + model_form**2)
        rows = np.arange(len(motion.t))
        weighted = self._weighted(predictions, self._body, motion, floor, rows)
        seconds = float(motion.t[-1] - motion.t[0])
        return weighted._replace(samples=band_samples(seconds, TORQUE_CUTOFF))

    def _weighted(
        self,
        predictions: list[_Prediction],
        body: RigidBody,
        motion: Motion,
        floor: np.ndarray,
        rows: np.ndarray,
    ) -> WeightedPredictions:
        """Predictions and slopes at some rows over the floor; rows at which a joint may stick count less."""
        q, dq, ddq = motion.q[rows], motion.dq[rows], motion.ddq[rows]
        inertial = body.regressor(q, dq, ddq) * self._inertial_scale
        weight = 1.0 / np.sqrt(
            floor**2 + sticking_rms(self._coulomb, dq / body.per_radian) ** 2
        )
        torque = np.array([p.torque[rows] * weight for p in predictions])
        slopes = []
        for prediction in predictions:
            columns = np.concatenate([prediction.slopes[rows], inertial], axis=2)
            slopes.append(columns * weight[:, :, None])
        return WeightedPredictions(torque, slopes, float(len(rows)))

    def _prior(self, b: int) -> _Quadratic:
        """The prior of hypothesis b: its own parameters are free, the inertials near the nominal ones."""
        own = np.full(len(self._hypotheses[b].lasting), RIDGE)
        inertial = np.full(len(self._inertial_scale), ADVICE_INERTIALS**-2)
        gram = np.diag(np.concatenate([own, inertial]))
        return _Quadratic(gram, np.zeros(len(gram)), 0.0)


@dataclass(frozen=True)
class _Prediction:
    """Torque that a hypothesis predicts [N m], (N, n), and its derivatives by the hypothesis' parameters, (N, n, P)."""

    torque: np.ndarray
    slopes: np.ndarray

    @classmethod
    def of(cls, hypothesis: Hypothesis, body: RigidBody, motion: Motion) -> _Prediction:
        """On a recording that the hypothesis was fitted to."""
        torque = hypothesis.predict(body, motion)
        return cls(torque, hypothesis.jacobian(body, motion, torque))

    @classmethod
    def elsewhere(
        cls, hypothesis: Hypothesis, body: RigidBody, motion: Motion
    ) -> _Prediction:
        """On another motion, on which parameters of what does not last have no effect."""
        lasting = cls.of(hypothesis.elsewhere(), body, motion)
        slopes = np.zeros((*lasting.torque.shape, len(hypothesis.lasting)))
        slopes[:, :, hypothesis.lasting] = lasting.slopes
        return cls(lasting.torque, slopes)


def _following(data: WeightedPredictions, a: int, b: int) -> _Quadratic:
    """Squared distance of B, as its parameters move, from A, over independent samples."""
    share = data.samples / data.torque.shape[1]
    slopes = data.slopes[b].reshape(-1, data.slopes[b].shape[2])
    residual = (data.torque[b] - data.torque[a]).ravel()
    return _Quadratic(
        share * slopes.T @ slopes,
        share * slopes.T @ residual,
        share * float(residual @ residual),
    )
