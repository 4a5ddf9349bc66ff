"""From a diagnosis to the recording that would settle what it leaves open."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.advice.contrast import Contrast, HypothesisContrast
from gapscope.diagnosis.advice.hypotheses import hypotheses
from gapscope.diagnosis.advice.hypothesis import Hypothesis
from gapscope.diagnosis.advice.motion_options import SPEEDS, MotionOption, options
from gapscope.diagnosis.advice.questions import Question, open_questions
from gapscope.diagnosis.advice.recorded_data import RecordedData
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.found_fault import repaired
from gapscope.diagnosis.thresholds import (
    LEAST_SCREENING,
    PAYLOAD_WORTH,
    SCREENING_SHARE,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.ident.excitation.design import Excitation, design, prepare
from gapscope.ident.excitation.excitation_plan import ExcitationPlan, LimitPlan
from gapscope.ident.excitation.random_search import RandomSearch
from gapscope.ident.excitation.trajectory_search import Budget

GENERAL = "quick"
"""Speed of the recording for a gap that nothing explains."""


@dataclass(frozen=True)
class AdviceRequest:
    """What is asked of the next recording.

    Attributes:
        limits: what the motion has to keep.
        payload: known payload that could be mounted, or ``None``.
        fastest: highest frequency of a motion that the controller follows [Hz].
        rate: samples per second to write [Hz].
        evaluations: objective evaluations, over all options.
        seed: of the search; by default another one each time.
    """

    limits: LimitPlan
    payload: KnownLoad | None = None
    fastest: float = 5.0
    rate: float = 250.0
    evaluations: int = 1000
    seed: int | None = None


@dataclass(frozen=True)
class Advice:
    """The next recording.

    Attributes:
        questions: what is open.
        hypotheses: what was found, then one per question with the rival in place; empty if nothing is open.
        pairs: contrast of each two of them; empty likewise.
        tried: options with the least contrast that a short search reached, ``None`` if it kept no limits.
        option: the one chosen, or ``None`` if nothing is open.
        plan: of the search.
        excitation: the motion found; ``None`` if no recording is needed.
    """

    questions: tuple[Question, ...]
    hypotheses: tuple[Hypothesis, ...] = ()
    pairs: tuple[HypothesisContrast, ...] = ()
    tried: tuple[tuple[MotionOption, float | None], ...] = ()
    option: MotionOption | None = None
    plan: ExcitationPlan | None = None
    excitation: Excitation | None = None


def advise(
    case: Case,
    document: Mapping[str, Any],
    effects: tuple[AppliedEffect, ...],
    request: AdviceRequest,
    progress: Callable[[float, float], None] = lambda share, best: None,
) -> Advice:
    """Design the next recording.

    Args:
        case: that was diagnosed.
        document: its ``diagnosis.json``.
        effects: those found, with values.
        request: what is asked.
        progress: called with the share of the budget spent [1] and the best value so far, as a search has it.

    Raises:
        InputError: the limits allow no trajectory, or none was found within the budget.
    """
    questions = open_questions(document)
    with threadpool_limits(1):
        if questions:
            return _between(case, document, effects, questions, request, progress)
        if (
            document["unexplained"]["above_floor"]
            or document["verdict"] == "unexplained"
        ):
            plan = replace(
                SPEEDS[GENERAL],
                rate=request.rate,
                criterion="d",
                budget=Budget(request.evaluations),
            )
            found = design(
                case.arm,
                plan,
                request.limits,
                np.random.default_rng(request.seed),
                progress,
            )
            return Advice((), plan=plan, excitation=found)
    return Advice(())


def _between(
    case: Case,
    document: Mapping[str, Any],
    effects: tuple[AppliedEffect, ...],
    questions: list[Question],
    request: AdviceRequest,
    progress: Callable[[float, float], None],
) -> Advice:
    if any(entry["effect"] not in CATALOGUE for entry in document["effects"]):
        case = repaired(case, find_setup_faults(case))
    present = RecordedData.of(
        case, np.array(document["gap"]["before"]["floor"], dtype=float)
    )
    rivals = hypotheses(case.arm, effects, questions, present)
    offered = options(request.payload, request.fastest)
    bodies = {option.payload: option.body(present.body) for option in offered}
    contrasts = {
        load: Contrast(case.arm, rivals, present, body) for load, body in bodies.items()
    }
    rng = np.random.default_rng(request.seed)
    tried = _screen(
        case.arm,
        offered,
        contrasts,
        bodies,
        request,
        rng,
        _part(progress, 0.0, SCREENING_SHARE),
    )
    option = _chosen(tried)
    budget = Budget(
        max(LEAST_SCREENING, round((1 - SCREENING_SHARE) * request.evaluations))
    )
    plan = replace(option.plan(request.rate), budget=budget)
    contrast, body = contrasts[option.payload], bodies[option.payload]
    rest = _part(progress, SCREENING_SHARE, 1 - SCREENING_SHARE)
    excitation = design(case.arm, plan, request.limits, rng, rest, contrast, body)
    pairs = tuple(contrast.on(excitation.motion))
    return Advice(
        tuple(questions), tuple(rivals), pairs, tuple(tried), option, plan, excitation
    )


def _screen(
    arm: NominalArm,
    offered: list[MotionOption],
    contrasts: Mapping[KnownLoad | None, Contrast],
    bodies: Mapping[KnownLoad | None, RigidBody],
    request: AdviceRequest,
    rng: np.random.Generator,
    progress: Callable[[float, float], None],
) -> list[tuple[MotionOption, float | None]]:
    """The least contrast that a short random search reaches with each option, ``None`` if none keeps the limits.

    Raises:
        InputError: the limits allow none of the options.
    """
    each = Budget(
        max(LEAST_SCREENING, int(SCREENING_SHARE * request.evaluations / len(offered)))
    )
    tried: list[tuple[MotionOption, float | None]] = []
    refused: InputError | None = None
    for k, option in enumerate(offered):
        plan, load = replace(option.plan(request.rate), budget=each), option.payload
        part = _part(progress, k / len(offered), 1 / len(offered))
        try:
            search = prepare(
                arm, plan, request.limits, part, contrasts[load], bodies[load]
            ).search
        except InputError as error:
            refused = error
            tried.append((option, None))
            continue
        RandomSearch().run(search, rng)
        tried.append(
            (option, float(np.exp(-search.found[-1].value)) if search.found else None)
        )
    if refused is not None and all(reached is None for _, reached in tried):
        raise refused
    return tried


def _chosen(tried: list[tuple[MotionOption, float | None]]) -> MotionOption:
    """The option with the largest contrast; a payload must be worth its trouble.

    If no short search met the limits, the full one starts at the moderate speed, or the first offered.
    """
    worth = {
        option: (reached or 0.0) / (1.0 if option.payload is None else PAYLOAD_WORTH)
        for option, reached in tried
    }
    best = max(worth, key=lambda option: worth[option])
    return (
        best
        if worth[best] > 0
        else next((o for o in worth if o.speed == "moderate"), best)
    )


def _part(
    progress: Callable[[float, float], None], begun: float, share: float
) -> Callable[[float, float], None]:
    """The progress of a part of the work."""
    return lambda done, best: progress(begun + share * done, best)
