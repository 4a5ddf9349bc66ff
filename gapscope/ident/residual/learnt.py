"""A residual network learnt from a case and judged on recordings set aside, joint by joint."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.ident.residual.baselines import gradient_boosting
from gapscope.ident.residual.fit import Report, fit_residual
from gapscope.ident.residual.rows import ResidualRows, rows_of
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.trajectory import Trajectory, from_segment
from gapscope.ident.signals.split import split
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    condition,
    low_pass,
    pieces,
)

TREE_RATE = 50.0
"""Rate at which trees are evaluated along a motion, about [Hz]; what they say is low-passed after."""
Predict = Callable[[Motion, np.ndarray], np.ndarray]
"""Torque [N m], (N, n), on a motion with the load that the corrected arm predicts [N m], (N, n)."""


@dataclass(frozen=True)
class LearntResidual:
    """What was learnt of a case with n joints.

    Attributes:
        case: the case.
        settings: of the training.
        corrected: the corrected arm with the network.
        report: of the training.
        fitted, judged: trajectories trained on, and set aside.
        nothing, network, trees: RMS of the torque left on those set aside [N m], (n,): by the corrected arm, with the
            network, with boosted trees.
    """

    case: Case
    settings: ResidualSettings
    corrected: CorrectedArm
    report: Report
    fitted: list[Trajectory]
    judged: list[Trajectory]
    nothing: np.ndarray
    network: np.ndarray
    trees: np.ndarray

    @property
    def residual(self) -> ResidualNetwork:
        """The network."""
        assert self.corrected.residual is not None
        return self.corrected.residual


def learn_residual(
    case: Case,
    corrected: CorrectedArm,
    settings: ResidualSettings,
    judge: Sequence[str] = (),
    progress: Callable[[str], None] = lambda message: None,
) -> LearntResidual:
    """Train a network on what a corrected arm leaves of some recordings, and judge it on the others.

    Args:
        case: the case.
        corrected: the corrected arm; a network that it has is left out.
        settings: of the training.
        judge: names of the recordings to set aside; by default those of the case, else the last, else the last third
            of the only one.
        progress: called with a few words at each step.

    Raises:
        InputError: a recording has no torque, or a name is not that of a recording.
    """
    progress("reads the residual of the corrected arm")
    plain = replace(corrected, residual=None, remainder=None)
    fit, held_out = split(case, judge)
    fitted, judged = (
        _trajectories(plain, recordings) for recordings in (fit, held_out)
    )
    residual, report = fit_residual(fitted, settings, progress)
    progress("fits boosted trees to compare with")
    rows = rows_of(fitted, settings)
    return LearntResidual(
        case=case,
        settings=settings,
        corrected=replace(plain, residual=residual),
        report=report,
        fitted=fitted,
        judged=judged,
        nothing=torque_left(judged, None),
        network=torque_left(judged, residual.torque),
        trees=torque_left(judged, boosted_trees(rows)),
    )


def _trajectories(
    corrected: CorrectedArm, recordings: Sequence[Recording]
) -> list[Trajectory]:
    """Trajectories of recordings with a torque."""
    for recording in recordings:
        if recording.tau is None:
            raise InputError(
                "has no torque that a network could learn from",
                "give recordings with tau1.., or leave this one out of the case",
                file=recording.name,
            )
    body = RigidBody(corrected.arm)
    return [
        from_segment(arm, body, segment)
        for recording in recordings
        for part, arm in _parts(corrected, recording)
        for segment in condition(part)
    ]


def _parts(
    corrected: CorrectedArm, recording: Recording
) -> Iterator[tuple[Recording, CorrectedArm]]:
    """The parts of a recording that share a state, and the arm there; of several, those long enough."""
    spans = corrected.spans(recording.name, recording.t)
    for inside, arm in spans:
        part = recording.part(inside)
        if len(spans) == 1 or pieces(part):
            yield part, arm


def torque_left(
    trajectories: Sequence[Trajectory], predict: Predict | None
) -> np.ndarray:
    """RMS of what a model leaves of the residual, below 12 Hz [N m], (n,); ``None`` for no model."""
    left = []
    for x in trajectories:
        said = np.zeros_like(x.residual)
        if predict is not None:
            said = low_pass(predict(x.motion, x.load), x.motion.rate, TORQUE_CUTOFF)
        left.append((x.residual - said)[x.rows])
    return np.asarray(np.sqrt((np.concatenate(left) ** 2).mean(axis=0)))


def boosted_trees(rows: ResidualRows) -> Predict:
    """Boosted trees, fitted to the same rows as a network, along a motion."""
    trees = gradient_boosting(rows)

    def predict(motion: Motion, load: np.ndarray) -> np.ndarray:
        step = max(1, int(motion.rate / TREE_RATE))
        at = np.arange(0, len(motion.t), step)
        said = trees(rows.inputs.windows(motion, load, at))
        return np.column_stack([np.interp(motion.t, motion.t[at], x) for x in said.T])

    return predict
