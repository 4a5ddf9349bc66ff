"""The next recording: hypotheses that are open, motions that could be made, what each would tell, and the advice."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name, percent, significant
from gapscope.arm.dynamics.inertials import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.diagnosis.document.wording import acts_on, listing
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.found_fault import repaired
from gapscope.diagnosis.thresholds import (
    ADVICE_RATE,
    DESIGNED_ALTERNATIVES,
    FIT_DRAWS,
    FIT_STARTS,
    FIT_STEPS,
    INERTIAL_ERROR,
    MAY_SETTLE,
    MIN_PARAMETER_SCALE,
    MIN_SCREENING,
    OPEN_ALTERNATIVE,
    PAYLOAD_WORTH,
    SCREENING_SHARE,
    SETTLES,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE, explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External
from gapscope.effects.parameter import Parameter
from gapscope.effects.severity import draw
from gapscope.ident.excitation.design import (
    Excitation,
    ExcitationPlan,
    LimitPlan,
    design,
    prepare,
)
from gapscope.ident.excitation.design import Prepared as PreparedSearch
from gapscope.ident.excitation.trajectory_search import Budget, Separated, random_search
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
    thinned,
    torque_scale,
)
from gapscope.model.effective_samples import band_samples
from gapscope.model.torque_gap import filtered_torque

# The parameters of several effects as one vector, to fit them and to differentiate by them.


FIXED = ("link", "start", "end", "cycles")
"""Parameters that are not fitted: a name, times that belong to one recording, a count of teeth or poles."""
RIDGE = 1e-9
"""Keeps a parameter that the data do not show at its value [1]."""
FARTHEST = 1e6
"""Stands for bounds that are farther away, in units of a parameter's scale [1]."""


def free(
    effects: tuple[AppliedEffect, ...],
) -> Iterator[tuple[int, Parameter, np.ndarray]]:
    """Index of the effect, parameter and values (m,) of all that is fitted, in the order of the vector."""
    for index, applied in enumerate(effects):
        for parameter in applied.effect.parameters:
            if parameter.name not in FIXED:
                values = np.atleast_1d(applied.parameters[parameter.name])
                yield index, parameter, values.ravel()


class Coordinates(NamedTuple):
    """Values of effects as one vector, of length P.

    Attributes:
        values: [SI units].
        scale: size of each, for steps and for conditioning.
        low, high: bounds, no farther away than ``FARTHEST`` scales.
        lasting: which act on another recording too: an external force does not come again.
    """

    values: np.ndarray
    scale: np.ndarray
    low: np.ndarray
    high: np.ndarray
    lasting: np.ndarray


def coordinates(effects: tuple[AppliedEffect, ...]) -> Coordinates:
    """The values of effects that are fitted."""
    parts = [np.zeros((5, 0))]
    for index, parameter, values in free(effects):
        largest = max(abs(value) for value in parameter.typical)
        scale = np.maximum(np.abs(values), MIN_PARAMETER_SCALE * largest)
        low = np.maximum(parameter.bounds[0], -FARTHEST * scale)
        high = np.minimum(parameter.bounds[1], FARTHEST * scale)
        lasts = not isinstance(effects[index].effect, External)
        lasting = np.full(len(values), float(lasts))
        parts.append(np.stack([values, scale, low, high, lasting]))
    values, scale, low, high, lasting = np.concatenate(parts, axis=1)
    return Coordinates(values, scale, low, high, lasting > 0)


def with_values(
    effects: tuple[AppliedEffect, ...], values: np.ndarray
) -> tuple[AppliedEffect, ...]:
    """The effects with other values, shape (P,), moved into their bounds."""
    changed = [dict(applied.parameters) for applied in effects]
    start = 0
    for index, parameter, old in free(effects):
        end = start + len(old)
        shape = np.shape(effects[index].parameters[parameter.name])
        new = np.clip(values[start:end], *parameter.bounds)
        changed[index][parameter.name] = new.reshape(shape)
        start = end
    return tuple(
        replace(applied, parameters=parameters)
        for applied, parameters in zip(effects, changed, strict=True)
    )


# A hypothesis: the nominal arm with one explanation of the gap, and how its prediction moves with its parameters.


STEP = 1e-3
"""Step of the finite differences, in units of a parameter's scale [1]."""


@dataclass(frozen=True)
class Hypothesis:
    """One explanation.

    Attributes:
        words: what it says.
        arm: the nominal arm.
        effects: with values.
    """

    words: str
    arm: NominalArm
    effects: tuple[AppliedEffect, ...]

    def predict(self, body: RigidBody, motion: Motion) -> np.ndarray:
        """Torque that would be recorded, below the gap's cut-off [N m], (N, n)."""
        torque = CorrectedArm(self.arm, self.effects).unlimited.predict(body, motion)
        return low_pass(torque, motion.rate, TORQUE_CUTOFF)

    def jacobian(self, body: RigidBody, motion: Motion, here: np.ndarray) -> np.ndarray:
        """Derivative of the prediction ``here``, (N, n), by the parameters in units of their scales; (N, n, P)."""
        at = coordinates(self.effects)
        out = np.zeros((*here.shape, len(at.values)))
        # a value at its upper bound can only go down
        steps = np.where(at.values + STEP * at.scale <= at.high, STEP, -STEP)
        for k, change in enumerate(np.diag(steps * at.scale)):
            effects = with_values(self.effects, at.values + change)
            moved = replace(self, effects=effects)
            out[:, :, k] = (moved.predict(body, motion) - here) / steps[k]
        return out

    def elsewhere(self) -> Hypothesis:
        """The hypothesis on another recording: an external force does not come again."""
        lasting = tuple(e for e in self.effects if not isinstance(e.effect, External))
        return replace(self, effects=lasting)


# The recordings at hand, as the hypotheses are fitted to them and compared on them.


@dataclass(frozen=True)
class RecordedData:
    """Conditioned recordings of one arm with n joints.

    Attributes:
        body: dynamics of the nominal arm.
        segments: with torque, at about ``ADVICE_RATE``.
        measured: recorded torque of each, filtered and trimmed as the gap is [N m], each (M, n).
        floor: RMS that a healthy arm would leave on them [N m], (n,).
    """

    body: RigidBody
    segments: tuple[Segment, ...]
    measured: tuple[np.ndarray, ...]
    floor: np.ndarray

    @classmethod
    def of(cls, case: Case, floor: np.ndarray) -> RecordedData:
        """Of a case whose floor, as a share of ``gapscope.model.torque_gap.torque_scale``, is given; (n,).

        Raises:
            GapscopeError: no recording has a torque.
        """
        recordings = tuple(r for r in case.recordings if r.tau is not None)
        if not recordings:
            raise GapscopeError(
                f"{case.name}: no recording carries a torque",
                "give torque in column tau1..",
            )
        segments = tuple(
            thinned(s, ADVICE_RATE) for r in recordings for s in condition(r)
        )
        measured = tuple(filtered_torque(s) for s in segments)
        return cls(
            RigidBody(case.arm),
            segments,
            measured,
            floor * torque_scale(np.vstack(measured)),
        )

    def residual(self, hypothesis: Hypothesis) -> np.ndarray:
        """Predicted minus recorded torque over the floor [1], all samples and joints in a row."""
        parts = []
        for segment, measured in zip(self.segments, self.measured, strict=True):
            body = segment.bodies(self.body)
            predicted = hypothesis.predict(body, segment.motion)[segment.inner]
            parts.append(((predicted - measured) / self.floor).ravel())
        return np.concatenate(parts)

    def jacobian(self, hypothesis: Hypothesis) -> np.ndarray:
        """Derivative of ``residual`` by the parameters in units of their scales, (M n, P)."""
        parts = []
        for segment in self.segments:
            body = segment.bodies(self.body)
            here = hypothesis.predict(body, segment.motion)
            slopes = hypothesis.jacobian(body, segment.motion, here)[segment.inner]
            in_floors = slopes / self.floor[:, None]
            parts.append(in_floors.reshape(-1, slopes.shape[2]))
        return np.vstack(parts)


def fitted(present: RecordedData, hypothesis: Hypothesis) -> tuple[Hypothesis, float]:
    """A hypothesis with the values that explain the recordings best, and the mean square it leaves in floors [1]."""
    effects, start = hypothesis.effects, coordinates(hypothesis.effects)
    scale = start.scale
    if not len(scale):
        return hypothesis, float(np.mean(present.residual(hypothesis) ** 2))

    def at(x: np.ndarray) -> Hypothesis:
        return replace(hypothesis, effects=with_values(effects, x * scale))

    def slope(x: np.ndarray) -> np.ndarray:
        here = at(x)
        return present.jacobian(here) * (scale / coordinates(here.effects).scale)

    low, high = start.low / scale, start.high / scale
    # least_squares wants a start strictly inside the bounds
    margin = RIDGE * np.minimum(high - low, 1.0)
    first = np.clip(start.values / scale, low + margin, high - margin)
    done = least_squares(
        lambda x: present.residual(at(x)), first, slope, (low, high), max_nfev=FIT_STEPS
    )
    return at(done.x), float(np.mean(done.fun**2))


def with_unknown(
    present: RecordedData,
    hypothesis: Hypothesis,
    name: str,
    joints: tuple[int, ...],
    rng: np.random.Generator,
) -> Hypothesis:
    """A hypothesis with one more effect, whose values are found from several starts of the size of real arms'."""
    scale = ArmScale.of(hypothesis.arm)
    tried: list[tuple[float, int, Hypothesis]] = []
    for number in range(FIT_DRAWS):
        drawn: AppliedEffect = draw(name, rng, scale, joints or None)
        started = replace(hypothesis, effects=(*hypothesis.effects, drawn))
        mean_square = float(np.mean(present.residual(started) ** 2))
        tried.append((mean_square, number, started))
    best = [fitted(present, started) for _, _, started in sorted(tried)[:FIT_STARTS]]
    return min(best, key=lambda pair: pair[1])[0]


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
    questions = []
    for entry in document["effects"]:
        for rival in entry["alternatives"]:
            if rival["probability"] >= OPEN_ALTERNATIVE and _designed(entry, rival):
                questions.append(_question(entry, rival))
    questions.sort(key=lambda question: -question.probability)
    return questions[:DESIGNED_ALTERNATIVES]


def _designed(entry: Mapping[str, Any], rival: Mapping[str, Any]) -> bool:
    """Whether a motion can be designed to separate two effects."""
    if rival.get("equivalent"):
        return False
    designed = {"none", *(e.name for e in explained() if not e.limits)}
    return {rival["effect"], entry["effect"]} <= designed


def _question(entry: Mapping[str, Any], rival: Mapping[str, Any]) -> Question:
    link = entry["parameters"].get("link")
    rival_joints = tuple(rival.get("joints") or ())
    return Question(
        effect=entry["effect"],
        joints=tuple(entry["joints"]),
        link=int(link["value"]) if link else 0,
        rival=rival["effect"],
        rival_joints=rival_joints,
        probability=rival["probability"],
        found=f"{effect_name(entry['effect'])} ({acts_on(entry)})",
        other=_words(rival["effect"], rival_joints),
    )


def _words(rival: str, joints: tuple[int, ...]) -> str:
    """A rival with what it acts on."""
    if rival == "none":
        return "no effect in its place"
    return (
        f"{effect_name(rival)} ({acts_on({'effect': rival, 'joints': list(joints)})})"
    )


# From open questions to hypotheses, each with its own values.


def hypotheses(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    questions: list[Question],
    present: RecordedData,
) -> list[Hypothesis]:
    """What was found, then for each question the same with the rival in place; all fitted to the recordings at hand.

    Args:
        arm: the nominal arm.
        effects: those found, with values.
        questions: what is open.
        present: the recordings.
    """
    rng = np.random.default_rng(0)
    out = [fitted(present, Hypothesis("what was found", arm, effects))[0]]
    for question in questions:
        rest = tuple(e for e in out[0].effects if not _asked(e, question))
        with_rival = Hypothesis(question.other, arm, rest)
        if question.rival == "none":
            out.append(fitted(present, with_rival)[0])
        else:
            out.append(
                with_unknown(
                    present, with_rival, question.rival, question.rival_joints, rng
                )
            )
    return out


def _asked(applied: AppliedEffect, question: Question) -> bool:
    """Whether a question is about this effect."""
    link = int(applied.parameters["link"]) if "link" in applied.parameters else 0
    return applied.name == question.effect and link == question.link


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
        self._hypotheses, self.body, self._floor = hypotheses, body, present.floor
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
        """Predictions on all present recordings, thinned: more rows than twice the band hold nothing new."""
        parts = []
        for segment in present.segments:
            motion, step = segment.motion, 2 * TORQUE_CUTOFF
            every = max(1, int(motion.rate / step))
            rows = np.arange(len(motion.t))[segment.inner][::every]
            body = segment.bodies(present.body)
            parts.append(self._weighted(self._hypotheses, body, motion, rows))
        slopes = [
            np.vstack([part.slopes[h] for part in parts])
            for h in range(len(self._hypotheses))
        ]
        torque = np.concatenate([part.torque for part in parts], axis=1)
        durations = [float(s.motion.t[-1] - s.motion.t[0]) for s in present.segments]
        samples = band_samples(sum(durations), TORQUE_CUTOFF)
        return WeightedPredictions(torque, slopes, samples)

    def _on_motion(self, motion: Motion) -> WeightedPredictions:
        """Predictions on a new motion, on which parameters of what does not last have no effect."""
        rows = np.arange(len(motion.t))
        elsewhere = [hypothesis.elsewhere() for hypothesis in self._hypotheses]
        weighted = self._weighted(elsewhere, self.body, motion, rows)
        bodies, slopes = len(self._inertial_scale), []
        for hypothesis, given in zip(self._hypotheses, weighted.slopes, strict=True):
            own = coordinates(hypothesis.effects).lasting
            lasting = np.r_[own, np.ones(bodies, dtype=bool)]
            every = np.zeros((*given.shape[:2], len(lasting)))
            every[:, :, lasting] = given
            slopes.append(every)
        seconds = float(motion.t[-1] - motion.t[0])
        samples = band_samples(seconds, TORQUE_CUTOFF)
        return weighted._replace(slopes=slopes, samples=samples)

    def _weighted(
        self,
        hypotheses: list[Hypothesis],
        body: RigidBody,
        motion: Motion,
        rows: np.ndarray,
    ) -> WeightedPredictions:
        """Predictions and slopes at some rows over the floor; rows at which a joint may stick count less."""
        q, dq, ddq = motion.q[rows], motion.dq[rows], motion.ddq[rows]
        inertial = body.regressor(q, dq, ddq) * self._inertial_scale
        # of a smoothed direction s the share sqrt(1 - s^2) of dry friction is not known
        unknown2 = 1.0 - smooth_sign(dq / body.per_radian) ** 2
        weight = 1.0 / np.sqrt(self._floor**2 + self._coulomb**2 * unknown2)
        torque, slopes = [], []
        for hypothesis in hypotheses:
            here = hypothesis.predict(body, motion)
            own = hypothesis.jacobian(body, motion, here)[rows]
            columns = np.concatenate([own, inertial], axis=2)
            torque.append(here[rows] * weight)
            slopes.append(columns * weight[:, :, None])
        return WeightedPredictions(np.array(torque), slopes, float(len(rows)))

    def _prior(self, b: int) -> _Quadratic:
        """The prior of hypothesis b: its own parameters are free, the inertials near the nominal ones."""
        size = len(coordinates(self._hypotheses[b].effects).values)
        own = np.full(size, RIDGE)
        inertial = np.full(len(self._inertial_scale), INERTIAL_ERROR**-2)
        gram = np.diag(np.concatenate([own, inertial]))
        return _Quadratic(gram, np.zeros(len(gram)), 0.0)


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


def _separating(
    case: Case,
    document: Mapping[str, Any],
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
    if any(entry["effect"] not in CATALOGUE for entry in document["effects"]):
        case = repaired(case, find_setup_faults(case))
    floor = np.array(document["gap"]["before"]["floor"], dtype=float)
    present = RecordedData.of(case, floor)
    rivals = hypotheses(case.arm, effects, questions, present)
    contrasts: dict[MotionOption, Contrast] = {}
    by_payload: dict[KnownLoad | None, Contrast] = {}
    for option in options(request.payload, request.fastest):
        load = option.payload
        if load not in by_payload:
            body = present.body.carrying(load)
            by_payload[load] = Contrast(case.arm, rivals, present, body)
        contrasts[option] = by_payload[load]
    rng = np.random.default_rng(request.seed)

    def search(option: MotionOption, share: float, begun: float) -> PreparedSearch:
        """The search for a motion, with a share of the evaluations, which are begun at another one."""
        evaluations = max(MIN_SCREENING, int(share * request.evaluations))
        budget = Budget(evaluations)
        return prepare(
            case.arm,
            replace(option.plan(request.rate), budget=budget),
            request.limits,
            lambda done, best: progress(begun + share * done, best),
            contrasts[option].separate,
            contrasts[option].body,
        )

    tried: list[tuple[MotionOption, float | None]] = []
    refused: InputError | None = None
    each = SCREENING_SHARE / len(contrasts)
    for k, option in enumerate(contrasts):
        try:
            short = search(option, each, k * each).search
        except InputError as error:
            refused = error
            tried.append((option, None))
            continue
        random_search(short, rng)
        # the search makes the negative logarithm of the contrast small
        reached = float(np.exp(-short.found[-1].value)) if short.found else None
        tried.append((option, reached))
    if refused is not None and all(reached is None for _, reached in tried):
        raise refused
    option = _chosen(tried)
    prepared = search(option, 1 - SCREENING_SHARE, SCREENING_SHARE)
    excitation = design(prepared, rng)
    return Advice(
        tuple(questions),
        tuple(rivals),
        tuple(contrasts[option].on(excitation.motion)),
        tuple(tried),
        option,
        prepared.plan,
        excitation,
    )


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
    times = pair.new / max(pair.present, RIDGE)
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
