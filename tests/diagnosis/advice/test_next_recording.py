"""The next recording: it separates what the present ones do not, within limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import synthetic
import yaml
from cases import case_of, each

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.trajectory import Fourier
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.next_recording import (
    Advice,
    AdviceRequest,
    MotionOption,
    Question,
    advise,
    lines,
    open_questions,
    options,
)
from gapscope.diagnosis.thresholds import DESIGNED_ALTERNATIVES
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.excitation.design import LimitPlan
from gapscope.model.expected import ExpectedEvidence

LIMITS = LimitPlan(velocity=1.6, acceleration=7.0, singular=0.0, collisions=False)
DELAY = AppliedEffect("actuator_delay", (3,), {"delay": [0.012]})
COULOMB = AppliedEffect("coulomb_friction", (2,), {"torque": [2.0]})


def case_of_two(
    name: str, truth: synthetic.Truth, motions: Sequence[Fourier], seed: int
) -> Case:
    """Two recordings of an arm."""
    rng = np.random.default_rng(seed)
    made = (
        synthetic.recording(truth, moved, rng, f"{name}_{k}.csv")
        for k, moved in enumerate(motions)
    )
    return case_of(name, synthetic.arm(), *made)


def slow_case(truth: synthetic.Truth, seed: int = 1, first: int = 0) -> Case:
    """Two slow motions."""
    frequencies = enumerate((0.04, 0.05), first)
    moved = [synthetic.motion(k, frequency, 20.0) for k, frequency in frequencies]
    return case_of_two("slow", truth, moved, seed)


def case_at_one_load(truth: synthetic.Truth) -> Case:
    """Small motions about one posture: the load hardly changes."""
    wide = (synthetic.motion(k, 0.2, 10.0) for k in (20, 21))
    small = [replace(m, sine=0.15 * m.sine, cosine=0.15 * m.cosine) for m in wide]
    return case_of_two("small", truth, small, 2)


def document(effect: AppliedEffect, rival: str, **more: Any) -> dict[str, Any]:
    """As much of a diagnosis as advice reads."""
    place = {"joints": list(effect.joints)}
    other = {"effect": rival, "probability": 0.4, "separated_by": "another motion"}
    values = {
        key: {"value": value.tolist()} for key, value in effect.parameters.items()
    }
    entry = {"effect": effect.name, "parameters": values, **place}
    return {
        "verdict": "effects_found",
        "effects": [entry | {"alternatives": [other | place]}],
        "unexplained": {"share": 0.0, "above_floor": False, "where": []},
        "next_recording": None,
        **more,
    }


def advised(case: Case, effect: AppliedEffect, rival: str, **request: Any) -> Advice:
    asked = AdviceRequest(LIMITS, evaluations=30, seed=0, **request)
    return advise(case, document(effect, rival), (effect,), asked)


@pytest.mark.slow
@pytest.mark.nightly
def test_a_delay_on_slow_motions_leads_to_a_motion_that_tells_it_from_a_lag() -> None:
    """One of 6 ms: of 10 ms reversals of friction tell even here, of three delays and three lags every one rightly."""
    case = slow_case(synthetic.Truth(delay=(0.0, 0.0, 0.006)), seed=3, first=6)
    result = diagnose(case)
    [question] = open_questions(result.document)
    assert {question.effect, question.rival} == {"actuator_delay", "actuator_lag"}
    asked = AdviceRequest(LIMITS, evaluations=150, seed=0)
    advice = advise(case, result.document, result.effects, asked)
    [pair] = advice.pairs
    # odds of 50 to 1: what tells them apart grows with the fourth power of the delay
    assert pair.evidence > 4 and pair.joint == 3
    assert advice.option is not None and advice.option.speed in ("quick", "lively")
    text = "\n".join(lines(advice, result.document))
    assert "Still open: actuator delay (joint 3)" in text and "nats" in text


@cache
def rubbing() -> Case:
    return case_at_one_load(synthetic.Truth(coulomb=(0.0, 2.0, 0.0)))


def test_coulomb_at_one_load_leads_to_a_motion_over_many_loads_within_limits() -> None:
    """A payload is mounted only where it is worth it."""
    light = KnownLoad(0.2)
    advice = advised(rubbing(), COULOMB, "load_friction", payload=light, fastest=0.5)
    [pair] = advice.pairs
    # ten times as much if one predicts without its friction
    assert 50 < pair.evidence < 500 and pair.joint == 2
    assert advice.excitation is not None and advice.option is not None
    assert advice.option.payload is None
    assert {option.payload for option, _ in advice.tried} == {None, light}
    assert "not" in lines(advice, document(COULOMB, "load_friction"))[-1]
    # limits are kept at every sample
    assert all(margin.kept for margin in advice.excitation.margins)
    motion = advice.excitation.motion
    most = [np.abs(series).max() for series in (motion.q, motion.dq, motion.ddq)]
    assert (np.array(most) <= [2.4, 1.6, 7.0]).all()
    # no motion above 0.5 Hz was asked for
    assert advice.option.speed in ("slow", "moderate")


def test_a_payload_to_mount_is_told_as_lines_of_the_case() -> None:
    load = KnownLoad(2.0, (0.0, 0.0, 0.05))
    rival = "load_friction", (2,), 0.4, "this", "that"
    question = Question("coulomb_friction", (2,), 0, *rival)
    pairs, option = (ExpectedEvidence(0, 1, 30.0, 2),), MotionOption("slow", load)
    advice = Advice((question,), pairs=pairs, option=option)
    text = lines(advice, document(COULOMB, "load_friction"))
    section = yaml.safe_load("\n".join(text[-2:]))
    assert section == {"payloads": {"recording.csv": load.entry()}}
    assert "case.yaml" in text[-3]


def test_a_case_without_torque_is_advised_as_it_was_diagnosed() -> None:
    rng, plan = np.random.default_rng(1), Plan(recordings=2, duration=5.0)
    made = record_case("rubs", synthetic.arm(), (COULOMB,), plan, rng)
    silent = each(made, lambda r: replace(r, tau=None))
    advice = advised(silent, COULOMB, "load_friction", fastest=0.3)
    assert advice.pairs and advice.excitation is not None


def test_nothing_open_needs_nothing() -> None:
    case = slow_case(synthetic.Truth())
    calm = document(DELAY, "actuator_lag")
    calm["effects"][0]["alternatives"][0]["probability"] = 0.01
    advice = advise(case, calm, (DELAY,), AdviceRequest(LIMITS))
    assert advice == Advice(()) and "Nothing is open" in lines(advice, calm)[0]


def test_an_unexplained_gap_gets_a_general_motion() -> None:
    where = [{"joint": 2}, {"joint": 2}]
    left = {"share": 0.4, "above_floor": True, "where": where}
    odd = document(DELAY, "none", verdict="unexplained", unexplained=left, effects=[])
    asked = AdviceRequest(LIMITS, evaluations=60, seed=0)
    advice = advise(slow_case(synthetic.Truth()), odd, (), asked)
    assert advice.excitation is not None
    assert all(margin.kept for margin in advice.excitation.margins)
    said = "40 % of the gap is unexplained, most of it on joint 2"
    assert said in lines(advice, odd)[0]


def test_questions_are_few_and_of_physics() -> None:
    content = document(DELAY, "actuator_lag")
    rivals = ("actuator_lag", "torque_saturation", "sign_flip", "armature")
    content["effects"][0]["alternatives"] = [
        {"effect": name, "joints": [3], "probability": 0.4 - 0.01 * k}
        for k, name in enumerate((*rivals, "joint_elasticity", "torque_ripple"))
    ]
    asked = [question.rival for question in open_questions(content)]
    assert asked == ["actuator_lag", "armature", "joint_elasticity"]
    assert len(asked) == DESIGNED_ALTERNATIVES


def test_what_a_rival_can_follow_is_not_expected_to_be_told() -> None:
    """A little Coulomb friction is what a healthy arm's may be off by."""
    case = slow_case(synthetic.Truth(coulomb=(0.0, 0.1, 0.0)))
    little = AppliedEffect("coulomb_friction", (2,), {"torque": [0.1]})
    advice = advised(case, little, "none", fastest=0.5)
    assert advice.pairs[0].evidence < 1.0
    assert "hardly settle" in "\n".join(lines(advice, document(little, "none")))


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="payload"):
        KnownLoad(-1.0)
    with pytest.raises(InputError, match="as slow as"):
        options(None, 0.1)
    tight = LimitPlan(torque=0.0001, singular=0.0, collisions=False)
    case = slow_case(synthetic.Truth(delay=(0.0, 0.0, 0.012)))
    asked = AdviceRequest(tight, evaluations=150)
    with pytest.raises(InputError, match="gravity"):
        advise(case, document(DELAY, "actuator_lag"), (DELAY,), asked)
