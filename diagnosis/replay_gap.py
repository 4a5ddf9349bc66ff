"""The replay gap of a case: the simulated arm, nominal and corrected, under the same commands as one recording."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np

from arm.case import Case
from arm.errors import GapscopeError
from arm.recording import Recording
from diagnosis.judge import Judge
from effects.applied import AppliedEffect
from envs.replay import replay

MOST_TICKS = 12_000
"""Ticks of the controller that are replayed: 12 s at 1 kHz, which takes a second or two."""


class ReplayGap(NamedTuple):
    """RMS of replayed minus recorded position [rad], shape (n,), ``None`` where it was not replayed.

    Attributes:
        before, after: of the nominal arm, and of the arm with the effects found.
        warnings: why something was not replayed although its controller is known.
    """

    before: np.ndarray | None = None
    after: np.ndarray | None = None
    warnings: tuple[str, ...] = ()


def replay_gap(case: Case, judge: Judge) -> ReplayGap:
    """Replay gap before and after, on one recording with values that were not fitted to it.

    That is the first recording set aside for judging, else the last one, or the last block of a single one, with
    values fitted to the others. Nothing is replayed where the controller or the reference is not known.

    Args:
        case: the nominal arm, its recordings and its controller.
        judge: what was found, and its folds.
    """
    recording, effects = _unseen(case, judge)
    if case.controller is None or recording.q_ref is None:
        return ReplayGap()
    recording = _head(recording, MOST_TICKS / case.controller.rate)
    before, without = attempt(case, (), recording)
    after, with_effects = attempt(case, effects, recording)
    problems = (("nominal", without), ("corrected", with_effects))
    warnings = tuple(f"{recording.name}: no replay of the {arm} arm: {why}" for arm, why in problems if why)
    return ReplayGap(before, after, warnings)


def attempt(
    case: Case, effects: tuple[AppliedEffect, ...], recording: Recording
) -> tuple[np.ndarray | None, str | None]:
    """Replay gap [rad], (n,), or ``None`` and why: an effect that cannot be simulated, an arm that runs away."""
    try:
        return replay(case.arm, effects, recording, case.controller).rmse, None
    except (GapscopeError, ArithmeticError, ValueError) as error:  # LinAlgError is a ValueError
        return None, str(error)


def _unseen(case: Case, judge: Judge) -> tuple[Recording, tuple[AppliedEffect, ...]]:
    """A recording, and the effects found with values that were fitted to other data."""
    evidence, terms = judge.found.evidence, judge.found.fit.terms
    if judge.judged:
        recording = next(r for r in case.judged if r.tau is not None)
        theta = evidence.fit(terms).theta
    else:
        recording = [r for r in case.recordings if r.tau is not None][-1]
        theta = evidence.without_last(terms)
        fold = judge.folds[-1]
        recording = _rows(recording, (recording.t >= fold[0].motion.t[0]) & (recording.t <= fold[-1].motion.t[-1]))
    return recording, evidence.terms.effects(evidence.terms.clipped(theta), terms)


def _head(recording: Recording, duration: float) -> Recording:
    """The first seconds of a recording."""
    return _rows(recording, recording.t <= recording.t[0] + duration)


def _rows(recording: Recording, kept: np.ndarray) -> Recording:
    """Some rows of a recording, by a mask of shape (N,)."""
    arrays = {f.name: getattr(recording, f.name) for f in fields(recording)}
    return replace(recording, **{name: x[kept] for name, x in arrays.items() if isinstance(x, np.ndarray)})
