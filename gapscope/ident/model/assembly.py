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
from gapscope.model.conditioning import (
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
        segments: list[Segment] = []
        for recording in recordings:
            segments += condition(recording, self.position_cutoff)
        rows = [self._rows(segment) for segment in segments]
        lengths = [len(torque) for _, torque in rows]
        return Problem(
            np.concatenate([matrix for matrix, _ in rows]),
            np.concatenate([torque for _, torque in rows]),
            tuple(self.base.names[k] for k in self.base.kept),
            np.repeat(np.arange(len(segments)), lengths),
            self.every / segments[0].motion.rate,
        )

    def times(self, recording: Recording) -> np.ndarray:
        """Times [s] of the samples that a recording contributes, shape (N,)."""
        segments = condition(recording, self.position_cutoff)
        inner = [segment.motion.t[segment.inner] for segment in segments]
        return np.concatenate([t[:: self.every] for t in inner])

    def _rows(self, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
        """Base columns and torque of a segment, both filtered, trimmed and thinned."""
        if segment.torque is None:
            raise InputError(
                "has no torque", "give columns tau1..", file=segment.recording
            )
        W = self.regressor.matrix(segment.motion)[:, :, self.base.kept]
        torque = segment.torque - segment.known_torque(self.regressor.body)
        return self._filtered(W, segment), self._filtered(torque, segment)

    def _filtered(self, series: np.ndarray, segment: Segment) -> np.ndarray:
        smooth = low_pass(series, segment.motion.rate, self.torque_cutoff)
        return smooth[segment.inner][:: self.every]
