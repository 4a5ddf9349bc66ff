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
from gapscope.diagnosis.gap.torque_gap import torque_scale
from gapscope.diagnosis.thresholds import (
    ADVICE_INERTIALS,
    ADVICE_SAMPLE_STEP,
    MODEL_FORM,
    STICKING_SPEED,
    TIMING_SKEW,
)
from gapscope.ident.excitation.separation import Separated
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF
from gapscope.ident.signals.effective_samples import band_samples

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
        self._dry = np.abs(arm.coulomb)
        self._units = inertial_scale(present.body)
        self.pairs = list(itertools.permutations(range(len(hypotheses)), 2))
        seconds = sum(float(s.motion.t[-1] - s.motion.t[0]) for s in present.segments)
        parts = [
            self._weighed(
                hypotheses,
                s.bodies(present.body),
                s.motion,
                present.floor,
                s.inner,
                ADVICE_SAMPLE_STEP,
            )
            for s in present.segments
        ]
        slopes = [
            np.vstack(blocks)
            for blocks in zip(*(part.slopes for part in parts), strict=True)
        ]
        known = WeightedPredictions(
            np.concatenate([p.torque for p in parts], axis=1),
            slopes,
            band_samples(seconds, TORQUE_CUTOFF),
        )
        self._known = [
            self._prior(b).plus(_following(known, a, b)) for a, b in self.pairs
        ]
        least = [normal.least()[0] for normal in self._known]
        self._least = least
        self.present = [float(np.sqrt(value / known.samples)) for value in least]

    def on(self, motion: Motion) -> list[HypothesisContrast]:
        """Contrast of each two hypotheses on a new motion; the lesser of both directions."""
        new = self._new(motion)
        out: dict[tuple[int, int], HypothesisContrast] = {}
        for (a, b), known, least, present in zip(
            self.pairs, self._known, self._least, self.present, strict=True
        ):
            total, x = known.plus(_following(new, a, b)).least()
            d = float(np.sqrt(max(total - least, 0.0) / new.samples))
            left = new.torque[b] - new.torque[a] + new.slopes[b] @ x
            joint = int((left**2).mean(axis=0).argmax()) + 1
            place = (min(a, b), max(a, b))
            if place not in out or d < out[place].new:
                out[place] = HypothesisContrast(*place, present, d, joint)
        return list(out.values())

    def separate(self, motion: Motion, matrix: np.ndarray) -> Separated:
        """The least contrast, in the place of what ``gapscope.ident.excitation.separation`` makes large."""
        return Separated(min(pair.new for pair in self.on(motion)), {})

    def _new(self, motion: Motion) -> WeightedPredictions:
        """Predictions on a new motion, in floors that grow with its torque and the rate of it."""
        elsewhere = [h.elsewhere() for h in self._hypotheses]
        torque = elsewhere[0].predict(self._body, motion)
        rate = np.sqrt((np.gradient(torque, motion.t, axis=0) ** 2).mean(axis=0))
        floor = np.sqrt(
            self._floor**2
            + (TIMING_SKEW * rate) ** 2
            + (MODEL_FORM * torque_scale(torque)) ** 2
        )
        weighed = self._weighed(
            self._hypotheses, self._body, motion, floor, slice(None), 1, new=True
        )
        return weighed._replace(
            samples=band_samples(float(motion.t[-1] - motion.t[0]), TORQUE_CUTOFF)
        )

    def _weighed(
        self,
        hypotheses: list[Hypothesis],
        body: RigidBody,
        motion: Motion,
        floor: np.ndarray,
        rows: slice,
        thin: int,
        new: bool = False,
    ) -> WeightedPredictions:
        """Predictions and slopes over the floor; if a joint may stick they count less."""
        inner = range(len(motion.t))[rows][::thin]
        inertial = (
            body.regressor(motion.q[inner], motion.dq[inner], motion.ddq[inner])
            * self._units
        )
        doubt = (
            self._dry
            * (1.0 - np.abs(np.tanh(motion.dq[inner] / STICKING_SPEED)))
            / np.sqrt(3.0)
        )
        weight = 1.0 / np.sqrt(floor**2 + doubt**2)
        torque, slopes = [], []
        for hypothesis in hypotheses:
            told = hypothesis.elsewhere() if new else hypothesis
            here = told.predict(body, motion)
            own = np.zeros((*here.shape, len(hypothesis.lasting)))
            own[:, :, hypothesis.lasting if new else slice(None)] = told.jacobian(
                body, motion, here
            )
            torque.append(here[inner] * weight)
            slopes.append(
                np.concatenate([own[inner], inertial], axis=2) * weight[:, :, None]
            )
        return WeightedPredictions(np.array(torque), slopes, float(len(inner)))

    def _prior(self, b: int) -> _Quadratic:
        own = len(self._hypotheses[b].lasting)
        size = own + len(self._units)
        gram = np.diag(
            np.concatenate(
                [np.full(own, RIDGE), np.full(len(self._units), ADVICE_INERTIALS**-2)]
            )
        )
        return _Quadratic(gram, np.zeros(size), 0.0)


def _following(data: WeightedPredictions, a: int, b: int) -> _Quadratic:
    """Normal equations of B that follows A, over independent samples."""
    share = data.samples / data.torque.shape[1]
    slopes = data.slopes[b].reshape(-1, data.slopes[b].shape[2])
    residual = (data.torque[b] - data.torque[a]).ravel()
    return _Quadratic(
        share * slopes.T @ slopes,
        share * slopes.T @ residual,
        share * float(residual @ residual),
    )
