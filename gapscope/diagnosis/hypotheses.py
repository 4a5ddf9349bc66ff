"""What a next recording could tell apart: hypotheses that are open, and their questions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.document.wording import acts_on
from gapscope.diagnosis.thresholds import (
    ADVICE_RATE,
    DESIGNED_ALTERNATIVES,
    FIT_DRAWS,
    FIT_STARTS,
    FIT_STEPS,
    MIN_PARAMETER_SCALE,
    OPEN_ALTERNATIVE,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External
from gapscope.effects.parameter import Parameter
from gapscope.effects.severity import draw
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
    thinned,
    torque_scale,
)
from gapscope.model.torque_gap import filtered_torque

# The parameters of several effects as one vector, to fit them and to differentiate by them.


FIXED = ("link", "start", "end", "cycles")
"""Parameters that are not fitted: a name, times that belong to one recording, a count of teeth or poles."""
FARTHEST = 1e6
"""Stands for bounds that are farther away, in units of a parameter's scale [1]."""


def free(
    effects: tuple[AppliedEffect, ...],
) -> Iterator[tuple[int, Parameter, np.ndarray]]:
    """Index of the effect, parameter and values (m,) of all that is fitted, in the order of the vector."""
    for index, applied in enumerate(effects):
        for parameter in applied.effect.parameters:
            if parameter.name not in FIXED:
                yield (
                    index,
                    parameter,
                    np.atleast_1d(applied.parameters[parameter.name]).ravel(),
                )


def vector(effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    """The values, SI units, shape (P,)."""
    return np.concatenate([np.zeros(0), *(values for _, _, values in free(effects))])


def scales(effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    """Size of each value, for steps and for conditioning, same units, shape (P,)."""
    parts = [np.zeros(0)]
    for _, parameter, values in free(effects):
        largest = max(abs(value) for value in parameter.typical)
        parts.append(np.maximum(np.abs(values), MIN_PARAMETER_SCALE * largest))
    return np.concatenate(parts)


def bounds(effects: tuple[AppliedEffect, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds, each of shape (P,)."""
    low, high = [np.zeros(0)], [np.zeros(0)]
    for _, parameter, values in free(effects):
        least, most = parameter.bounds
        low.append(np.full(len(values), least))
        high.append(np.full(len(values), most))
    far = FARTHEST * scales(effects)
    return np.maximum(np.concatenate(low), -far), np.minimum(np.concatenate(high), far)


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
        values, scale = vector(self.effects), scales(self.effects)
        _, highest = bounds(self.effects)
        out = np.zeros((*here.shape, len(values)))
        for k in range(len(values)):
            # a value at its upper bound can only go down
            step = STEP if values[k] + STEP * scale[k] <= highest[k] else -STEP
            changed = values.copy()
            changed[k] += step * scale[k]
            effects = with_values(self.effects, changed)
            moved = Hypothesis(self.words, self.arm, effects)
            out[:, :, k] = (moved.predict(body, motion) - here) / step
        return out

    @property
    def lasting(self) -> np.ndarray:
        """Which of the parameters act on another recording too, bool, (P,)."""
        parts = [np.zeros(0, dtype=bool)]
        for index, _, values in free(self.effects):
            lasts = not isinstance(self.effects[index].effect, External)
            parts.append(np.full(len(values), lasts))
        return np.concatenate(parts)

    def elsewhere(self) -> Hypothesis:
        """The hypothesis on another recording: an external force does not come again."""
        lasting = tuple(e for e in self.effects if not isinstance(e.effect, External))
        return Hypothesis(self.words, self.arm, lasting)


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
    effects, scale = hypothesis.effects, scales(hypothesis.effects)
    if not len(scale):
        return hypothesis, float(np.mean(present.residual(hypothesis) ** 2))

    def at(x: np.ndarray) -> Hypothesis:
        return Hypothesis(
            hypothesis.words, hypothesis.arm, with_values(effects, x * scale)
        )

    def slope(x: np.ndarray) -> np.ndarray:
        here = at(x)
        return present.jacobian(here) * (scale / scales(here.effects))

    low, high = (bound / scale for bound in bounds(effects))
    # least_squares wants a start strictly inside the bounds
    margin = 1e-6 * np.minimum(high - low, 1.0)
    start = np.clip(vector(effects) / scale, low + margin, high - margin)
    done = least_squares(
        lambda x: present.residual(at(x)), start, slope, (low, high), max_nfev=FIT_STEPS
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
        effects = (*hypothesis.effects, drawn)
        started = Hypothesis(hypothesis.words, hypothesis.arm, effects)
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
