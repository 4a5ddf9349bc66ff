"""The next recording: motions that could be made, what each would tell, and the advice in words."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.display import percent, significant
from gapscope.arm.dynamics.inertials import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.diagnosis.document.wording import listing
from gapscope.diagnosis.hypotheses import (
    Hypothesis,
    Question,
    RecordedData,
    hypotheses,
    open_questions,
)
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.found_fault import repaired
from gapscope.diagnosis.thresholds import (
    ADVICE_INERTIALS,
    ADVICE_SAMPLE_STEP,
    MAY_SETTLE,
    MIN_SCREENING,
    PAYLOAD_WORTH,
    SCREENING_SHARE,
    SETTLES,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.ident.excitation.design import (
    Excitation,
    ExcitationPlan,
    LimitPlan,
    design,
    prepare,
)
from gapscope.ident.excitation.trajectory_search import Budget, Separated, random_search
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.effective_samples import band_samples

# What the next recording may be: motions of several speeds, without and with a known payload.


SPEEDS = {
    "slow": ExcitationPlan(kind="fourier", order=5, frequency=0.05, duration=20.0),
    "moderate": ExcitationPlan(kind="fourier", order=5, frequency=0.1, duration=10.0),
    "quick": ExcitationPlan(kind="fourier", order=5, frequency=0.3, duration=10.0),
    "lively": ExcitationPlan(kind="multisine", order=10, frequency=0.5, duration=10.0),
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

    def body(self, nominal: RigidBody) -> RigidBody:
        """The arm's bodies with the payload."""
        return nominal.carrying(self.payload)


def highest(speed: str) -> float:
    """Frequency of the last harmonic of a speed [Hz]."""
    return SPEEDS[speed].order * SPEEDS[speed].frequency


def options(payload: KnownLoad | None, fastest: float) -> list[MotionOption]:
    """All options whose motions hold no frequency above ``fastest`` [Hz].

    Raises:
        InputError: there is none.
    """
    chosen = [name for name in SPEEDS if highest(name) <= fastest + 1e-9]
    if not chosen:
        least = min(highest(name) for name in SPEEDS)
        raise InputError(
            f"no motion is as slow as {fastest:g} Hz",
            f"give {least:g} Hz or more",
            where="fastest",
        )
    loads = [None] if payload is None else [None, payload]
    return [MotionOption(name, load) for name in chosen for load in loads]


# How far the predictions of hypotheses are apart on a motion, once each has been refitted as far as data allow.
#
# Of two hypotheses the true one, A, predicts y_A; the other, B, y_B + J_B x when its parameters move by x, and the
# errors v of the nominal inertials move it by N v. What B cannot follow is the contrast of the two, in units of the
# floor s:
#
#     d^2 = min over x, v of [ |(y_B + J_B x + N v - y_A) / s|^2 over all data + |v / sigma|^2 ] - the same of the old
#
# per independent sample of the new motion, summed over joints; the lesser of A, B and B, A counts. This is the
# T-criterion for rival models, with what is known already as a part of the data [atkinson1975].


RIDGE = 1e-9
"""Keeps a parameter that the data do not show at its value [1]."""


class WeightedPredictions(NamedTuple):
    """Predictions on some data, in floors; H hypotheses.

    Attributes:
        torque: predictions, each row weighed, (H, M, n).
        slopes: per hypothesis the derivatives by its own parameters and by the inertials, (M, n, P + 10 n).
        samples: independent samples [1].
    """

    torque: np.ndarray
    slopes: list[np.ndarray]
    samples: float


class HypothesisContrast(NamedTuple):
    """Contrast of two hypotheses: their places, d on the present recordings and on the new motion [1], joint from 1."""

    first: int
    second: int
    present: float
    new: float
    joint: int


@dataclass(frozen=True)
class _Quadratic:
    """|r + S x|^2 as a function of x: S^T S, S^T r, |r|^2, over independent samples."""

    gram: np.ndarray
    slope: np.ndarray
    rest: float

    def plus(self, other: _Quadratic) -> _Quadratic:
        return _Quadratic(
            self.gram + other.gram, self.slope + other.slope, self.rest + other.rest
        )

    def least(self) -> tuple[float, np.ndarray]:
        """The least value and its x."""
        x = -np.linalg.solve(self.gram, self.slope)
        return max(self.rest + float(self.slope @ x), 0.0), x


class Contrast:
    """Contrast of hypotheses; the torque of a known payload may be a part of the new motion's bodies.

    Args:
        arm: the nominal arm.
        hypotheses: two or more, fitted to the present recordings.
        present: these recordings.
        body: dynamics of the arm on the new motion: the nominal arm's, or with a known payload.
    """

    def __init__(
        self,
        arm: NominalArm,
        hypotheses: list[Hypothesis],
        present: RecordedData,
        body: RigidBody,
    ) -> None:
        self._hypotheses, self._body, self._floor = hypotheses, body, present.floor
        self._coulomb = np.abs(arm.coulomb)
        self._inertial_scale = inertial_scale(present.body)
        self.pairs = list(itertools.permutations(range(len(hypotheses)), 2))
        known = self._on_recordings(present)
        self._known = [
            self._prior(b).plus(_following(known, a, b)) for a, b in self.pairs
        ]
        self._least = [quadratic.least()[0] for quadratic in self._known]
        self.present = [float(np.sqrt(least / known.samples)) for least in self._least]

    def on(self, motion: Motion) -> list[HypothesisContrast]:
        """Contrast of each two hypotheses on a new motion; the lesser of both directions."""
        new = self._on_motion(motion)
        out: dict[tuple[int, int], HypothesisContrast] = {}
        for index, (a, b) in enumerate(self.pairs):
            total, x = self._known[index].plus(_following(new, a, b)).least()
            increase = max(total - self._least[index], 0.0)
            contrast = float(np.sqrt(increase / new.samples))
            first, second = min(a, b), max(a, b)
            known = out.get((first, second))
            if known is None or contrast < known.new:
                residual = new.torque[b] - new.torque[a] + new.slopes[b] @ x
                joint = int((residual**2).mean(axis=0).argmax()) + 1
                out[first, second] = HypothesisContrast(
                    first, second, self.present[index], contrast, joint
                )
        return list(out.values())

    def separate(self, motion: Motion, matrix: np.ndarray) -> Separated:
        """The least contrast, in the place of what ``gapscope.ident.excitation.trajectory_search`` makes large."""
        return Separated(min(pair.new for pair in self.on(motion)), {})

    def _on_recordings(self, present: RecordedData) -> WeightedPredictions:
        """Predictions on all present recordings, thinned."""
        parts = []
        for segment in present.segments:
            body, motion = segment.bodies(present.body), segment.motion
            rows = np.arange(len(motion.t))[segment.inner][::ADVICE_SAMPLE_STEP]
            predictions = [_Prediction.of(h, body, motion) for h in self._hypotheses]
            parts.append(self._weighted(predictions, body, motion, present.floor, rows))
        slopes = [
            np.vstack([part.slopes[h] for part in parts])
            for h in range(len(self._hypotheses))
        ]
        torque = np.concatenate([part.torque for part in parts], axis=1)
        durations = [float(s.motion.t[-1] - s.motion.t[0]) for s in present.segments]
        samples = band_samples(sum(durations), TORQUE_CUTOFF)
        return WeightedPredictions(torque, slopes, samples)

    def _on_motion(self, motion: Motion) -> WeightedPredictions:
        """Predictions on a new motion, in floors."""
        predictions = [
            _Prediction.elsewhere(h, self._body, motion) for h in self._hypotheses
        ]
        rows = np.arange(len(motion.t))
        weighted = self._weighted(predictions, self._body, motion, self._floor, rows)
        seconds = float(motion.t[-1] - motion.t[0])
        return weighted._replace(samples=band_samples(seconds, TORQUE_CUTOFF))

    def _weighted(
        self,
        predictions: list[_Prediction],
        body: RigidBody,
        motion: Motion,
        floor: np.ndarray,
        rows: np.ndarray,
    ) -> WeightedPredictions:
        """Predictions and slopes at some rows over the floor; rows at which a joint may stick count less."""
        q, dq, ddq = motion.q[rows], motion.dq[rows], motion.ddq[rows]
        inertial = body.regressor(q, dq, ddq) * self._inertial_scale
        # of a smoothed direction s the share sqrt(1 - s^2) of dry friction is not known
        unknown2 = 1.0 - smooth_sign(dq / body.per_radian) ** 2
        weight = 1.0 / np.sqrt(floor**2 + self._coulomb**2 * unknown2)
        torque = np.array([p.torque[rows] * weight for p in predictions])
        slopes = []
        for prediction in predictions:
            columns = np.concatenate([prediction.slopes[rows], inertial], axis=2)
            slopes.append(columns * weight[:, :, None])
        return WeightedPredictions(torque, slopes, float(len(rows)))

    def _prior(self, b: int) -> _Quadratic:
        """The prior of hypothesis b: its own parameters are free, the inertials near the nominal ones."""
        own = np.full(len(self._hypotheses[b].lasting), RIDGE)
        inertial = np.full(len(self._inertial_scale), ADVICE_INERTIALS**-2)
        gram = np.diag(np.concatenate([own, inertial]))
        return _Quadratic(gram, np.zeros(len(gram)), 0.0)


@dataclass(frozen=True)
class _Prediction:
    """Torque that a hypothesis predicts [N m], (N, n), and its derivatives by the hypothesis' parameters, (N, n, P)."""

    torque: np.ndarray
    slopes: np.ndarray

    @classmethod
    def of(cls, hypothesis: Hypothesis, body: RigidBody, motion: Motion) -> _Prediction:
        """On a recording that the hypothesis was fitted to."""
        torque = hypothesis.predict(body, motion)
        return cls(torque, hypothesis.jacobian(body, motion, torque))

    @classmethod
    def elsewhere(
        cls, hypothesis: Hypothesis, body: RigidBody, motion: Motion
    ) -> _Prediction:
        """On another motion, on which parameters of what does not last have no effect."""
        lasting = cls.of(hypothesis.elsewhere(), body, motion)
        slopes = np.zeros((*lasting.torque.shape, len(hypothesis.lasting)))
        slopes[:, :, hypothesis.lasting] = lasting.slopes
        return cls(lasting.torque, slopes)


def _following(data: WeightedPredictions, a: int, b: int) -> _Quadratic:
    """Squared distance of B, as its parameters move, from A, over independent samples."""
    share = data.samples / data.torque.shape[1]
    slopes = data.slopes[b].reshape(-1, data.slopes[b].shape[2])
    residual = (data.torque[b] - data.torque[a]).ravel()
    return _Quadratic(
        share * slopes.T @ slopes,
        share * slopes.T @ residual,
        share * float(residual @ residual),
    )


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
    found = design(prepare(case.arm, plan, request.limits, progress), rng)
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
    budget = Budget(max(MIN_SCREENING, evaluations))
    plan = replace(option.plan(request.rate), budget=budget)
    prepared = prepare(
        case.arm,
        plan,
        request.limits,
        _part(progress, SCREENING_SHARE, 1 - SCREENING_SHARE),
        chosen.contrast.separate,
        chosen.body,
    )
    excitation = design(prepared, rng)
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
    budget = Budget(max(MIN_SCREENING, evaluations))
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
                candidate.contrast.separate,
                candidate.body,
            ).search
        except InputError as error:
            refused = error
            tried.append((option, None))
            continue
        random_search(search, rng)
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


# Advice in words.


def lines(advice: Advice, document: Mapping[str, Any]) -> list[str]:
    """What is open, how far the predictions differ on the present and on the new recording, and what was chosen."""
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
    for k, question in enumerate(advice.questions, 1):
        pair = next(p for p in advice.pairs if (p.first, p.second) == (0, k))
        yield (
            f"Still open: {question.found}, or {question.other}, which has a probability of "
            f"{percent(question.probability)}."
        )
        yield f"  {_compared(pair)}"
    names = ["what was found", *(question.other for question in advice.questions)]
    for pair in advice.pairs:
        if pair.first > 0:
            yield f"Between {names[pair.first]} and {names[pair.second]}:"
            yield f"  {_compared(pair)}"


def _compared(pair: HypothesisContrast) -> str:
    times = pair.new / max(pair.present, 1e-9)
    more = f", {significant(times, 2)} times as much" if 1.0 < times < 1e3 else ""
    return (
        f"their predictions differ by {significant(pair.present, 2)} times the floor on the present recordings, and by "
        f"{significant(pair.new, 2)} times the floor on the new one{more}; most on joint {pair.joint}."
    )


def _verdict(advice: Advice) -> Iterable[str]:
    least = min(pair.new for pair in advice.pairs)
    if least >= SETTLES:
        yield "That should settle it: record it, add it to the case, and diagnose again."
    elif least >= MAY_SETTLE:
        yield "That may settle it: record it two or three times, add it to the case, and diagnose again."
    else:
        yield (
            "That will hardly settle it: within these limits no motion was found on which they differ by more. Wider "
            "limits, a known payload (--payload), a joint torque sensor or an encoder behind the gears may."
        )


def _choice(advice: Advice) -> Iterable[str]:
    assert advice.option is not None
    known = [
        (option.words, "breaks the limits" if d is None else significant(d, 2))
        for option, d in advice.tried
    ]
    yield f"Chosen: {advice.option.words}. Reached in a short search, in floors:"
    yield from (f"  {words}: {reached}" for words, reached in known)
    if advice.option.payload is not None:
        x, y, z = (f"{number:g}" for number in advice.option.payload.com)
        yield f"Mount {advice.option.payload.words}, and say so in case.yaml, under the name of the new recording:"
        yield "  payloads:"
        yield f"    recording.csv: {{mass: {advice.option.payload.mass:g}, com: [{x}, {y}, {z}]}}"
    elif any(option.payload is not None for option, _ in advice.tried):
        yield "The payload does not separate them enough better to be worth mounting."
