"""What is normal for an arm, from its first motion: noise, friction level, scales, and a first estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.ident.kalman.online.block import LEAST_NOISE, Block, Equations
from gapscope.ident.kalman.online.estimate import ParameterState
from gapscope.model.effective_samples import variance_inflation
from gapscope.watching.detection.scales import Scales
from gapscope.watching.detection.watched_arm import WatchedArm
from gapscope.watching.thresholds import LEAST_SEEN

ROUNDS = 3
"""Rounds in which weights of joints and the noise that these leave are found in turns."""


@dataclass(frozen=True)
class Moment:
    """Where a block lies: name of the recording, time of its first and last sample [s]."""

    recording: str
    start: float
    end: float


@dataclass(frozen=True)
class Normal:
    """What is normal, n joints, p parameters.

    Attributes:
        scales: of the parameters.
        noise: RMS that no change of the parameters explains in a block [N m], shape (n,); infinite of a joint that is
            not watched, because it hardly moved.
        inflation: how many samples of it count as one [1], (n,).
        fluctuation: RMS of the torque about its mean in a block [N m], (n,): the error of the model grows with it.
    """

    scales: Scales
    noise: np.ndarray
    inflation: np.ndarray
    fluctuation: np.ndarray

    def reduced(
        self, moment: Moment, equations: Equations, duration: float
    ) -> tuple[Block, np.ndarray]:
        """A block, and its noise power over what is normal for its motion [1], shape (n,); 1 of a joint that rests.

        Samples are weighed by the larger of the normal noise and the block's own: where more is left than usual, a
        sample says less.
        """
        own = equations.own_noise(self.noise, self.scales.prior)
        noise = np.maximum(self.noise, own) * np.sqrt(self.inflation)
        A, s = equations.normal(noise)
        block = Block(moment.recording, moment.start, moment.end, duration, A, s)
        growth = fluctuation(equations) / np.maximum(self.fluctuation, 1e-12)
        expected = self.noise * np.maximum(1.0, growth)
        rests = own <= 0
        return block, np.where(rests, 1.0, (own / expected) ** 2)


def learn(
    arm: WatchedArm,
    moments: Sequence[Moment],
    blocks: Sequence[Equations],
    believed: Sequence[np.ndarray],
    duration: float,
) -> tuple[Normal, ParameterState]:
    """What is normal on some blocks, and the estimate after them.

    Args:
        arm: that is watched.
        moments: of the blocks.
        blocks: the blocks, in each of which some joint moves.
        believed: friction torque that the arm is believed to have in each [N m], (M, n).
        duration: that each counts for [s].
    """
    power = [block.rms(f) for block, f in zip(blocks, believed, strict=True)]
    friction = np.sqrt(np.mean(np.square(power), axis=0))
    start = np.zeros(len(arm.names))
    for _ in range(2):
        # friction that the arm lacks is found, and scales the second time
        scales = Scales.of(arm, blocks, friction)
        normal = _noise(blocks, scales)
        state = ParameterState(start, np.diag(_known_encoders(arm, scales.prior) ** 2))
        for moment, block in zip(moments, blocks, strict=True):
            reduced, _ = normal.reduced(moment, block, duration)
            state = state.assimilated(reduced.information, reduced.score)
        friction = _friction(arm, blocks, believed, state)
    return normal, state


def fluctuation(equations: Equations) -> np.ndarray:
    """RMS of the recorded torque about its mean over a block [N m], shape (n,)."""
    return np.asarray(equations.torque.std(axis=0))


def _noise(blocks: Sequence[Equations], scales: Scales) -> Normal:
    """Noise and its correlation, weights and noise found in turns."""
    least = LEAST_NOISE * scales.torque
    noise = np.maximum(0.1 * scales.torque, least)
    for _ in range(ROUNDS):
        own = np.array([block.own_noise(noise, scales.prior) for block in blocks])
        noise = np.maximum(_median_power(own), least)
    moving = np.mean([block.moving.mean(axis=0) for block in blocks], axis=0)
    noise = np.where(moving < LEAST_SEEN, np.inf, noise)
    prior = np.diag(1.0 / scales.prior**2)
    residuals, groups = [], []
    for number, block in enumerate(blocks):
        A, s = block.normal(noise)
        residuals.append(block.residual(np.linalg.solve(A + prior, s)))
        groups.append(np.full(len(block.gap), number))
    inflation = variance_inflation(
        np.concatenate(residuals), np.concatenate(groups), longest=100
    )
    spread = np.median([fluctuation(block) for block in blocks], axis=0)
    return Normal(scales, noise, inflation, spread)


def _median_power(own: np.ndarray) -> np.ndarray:
    """Median over the blocks in which a joint moves, (n,); 0 if it never does."""
    found = np.zeros(own.shape[1])
    for joint, series in enumerate(own.T):
        if (series > 0).any():
            found[joint] = np.median(series[series > 0])
    return found


def _known_encoders(arm: WatchedArm, prior: np.ndarray) -> np.ndarray:
    """Standard deviations of the estimate's start: zeros of encoders are what they are, up to a change."""
    out = prior.copy()
    out[arm.places("e")] = 0.0
    return out


def _friction(
    arm: WatchedArm,
    blocks: Sequence[Equations],
    believed: Sequence[np.ndarray],
    state: ParameterState,
) -> np.ndarray:
    """RMS of the friction torque, as believed and with what was estimated, shape (n,)."""
    places = [k for k, name in enumerate(arm.names) if name[0] in "bc"]
    power = []
    for block, series in zip(blocks, believed, strict=True):
        estimated = block.matrix[:, :, places] @ state.value[places]
        power.append(block.rms(series + estimated) ** 2)
    return np.sqrt(np.mean(power, axis=0))
