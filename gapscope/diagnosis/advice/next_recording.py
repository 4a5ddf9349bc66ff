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

Progress = Callable[[float, float], None]
"""Called with the share of the budget spent [1] and the best value so far."""
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
    progress: Progress = lambda share, best: None,
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
    unexplained = document["verdict"] == "unexplained"
    with threadpool_limits(1):
        if questions:
            return _separating(case, document, effects, questions, request, progress)
        if unexplained or document["unexplained"]["above_floor"]:
            return _general(case, request, progress)
    return Advice(())


def _general(case: Case, request: AdviceRequest, progress: Progress) -> Advice:
    """A motion that excites all that a model of the arm may hold."""
    budget = Budget(request.evaluations)
    plan = replace(SPEEDS[GENERAL], rate=request.rate, criterion="d", budget=budget)
    rng = np.random.default_rng(request.seed)
    found = design(case.arm, plan, request.limits, rng, progress)
    return Advice((), plan=plan, excitation=found)


@dataclass(frozen=True)
class _Candidate:
    """An option with the bodies of the arm in it, and the contrast of the hypotheses on its motions."""

    option: MotionOption
    body: RigidBody
    contrast: Contrast


def _separating(
    case: Case,
    document: Mapping[str, Any],
    effects: tuple[AppliedEffect, ...],
    questions: list[Question],
    request: AdviceRequest,
    progress: Progress,
) -> Advice:
    """The motion on which the hypotheses of the open questions differ most."""
    if any(entry["effect"] not in CATALOGUE for entry in document["effects"]):
        case = repaired(case, find_setup_faults(case))
    floor = np.array(document["gap"]["before"]["floor"], dtype=float)
    present = RecordedData.of(case, floor)
    rivals = hypotheses(case.arm, effects, questions, present)
    candidates = _candidates(case.arm, request, rivals, present)
    rng = np.random.default_rng(request.seed)
    screening = _part(progress, 0.0, SCREENING_SHARE)
    tried = _screened(case.arm, candidates, request, rng, screening)
    option = _chosen(tried)
    chosen = next(c for c in candidates if c.option == option)
    evaluations = round((1 - SCREENING_SHARE) * request.evaluations)
    budget = Budget(max(LEAST_SCREENING, evaluations))
    plan = replace(option.plan(request.rate), budget=budget)
    excitation = design(
        case.arm,
        plan,
        request.limits,
        rng,
        _part(progress, SCREENING_SHARE, 1 - SCREENING_SHARE),
        chosen.contrast,
        chosen.body,
    )
    return Advice(
        tuple(questions),
        tuple(rivals),
        tuple(chosen.contrast.on(excitation.motion)),
        tuple(tried),
        option,
        plan,
        excitation,
    )


def _candidates(
    arm: NominalArm,
    request: AdviceRequest,
    rivals: list[Hypothesis],
    present: RecordedData,
) -> list[_Candidate]:
    """The options that the request allows; those with the same payload share their contrast."""
    by_payload: dict[KnownLoad | None, tuple[RigidBody, Contrast]] = {}
    candidates = []
    for option in options(request.payload, request.fastest):
        if option.payload not in by_payload:
            body = option.body(present.body)
            contrast = Contrast(arm, rivals, present, body)
            by_payload[option.payload] = body, contrast
        candidates.append(_Candidate(option, *by_payload[option.payload]))
    return candidates


def _screened(
    arm: NominalArm,
    candidates: list[_Candidate],
    request: AdviceRequest,
    rng: np.random.Generator,
    progress: Progress,
) -> list[tuple[MotionOption, float | None]]:
    """The least contrast that a short random search reaches with each option, ``None`` if none keeps the limits.

    Raises:
        InputError: the limits allow none of the options.
    """
    count = len(candidates)
    evaluations = int(SCREENING_SHARE * request.evaluations / count)
    budget = Budget(max(LEAST_SCREENING, evaluations))
    tried: list[tuple[MotionOption, float | None]] = []
    refused: InputError | None = None
    for k, candidate in enumerate(candidates):
        option = candidate.option
        try:
            search = prepare(
                arm,
                replace(option.plan(request.rate), budget=budget),
                request.limits,
                _part(progress, k / count, 1 / count),
                candidate.contrast,
                candidate.body,
            ).search
        except InputError as error:
            refused = error
            tried.append((option, None))
            continue
        RandomSearch().run(search, rng)
        # the search makes the negative logarithm of the contrast small
        reached = float(np.exp(-search.found[-1].value)) if search.found else None
        tried.append((option, reached))
    if refused is not None and all(reached is None for _, reached in tried):
        raise refused
    return tried


def _chosen(tried: list[tuple[MotionOption, float | None]]) -> MotionOption:
    """The option with the largest contrast; a payload must be worth its trouble.

    If no short search met the limits, the full one starts at the moderate speed, or the first offered.
    """
    worth = {}
    for option, reached in tried:
        needed = 1.0 if option.payload is None else PAYLOAD_WORTH
        worth[option] = (reached or 0.0) / needed
    best = max(worth, key=lambda option: worth[option])
    if worth[best] > 0:
        return best
    return next((option for option in worth if option.speed == "moderate"), best)


def _part(progress: Progress, begun: float, share: float) -> Progress:
    """The progress of a part of the work."""
    return lambda done, best: progress(begun + share * done, best)
