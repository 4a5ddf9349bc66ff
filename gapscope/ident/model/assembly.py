"""From recordings to the linear problem of base parameters, every recording treated alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
)


@dataclass(frozen=True)
class Assembly:
    """Makes the problem of base parameters: derivatives by spline, both sides through the same zero-phase low-pass.

    Filters are fixed, not chosen by the recording, so that measured and simulated recordings pass the same ones.

    Attributes:
        regressor: of the nominal arm.
        base: its base parameters.
        position_cutoff: of the positions before they are differentiated [Hz].
        torque_cutoff: of regressor and torque [Hz].
        every: only each sample of this number is kept.
    """

    regressor: Regressor
    base: BaseParameters
    position_cutoff: float = 40.0
    torque_cutoff: float = TORQUE_CUTOFF
    every: int = 1

    def __call__(self, recordings: Sequence[Recording]) -> Problem:
        """The problem of some recordings, a group for each of their segments.

        Raises:
            InputError: a recording without torque, or too short to filter.
        """
        segments = [
            s
            for recording in recordings
            for s in condition(recording, self.position_cutoff)
        ]
        matrices, torques = zip(
            *(self._rows(segment) for segment in segments), strict=True
        )
        group = np.repeat(np.arange(len(segments)), [len(x) for x in torques])
        names = tuple(self.base.names[k] for k in self.base.kept)
        interval = self.every / segments[0].motion.rate
        return Problem(
            np.concatenate(matrices), np.concatenate(torques), names, group, interval
        )

    def times(self, recording: Recording) -> np.ndarray:
        """Times [s] of the samples that a recording contributes, shape (N,)."""
        segments = condition(recording, self.position_cutoff)
        return np.concatenate(
            [segment.motion.t[segment.inner][:: self.every] for segment in segments]
        )

    def _rows(self, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
        if segment.torque is None:
            raise InputError(
                "has no torque", "give columns tau1..", file=segment.recording
            )
        W = self.regressor.matrix(segment.motion)[:, :, self.base.kept]
        rate, inner = segment.motion.rate, segment.inner
        own = segment.torque - segment.known_torque(self.regressor.body)
        matrix, torque = (
            low_pass(x, rate, self.torque_cutoff)[inner][:: self.every]
            for x in (W, own)
        )
        return matrix, torque
