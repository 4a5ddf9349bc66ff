"""The next recording: hypotheses that are open, motions that could be made, what each would tell, and the advice."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import expit
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name, listing, percent, significant
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.comparison import NONE
from gapscope.diagnosis.document.wording import acts_on
from gapscope.diagnosis.prepare import prepare, silent
from gapscope.diagnosis.selection.search import search_of
from gapscope.diagnosis.thresholds import (
    DESIGNED_ALTERNATIVES,
    MIN_SCREENING,
    OPEN_ALTERNATIVE,
    PAYLOAD_WORTH,
    SCREENING_SHARE,
    TIMES_RECORDED,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.catalogue import explained
from gapscope.ident.excitation.design import (
    Excitation,
    ExcitationPlan,
    LimitPlan,
    design,
)
from gapscope.ident.excitation.design import Prepared as PreparedSearch
from gapscope.ident.excitation.design import prepare as prepare_search
from gapscope.ident.excitation.trajectory_search import (
    Budget,
    Separated,
    Separator,
    random_search,
)
from gapscope.model.conditioning import Segment
from gapscope.model.expected import ExpectedEvidence, Rivals
from gapscope.model.rows import Rows
from gapscope.model.terms import Terms

# What a diagnosis leaves open: effects for which another would do as well.


@dataclass(frozen=True)
class Question:
    """An effect found, and another that may replace it.

    Attributes:
        effect: name of the effect found.
        joints: its joints from 1; empty for the arm or a link.
        link: the joint that moves its link, or 0.
        rival: name of the other effect; ``none`` if there may be nothing in its place.
        rival_joints: its joints.
        probability: of the rival [1].
        found, other: both in words.
    """

    effect: str
    joints: tuple[int, ...]
    link: int
    rival: str
    rival_joints: tuple[int, ...]
    probability: float
    found: str
    other: str


def open_questions(document: Mapping[str, Any]) -> list[Question]:
    """The open questions of ``diagnosis.json``, the most probable rival first, at most ``DESIGNED_ALTERNATIVES``.

    No recording is designed for setup faults, which are not physics of the arm, nor for what a motion alone does not
    predict: how far a command exceeds a limit depends on the controller. None tells two names of one cause apart.
    """
    # nothing in its place is a rival like any other
    designed = {NONE, *(e.name for e in explained() if not e.limits)}
    questions = [
        _question(entry, rival)
        for entry in document["effects"]
        for rival in entry["alternatives"]
        if rival["probability"] >= OPEN_ALTERNATIVE
        and {rival["effect"], entry["effect"]} <= designed
        and not rival.get("equivalent")
    ]
    questions.sort(key=lambda question: -question.probability)
    return questions[:DESIGNED_ALTERNATIVES]


def _question(entry: Mapping[str, Any], rival: Mapping[str, Any]) -> Question:
    link = entry["parameters"].get("link")
    rival_joints = tuple(rival.get("joints") or ())
    other = "no effect in its place"
    if rival["effect"] != NONE:
        place = acts_on({"effect": rival["effect"], "joints": list(rival_joints)})
        other = f"{effect_name(rival['effect'])} ({place})"
    return Question(
        effect=entry["effect"],
        joints=tuple(entry["joints"]),
        link=int(link["value"]) if link else 0,
        rival=rival["effect"],
        rival_joints=rival_joints,
        probability=rival["probability"],
        found=f"{effect_name(entry['effect'])} ({acts_on(entry)})",
        other=other,
    )


# From open questions to hypotheses, and what a motion is expected to say between them.


def hypotheses(
    effects: tuple[AppliedEffect, ...], questions: list[Question], last_link: int
) -> list[set[tuple[str, int]]]:
    """What was found, then for each question the same with the rival in place: effects with joint or link; 0: the arm.

    Args:
        effects: those found.
        questions: what is open.
        last_link: the joint that moves it, from 1: a rival on a link is on that one.
    """
    found = {(e.name, place) for e in effects for place in _places(e)}
    out = [found]
    for question in questions:
        # all places of the effect; of several changed links the one that is asked about
        asked = {
            (e.name, place)
            for e in effects
            if e.name == question.effect and question.link in (0, *_places(e))
            for place in _places(e)
        }
        rival: set[tuple[str, int]] = set()
        if question.rival != NONE:
            on_link = by_name(question.rival).scope == "link"
            places = (last_link,) if on_link else question.rival_joints or (0,)
            rival = {(question.rival, place) for place in places}
        # reads as (found - asked) | rival
        out.append(found - asked | rival)
    return out


def _places(applied: AppliedEffect) -> tuple[int, ...]:
    """The joints of an effect, or its link; 0 for the arm."""
    if "link" in applied.parameters:
        return (int(applied.parameters["link"]),)
    return applied.joints or (0,)


class PlannedEvidence:
    """What planned motions are expected to say between hypotheses.

    Args:
        case: with the recordings at hand, those with a torque.
        sets: the hypotheses, as ``hypotheses`` gives them.
    """

    def __init__(self, case: Case, sets: Sequence[Collection[tuple[str, int]]]) -> None:
        # values of the hypotheses are fitted to these
        recordings = [r for r in case.recordings if r.tau is not None]
        self._search = search_of(case.arm, recordings)
        self.rivals = Rivals(self._search.arm, self._search.rivals(sets))
        arm = self._search.arm
        terms = Terms(arm.arm.n_joints, {}, arm.arm.coupled_motors)
        # what exceeds a limit depends on the controller, not on the motion
        self._nominal = arm.corrected(terms).unlimited

    def on(self, motion: Motion, payload: KnownLoad | None) -> list[ExpectedEvidence]:
        """What a motion with a payload is expected to say between each two of them."""
        search, present = self._search, self._search.rows
        # stands in for a torque that is not recorded yet
        torque = self._nominal.predict(search.arm.body.carrying(payload), motion)
        # no noise, no filters: a motion as it is planned
        segment = Segment("planned", motion, torque, payload=payload)
        rows = Rows([[[segment]]], present.cutoff, 1)
        # as in the recordings at hand, so that nats are the same
        rows.scale = present.scale
        rows.held(*present.holding)
        return self.rivals.on(search.design_on(rows, self.rivals.effects))

    def separator(self, payload: KnownLoad | None) -> Separator:
        """The least of it, in the place of what ``gapscope.ident.excitation`` makes large."""

        def separate(motion: Motion, matrix: np.ndarray) -> Separated:
            return Separated(
                min(pair.evidence for pair in self.on(motion, payload)), {}
            )

        return separate


# What the next recording may be: motions of several speeds, without and with a known payload.


SPEEDS = {
    "slow": ExcitationPlan(frequency=0.05),
    "moderate": ExcitationPlan(),
    "quick": ExcitationPlan(frequency=0.3),
    "lively": ExcitationPlan(kind="multisine", order=10, frequency=0.5),
}
"""Motions by the speed of their changes, up to 0.25, 0.5, 1.5 and 5 Hz."""


@dataclass(frozen=True)
class MotionOption:
    """One way to make the next recording.

    Attributes:
        speed: one of ``SPEEDS``.
        payload: known payload, or ``None``.
    """

    speed: str
    payload: KnownLoad | None

    @property
    def words(self) -> str:
        """In words."""
        top = highest(self.speed)
        load = (
            "without payload"
            if self.payload is None
            else f"with {self.payload.mass:g} kg"
        )
        return f"{self.speed} (up to {top:g} Hz), {load}"

    def plan(self, rate: float) -> ExcitationPlan:
        """The plan of its search, written at a rate [Hz]."""
        two = ("one explanation", "another")
        return replace(
            SPEEDS[self.speed], rate=rate, criterion="separation", effects=two
        )


def highest(speed: str) -> float:
    """Frequency of the last harmonic of a speed [Hz]."""
    return SPEEDS[speed].order * SPEEDS[speed].frequency


def options(payload: KnownLoad | None, fastest: float) -> list[MotionOption]:
    """All options whose motions hold no frequency above ``fastest`` [Hz].

    Raises:
        InputError: there is none.
    """
    # a bound given as the top of a speed allows that speed
    chosen = [name for name in SPEEDS if highest(name) <= fastest + 1e-9]
    if not chosen:
        least = min(highest(name) for name in SPEEDS)
        raise InputError(
            f"no motion is as slow as {fastest:g} Hz",
            f"give {least:g} Hz or more",
            where="fastest",
        )
    # a payload is offered beside none, never in its place
    loads = [None] if payload is None else [None, payload]
    return [MotionOption(name, load) for name in chosen for load in loads]


# From a diagnosis to the recording that would settle what it leaves open.


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
        pairs: what the motion is expected to say between each two of what was found and, for each question, that with
            the rival in place; empty if nothing is open.
        tried: options with the least evidence that a short search reached, ``None`` if it kept no limits.
        option: the one chosen, or ``None`` if nothing is open.
        plan: of the search.
        excitation: the motion found; ``None`` if no recording is needed.
    """

    questions: tuple[Question, ...]
    pairs: tuple[ExpectedEvidence, ...] = ()
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
            # of what was diagnosed
            case = prepare(case, silent).case
            return _separating(case, effects, questions, request, progress)
        if unexplained or document["unexplained"]["above_floor"]:
            # a motion that excites all that a model may hold, by all evaluations: there is one option only
            budget = Budget(request.evaluations)
            plan = SPEEDS[GENERAL]
            plan = replace(plan, rate=request.rate, criterion="d", budget=budget)
            rng = np.random.default_rng(request.seed)
            found = design(
                prepare_search(case.arm, plan, request.limits, progress), rng
            )
            return Advice((), plan=plan, excitation=found)
    return Advice(())


def _separating(
    case: Case,
    effects: tuple[AppliedEffect, ...],
    questions: list[Question],
    request: AdviceRequest,
    progress: Progress,
) -> Advice:
    """The motion on which the hypotheses of the open questions differ most.

    Each option is screened by a short random search, and the best one is searched for with what is left.

    Raises:
        InputError: the limits allow none of the options.
    """
    every, body = options(request.payload, request.fastest), RigidBody(case.arm)
    asked = hypotheses(effects, questions, body.last_link + 1)
    evidence = PlannedEvidence(case, asked)
    rng = np.random.default_rng(request.seed)

    def search(option: MotionOption, share: float, begun: float) -> PreparedSearch:
        """The search for a motion, with a share of the evaluations, which are begun at another one."""
        evaluations = max(MIN_SCREENING, int(share * request.evaluations))
        budget = Budget(evaluations)
        return prepare_search(
            case.arm,
            replace(option.plan(request.rate), budget=budget),
            request.limits,
            lambda done, best: progress(begun + share * done, best),
            evidence.separator(option.payload),
            body.carrying(option.payload),
        )

    tried: list[tuple[MotionOption, float | None]] = []
    refused: InputError | None = None
    # the options share the screening evenly
    each = SCREENING_SHARE / len(every)
    for k, option in enumerate(every):
        try:
            short = search(option, each, k * each).search
        except InputError as error:
            # the limits may rule out this option alone
            refused = error
            tried.append((option, None))
            continue
        random_search(short, rng)
        # the search makes the negative logarithm of the evidence small
        reached = float(np.exp(-short.found[-1].value)) if short.found else None
        tried.append((option, reached))
    if refused is not None and all(reached is None for _, reached in tried):
        raise refused
    # what is left of the budget goes to the best option alone
    option = _chosen(tried)
    prepared = search(option, 1 - SCREENING_SHARE, SCREENING_SHARE)
    excitation = design(prepared, rng)
    return Advice(
        tuple(questions),
        tuple(evidence.on(excitation.motion, option.payload)),
        tuple(tried),
        option,
        prepared.plan,
        excitation,
    )


def _chosen(tried: list[tuple[MotionOption, float | None]]) -> MotionOption:
    """The option with the largest evidence; a payload must be worth its trouble.

    If no short search met the limits, the full one starts at the moderate speed, or the first offered.
    """
    worth = {}
    for option, reached in tried:
        # a load has to be mounted: its evidence counts for less
        needed = 1.0 if option.payload is None else PAYLOAD_WORTH
        worth[option] = (reached or 0.0) / needed
    best = max(worth, key=lambda option: worth[option])
    # zero: no short search has kept the limits
    if worth[best] > 0:
        return best
    return next((option for option in worth if option.speed == "moderate"), best)


# Advice in words.


def lines(advice: Advice, document: Mapping[str, Any]) -> list[str]:
    """What is open, what the new recording is expected to say of it, and what was chosen."""
    if not advice.questions:
        return list(_nothing_between(advice, document))
    out = list(_questions(advice))
    return [*out, *_verdict(advice), *_choice(advice)]


def _nothing_between(advice: Advice, document: Mapping[str, Any]) -> Iterable[str]:
    named = (
        f" The diagnosis asks for: {document['next_recording']}."
        if document["next_recording"]
        else ""
    )
    if advice.excitation is None:
        yield f"Nothing is open that another motion would settle: nothing was written.{named}"
        return
    joints = list(
        dict.fromkeys(
            str(region["joint"]) for region in document["unexplained"]["where"]
        )
    )
    place = (
        f", most of it on joint{'s' if len(joints) > 1 else ''} {listing(joints)}"
        if joints
        else ""
    )
    yield (
        "No two explanations are left to tell apart, but "
        f"{percent(document['unexplained']['share'])} of the gap is unexplained{place}."
    )
    yield "The new recording excites all that a model of the arm may hold; what no effect explains shows on it as well."


def _questions(advice: Advice) -> Iterable[str]:
    # pairs count hypotheses from what was found
    names = ["what was found", *(question.other for question in advice.questions)]
    for question in advice.questions:
        yield (
            f"Still open: {question.found}, or {question.other}, which has a probability of "
            f"{percent(question.probability)}."
        )
    for pair in advice.pairs:
        yield (
            f"Between {names[pair.first]} and {names[pair.second]} the new recording is expected to give an evidence "
            f"of {significant(pair.evidence, 2)} nats: the wrong one should keep a probability of "
            f"{percent(_kept(advice, pair))}; most by joint {pair.joint}."
        )


def _kept(advice: Advice, pair: ExpectedEvidence, times: int = 1) -> float:
    """Probability that the wrong one of two hypotheses should keep beside the other, after some recordings [1]."""
    # log odds against what was found; its own, the first, are zero
    odds = [
        0.0,
        *(np.log(q.probability / (1.0 - q.probability)) for q in advice.questions),
    ]
    # the worse of both ways: either one may turn out to be wrong
    return float(
        expit(abs(odds[pair.first] - odds[pair.second]) - times * pair.evidence)
    )


def _verdict(advice: Advice) -> Iterable[str]:
    once, repeated = (
        max(_kept(advice, pair, times) for pair in advice.pairs)
        for times in (1, TIMES_RECORDED)
    )
    # settled is what would not be listed as open any more
    if once < OPEN_ALTERNATIVE:
        yield "That should settle it: record it, add it to the case, and diagnose again."
    elif repeated < OPEN_ALTERNATIVE:
        yield "That may settle it: record it two or three times, add it to the case, and diagnose again."
    else:
        yield (
            "That will hardly settle it: within these limits no motion was found that says more. Wider limits, a known "
            "payload (--payload), a joint torque sensor or an encoder behind the gears may."
        )


def _choice(advice: Advice) -> Iterable[str]:
    assert advice.option is not None
    known = [
        (option.words, "breaks the limits" if d is None else significant(d, 2))
        for option, d in advice.tried
    ]
    yield f"Chosen: {advice.option.words}. Reached in a short search, in nats:"
    yield from (f"  {words}: {reached}" for words, reached in known)
    if advice.option.payload is not None:
        x, y, z = (f"{number:g}" for number in advice.option.payload.com)
        yield f"Mount {advice.option.payload.words}, and say so in case.yaml, under the name of the new recording:"
        yield "  payloads:"
        yield f"    recording.csv: {{mass: {advice.option.payload.mass:g}, com: [{x}, {y}, {z}]}}"
    elif any(option.payload is not None for option, _ in advice.tried):
        yield "The payload does not separate them enough better to be worth mounting."
