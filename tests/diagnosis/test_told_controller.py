"""Positions and references alone: gains told by the weight of the arm, and effects beside them."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import synthetic
from cases import each
from sweeps import nightly

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.arm.errors import GapscopeError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.told_controller import with_told_controller
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.recorder import Plan, record_case

COULOMB = AppliedEffect("coulomb_friction", (2,), {"torque": [4.0]})


@cache
def recorded(feedforward: str, rubs: bool = False, count: int = 2) -> Case:
    """Simulated recordings under PD, of an arm with more friction or without."""
    plan, rng = Plan(recordings=count, duration=8.0), np.random.default_rng(1)
    effects = (COULOMB,) if rubs else ()
    first = record_case("told", synthetic.arm(), (), replace(plan, recordings=1), rng)
    assert isinstance(first.controller, PD)
    controller = replace(first.controller, feedforward=feedforward)
    return record_case(
        "told", synthetic.arm(), effects, plan, rng, controller=controller
    )


def bare(case: Case) -> Case:
    """The same without torque and controller."""
    return replace(each(case, lambda r: replace(r, tau=None)), controller=None)


@pytest.fixture(scope="module")
def rubbing() -> dict[str, Any]:
    """The diagnosis of an arm with more friction, without feedforward."""
    return dict(gapscope.diagnose(bare(recorded("none", rubs=True))).document)


def test_gains_are_told_with_intervals_and_an_effect_beside_them(
    rubbing: dict[str, Any],
) -> None:
    validate(rubbing)
    told, true = rubbing["controller"], recorded("none", rubs=True).controller
    assert isinstance(true, PD)
    assert (told["kind"], told["feedforward"], told["not_told"]) == ("pd", "none", [])
    assert told["follows_velocity"] and told["delay"] < 0.01
    for name in ("kp", "kd"):
        low, high = np.transpose(told[name]["interval"])
        assert (low < told[name]["value"]).all() and (told[name]["value"] < high).all()
        assert (high < 2.5 * low).all()
        if name == "kp":
            assert (low < true.kp).all() and (true.kp < high).all()
    effect = rubbing["effects"][0]
    assert (effect["effect"], effect["joints"]) == ("coulomb_friction", [2])
    assert effect["parameters"]["torque"]["value"] == pytest.approx([4.0], rel=0.15)
    assert rubbing["torque_from"] == "controller"
    # the line to paste
    assert told["declare"].startswith("controller: {kind: pd, rate: 1000, kp: [")
    text = " ".join(map(str, rubbing["warnings"]))
    assert told["declare"] in text and "relative to these masses" in text


def test_identify_takes_the_same_gains() -> None:
    found = gapscope.identify(bare(recorded("none", rubs=True))).identification
    (said,) = (w for w in found.case.warnings if "neither torque" in w)
    assert "controller: {kind: pd" in said


def test_gravity_that_is_fed_forward_is_named() -> None:
    document = gapscope.diagnose(bare(recorded("gravity"))).document
    assert document["controller"]["feedforward"] == "gravity"
    assert document["effects"] == []


def test_beside_inverse_dynamics_nothing_is_told() -> None:
    with pytest.raises(GapscopeError, match="nor do the references tell the gains"):
        gapscope.diagnose(bare(recorded("nominal")))


@pytest.mark.parametrize(
    ("at_work", "declared"), [("gravity", "none"), nightly("none", "nominal")]
)
def test_a_feedforward_that_is_declared_wrongly_is_named(
    at_work: str, declared: str
) -> None:
    case = recorded(at_work)
    assert isinstance(case.controller, PD)
    wrong = replace(case, controller=replace(case.controller, feedforward=declared))
    document = gapscope.diagnose(wrong).document
    line = f"controller: {{feedforward: {at_work}}}"
    assert sum(line in str(warning) for warning in document["warnings"]) == 1
    assert document["effects"] == [] and document["verdict"] == "no_gap"


def test_commands_that_act_late_are_named() -> None:
    case = recorded("gravity", count=3)

    def ahead(r: Recording) -> Recording:
        assert r.q_ref is not None and r.dq_ref is not None
        series = (np.roll(x, -15, axis=0) for x in (r.q_ref, r.dq_ref))
        q_ref, dq_ref = (np.vstack([x[:-15], x[-16:-15].repeat(15, 0)]) for x in series)
        return replace(r, q_ref=q_ref, dq_ref=dq_ref)

    early = each(case, ahead)
    warnings = gapscope.diagnose(early).document["warnings"]
    assert any("reference: {lead: 0.06" in str(warning) for warning in warnings)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_joints_that_rest_have_no_gains_and_an_arm_that_does_is_refused() -> None:
    case = bare(recorded("none"))

    def resting(*joints: int) -> Case:
        def one(r: Recording) -> Recording:
            assert r.q_ref is not None and r.dq_ref is not None
            q, q_ref, dq_ref = (np.array(x) for x in (r.q, r.q_ref, r.dq_ref))
            q[:, joints], q_ref[:, joints], dq_ref[:, joints] = 0.3, 0.3, 0.0
            return replace(r, q=q, dq=None, q_ref=q_ref, dq_ref=dq_ref)

        return each(case, one)

    _, told = with_told_controller(resting(2))
    assert told is not None
    (kp,) = re.findall(r"kp: \[(.*?)\]", told.lines())
    assert [0 < float(x) < 1e6 for x in kp.split(", ")] == [True, True, False]
    with pytest.raises(GapscopeError, match="the arm stands still"):
        gapscope.diagnose(resting(0, 1, 2))
