"""The replay gap of a case: the simulated arm, nominal and corrected, under the same commands as one recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.assessment.held_out_prediction import HeldOutPredictor
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.selection.moves import by_finding
from gapscope.diagnosis.thresholds import REPLAYED_TICKS, REPLAYED_TICKS_COMPLIANT
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.engines import default_engine, installed
from gapscope.envs.replay import LONGEST_STEP, replay

SECOND_OPINION = "mujoco"
"""Replays as well if another engine is the default."""


class ReplayGap(NamedTuple):
    """RMS of replayed minus recorded position [rad], shape (n,), ``None`` where it was not replayed.

    Attributes:
        before, after: of the nominal arm, and of the arm with the effects found, in the default engine.
        by: what moved the simulated arm: the ``controller``, or where it or the reference is not known the recorded
            ``torque`` over short horizons; ``None`` where nothing was replayed.
        warnings: why something was not replayed.
        only, without: of the arm with each effect alone, and with all others, by the effect's name in a finding; of
            arms with joints that ring or play, which are slow to simulate, only the first two.
        elsewhere: before and after in the other engines that are installed.
    """

    before: np.ndarray | None = None
    after: np.ndarray | None = None
    by: str | None = None
    warnings: tuple[str, ...] = ()
    only: Mapping[str, np.ndarray | None] = {}
    without: Mapping[str, np.ndarray | None] = {}
    elsewhere: Mapping[str, tuple[np.ndarray | None, np.ndarray | None]] = {}


def replay_gap(case: Case, predictor: HeldOutPredictor) -> ReplayGap:
    """Replay gap before and after, on one recording with values that were not fitted to it.

    That is the first recording set aside for judging, else the last one, or the last block of a single one, with
    values fitted to the others.

    Args:
        case: the nominal arm, its recordings with torque, and its controller where known.
        judge: what was found, and its folds.
    """
    recording = _unseen(case, predictor)
    through_controller = case.controller is not None and recording.q_ref is not None
    ticks = (
        case.controller.rate
        if case.controller and through_controller
        else max(recording.rate, 1.0 / LONGEST_STEP)
    )
    none, every = frozenset[Term](), predictor.selection.fit.terms
    rings = any(not t.definition.locally_linear for t in every)
    recording = _head(
        recording, (REPLAYED_TICKS_COMPLIANT if rings else REPLAYED_TICKS) / ticks
    )
    known: dict[tuple[frozenset[Term], str], tuple[np.ndarray | None, str | None]] = {}

    usual = default_engine()

    def gap(terms: frozenset[Term], engine: str = usual) -> np.ndarray | None:
        if (terms, engine) not in known:
            known[terms, engine] = attempt(
                case, _effects(predictor, terms), recording, engine
            )
        return known[terms, engine][0]

    parts = (
        {} if rings else {next(iter(part)).finding: part for part in by_finding(every)}
    )
    others = [name for name in (SECOND_OPINION,) if name != usual and installed(name)]
    before, after = gap(none), gap(every)
    replayed = before is not None or after is not None
    return ReplayGap(
        before,
        after,
        ("controller" if through_controller else "torque") if replayed else None,
        tuple(
            f"{recording.name}: no replay of the {arm} arm: {why}"
            for arm, terms in (("nominal", none), ("corrected", every))
            if (why := known[terms, usual][1])
        ),
        {name: gap(part) for name, part in parts.items()},
        {name: gap(every - part) for name, part in parts.items()},
        {engine: (gap(none, engine), gap(every, engine)) for engine in others},
    )


def attempt(
    case: Case,
    effects: tuple[AppliedEffect, ...],
    recording: Recording,
    engine: str | None = None,
) -> tuple[np.ndarray | None, str | None]:
    """Replay gap [rad], (n,), or ``None`` and why: an effect that cannot be simulated, an arm that runs away."""
    try:
        return replay(
            case.arm, effects, recording, case.controller, engine=engine
        ).rmse, None
    except (
        GapscopeError,
        ArithmeticError,
        ValueError,
    ) as error:  # LinAlgError is a ValueError
        return None, str(error)


def _unseen(case: Case, predictor: HeldOutPredictor) -> Recording:
    """The recording that is replayed."""
    if predictor.judged:
        return next(r for r in case.judged if r.tau is not None)
    recording, fold = (
        [r for r in case.recordings if r.tau is not None][-1],
        predictor.folds[-1],
    )
    return _rows(
        recording,
        (recording.t >= fold[0].motion.t[0]) & (recording.t <= fold[-1].motion.t[-1]),
    )


def _effects(
    predictor: HeldOutPredictor, terms: frozenset[Term]
) -> tuple[AppliedEffect, ...]:
    """Some of the effects found, with values that were not fitted to the recording that is replayed."""
    evidence = predictor.selection.evidence
    theta = (
        evidence.fit(terms).theta if predictor.judged else evidence.without_last(terms)
    )
    return evidence.terms.effects(evidence.terms.clipped(theta), terms)


def _head(recording: Recording, duration: float) -> Recording:
    """The first seconds of a recording."""
    return _rows(recording, recording.t <= recording.t[0] + duration)


def _rows(recording: Recording, kept: np.ndarray) -> Recording:
    """Some rows of a recording, by a mask of shape (N,)."""
    arrays = {f.name: getattr(recording, f.name) for f in fields(recording)}
    return replace(
        recording,
        **{name: x[kept] for name, x in arrays.items() if isinstance(x, np.ndarray)},
    )
