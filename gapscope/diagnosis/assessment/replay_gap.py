"""The replay gap of a case: the simulated arm, nominal and corrected, under the same commands as one recording."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rollout import LONGEST_STEP
from gapscope.arm.errors import GapscopeError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import REPLAYED_TICKS
from gapscope.effects.applied import AppliedEffect, State
from gapscope.effects.residual import ResidualNetwork
from gapscope.envs.engines import default_engine, installed
from gapscope.envs.replay import replay

SECOND_OPINION = "mujoco"
"""The engine that replays as well, if another is the default."""


class ReplayedMotion(NamedTuple):
    """One recording and its replays, N samples of n joints.

    Attributes:
        recording: its name.
        t: time [s], shape (N,).
        recorded: positions [rad or m], (N, n).
        nominal, corrected: positions of the simulated arms, or ``None``.
    """

    recording: str
    t: np.ndarray
    recorded: np.ndarray
    nominal: np.ndarray | None
    corrected: np.ndarray | None


class ReplayGap(NamedTuple):
    """RMS of replayed minus recorded position [rad], shape (n,), ``None`` if it was not replayed.

    Attributes:
        before, after: of the nominal arm, and of the arm with the effects found, in the default engine.
        by: what moved the simulated arm: the ``controller``, or, if it or the reference is not known, the recorded
            ``torque`` over short horizons; ``None`` if nothing was replayed.
        engine: the default engine, which replayed; ``None`` if nothing was replayed.
        warnings: why something was not replayed.
        only, without: of the arm with each effect alone, and with all others, by the effect's name in a finding; empty
            for arms with compliant joints, which are slow to simulate.
        elsewhere: before and after in another engine, if one is installed.
        motion: what was replayed; ``None`` if nothing was.
    """

    before: np.ndarray | None = None
    after: np.ndarray | None = None
    by: str | None = None
    engine: str | None = None
    warnings: tuple[str, ...] = ()
    only: Mapping[str, np.ndarray | None] = {}
    without: Mapping[str, np.ndarray | None] = {}
    elsewhere: Mapping[str, tuple[np.ndarray | None, np.ndarray | None]] = {}
    motion: ReplayedMotion | None = None


def replay_gap(
    case: Case, recording: Recording, effects: Mapping[str, AppliedEffect]
) -> ReplayGap:
    """Replay gap before and after, on one recording with values that were not fitted to it.

    Args:
        case: the nominal arm, its recordings with torque, and its controller if known.
        recording: the recording, or a part of one.
        effects: the effects found, by their names in findings, with values from elsewhere.
    """
    # joints on springs or with play take small steps
    compliant = any(not e.effect.locally_linear for e in effects.values())
    recording, by = _shortened(case, recording)
    nothing, everything = (), tuple(effects)

    @cache
    def attempted(names: tuple[str, ...], engine: str | None = None) -> Attempt:
        some = tuple(effects[name] for name in names)
        return attempt(case, some, recording, engine)

    warnings = []
    for arm, names in (("nominal", nothing), ("corrected", everything)):
        # only the two arms of the report are worth a warning
        why = attempted(names).why
        if why:
            warnings.append(f"{recording.name}: no replay of the {arm} arm: {why}")
    # With one effect found, the sets of only and without are those of after and before: the cache replays each once.
    each = () if compliant else everything
    # two engines that agree show that the gap is no artefact of one of them
    differs = default_engine() != SECOND_OPINION and installed(SECOND_OPINION)
    others = [SECOND_OPINION] if differs else []
    before, after = attempted(nothing).rmse, attempted(everything).rmse
    replayed = before is not None or after is not None
    return ReplayGap(
        before=before,
        after=after,
        by=by if replayed else None,
        engine=default_engine() if replayed else None,
        warnings=tuple(warnings),
        only={name: attempted((name,)).rmse for name in each},
        without={
            name: attempted(tuple(n for n in everything if n != name)).rmse
            for name in each
        },
        elsewhere={
            engine: (
                attempted(nothing, engine).rmse,
                attempted(everything, engine).rmse,
            )
            for engine in others
        },
        motion=ReplayedMotion(
            recording.name,
            recording.t,
            recording.q,
            attempted(nothing).moved,
            attempted(everything).moved,
        ),
    )


class Attempt(NamedTuple):
    """A replay gap [rad], (n,), or ``None`` and why there is none; positions of the simulated arm; what moved it."""

    rmse: np.ndarray | None
    why: str | None
    moved: np.ndarray | None = None
    through_controller: bool = False


def attempt(
    case: Case,
    effects: tuple[AppliedEffect, ...],
    recording: Recording,
    engine: str | None = None,
    residual: ResidualNetwork | None = None,
    states: tuple[State, ...] = (),
) -> Attempt:
    """Replay, which fails with an effect that cannot be simulated or an arm that diverges."""
    try:
        replayed = replay(
            case.arm,
            effects,
            recording,
            case.controller,
            engine=engine,
            residual=residual,
            states=states,
        )
    # LinAlgError is a ValueError.
    except (GapscopeError, ArithmeticError, ValueError) as error:
        return Attempt(None, str(error))
    return Attempt(replayed.rmse, None, replayed.q, replayed.through_controller)


def _shortened(case: Case, recording: Recording) -> tuple[Recording, str]:
    """A recording shortened to what computing time allows, and what moves the arm in its replay."""
    # with known commands the loop runs as it did; else the recorded torque does
    if case.controller is not None and recording.q_ref is not None:
        by, rate = "controller", case.controller.rate
    else:
        # a slow log is simulated in shorter steps, which count as ticks
        by, rate = "torque", max(recording.rate, 1.0 / LONGEST_STEP)
    end = recording.t[0] + REPLAYED_TICKS / rate
    return recording.part(recording.t <= end), by
