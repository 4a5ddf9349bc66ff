"""Positions and commands only: the torque that a known controller must have commanded, and a diagnosis from it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import synthetic
from cases import each
from sweeps import daily

from gapscope.arm.case import Case, load_case
from gapscope.arm.control import LAWS
from gapscope.arm.errors import GapscopeError
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.gap.commanded_torque import (
    commanded_torques,
    with_commanded_torque,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.recorder import Plan, record_case

COULOMB = AppliedEffect("coulomb_friction", (2,), {"torque": [2.0]})


@cache
def case() -> Case:
    """Three simulated recordings of an arm with more friction, without noise on the torque."""
    plan = Plan(recordings=3, duration=6.0, noise=0.0)
    limited = replace(synthetic.arm(), torque_limit=np.array([200.0, 200.0, 200.0]))
    return record_case("commanded", limited, (COULOMB,), plan, np.random.default_rng(1))


def without(case: Case, *channels: str) -> Case:
    """The case without some channels of its recordings."""
    nothing = dict.fromkeys(channels)
    return each(case, lambda r: replace(r, **nothing))


@pytest.mark.parametrize(
    ("channels", "close"),
    [(("tau",), 1e-3), (("tau", "dq"), 0.02)],
    ids=["dq", "no dq"],
)
def test_it_is_the_torque_that_was_commanded(
    channels: tuple[str, ...], close: float
) -> None:
    controller = case().controller
    assert controller is not None
    for told, bare in zip(
        case().recordings, without(case(), *channels).recordings, strict=True
    ):
        assert told.tau is not None
        torque = commanded_torques(case().arm, controller, [bare])[0]
        inner = slice(75, -75)
        error = np.sqrt(((torque - told.tau)[inner] ** 2).mean(axis=0))
        assert (error < close * told.tau.std(axis=0)).all()


PAYLOAD = AppliedEffect("payload", (), {"mass": 1.5, "com": [0.0, 0.0, 0.1]})


@pytest.mark.parametrize(
    "effects",
    daily(((), (COULOMB, PAYLOAD)), (COULOMB, PAYLOAD)),
    ids=["healthy", "both"],
)
@pytest.mark.parametrize("kind", [kind for kind in LAWS if kind != "pd"])
def test_other_laws_commanded_it_too(
    kind: str, effects: tuple[AppliedEffect, ...]
) -> None:
    """What an integrator held when the recordings began is found, whatever load there is."""
    made = record_case(
        kind,
        synthetic.arm(),
        effects,
        Plan(recordings=2, duration=6.0, noise=0.0),
        np.random.default_rng(2),
        controller=kind,
    )
    controller = made.controller
    assert controller is not None and controller.kind == kind
    bare = without(made, "tau").recordings
    torques = commanded_torques(made.arm, controller, bare)
    for torque, recording in zip(torques, made.recordings, strict=True):
        assert recording.tau is not None
        error = (torque - recording.tau)[75:-75]
        spread = recording.tau.std(axis=0)
        scale = np.maximum(spread, 0.05 * spread.max())
        assert (error.std(axis=0) < 3e-3 * scale).all()
        # two causes at once are none of the choices from which a constant is told
        assert (np.abs(error.mean(axis=0)) < (0.15 if effects else 0.03) * scale).all()


def test_it_is_clipped_at_the_limit() -> None:
    controller = case().controller
    assert controller is not None
    limited = replace(case().arm, torque_limit=np.array([1.0, 5.0, 2.0]))
    torque = commanded_torques(limited, controller, case().recordings[-1:])[0]
    assert np.abs(torque).max(axis=0) == pytest.approx([1.0, 5.0, 2.0])


def test_an_effect_is_found_without_the_torque() -> None:
    bare = diagnose(without(case(), "tau")).document
    validate(bare)
    (effect,) = bare["effects"]
    assert (effect["effect"], effect["joints"]) == ("coulomb_friction", [2])
    assert effect["parameters"]["torque"]["value"] == pytest.approx([2.0], rel=0.05)
    assert bare["torque_from"] == "controller"
    assert bare["judged_on"].endswith(
        "the torque there is the one that the controller must have commanded"
    )
    assert any(
        "must have commanded" in warning and "gains" in warning
        for warning in bare["warnings"]
    )
    before, after = (
        np.array(bare["gap"][stage]["replay_rmse"]) for stage in ("before", "after")
    )
    assert after[1] < 0.5 * before[1]


def test_recorded_torque_is_never_replaced() -> None:
    first, *rest = case().recordings
    mixed = replace(case(), recordings=(first, *without(case(), "tau").recordings[1:]))
    assert with_commanded_torque(case()) is case()
    assert with_commanded_torque(mixed) is mixed and rest


@pytest.mark.parametrize("unknown", ["controller", "reference"])
def test_without_controller_or_reference_the_error_says_what_to_do(
    unknown: str,
) -> None:
    bare = (
        without(case(), "tau")
        if unknown == "controller"
        else without(case(), "tau", "q_ref")
    )
    bare = replace(bare, controller=None) if unknown == "controller" else bare
    with pytest.raises(GapscopeError, match="no recording carries a torque") as caught:
        diagnose(bare)
    assert "q_ref1" in str(caught.value) and "controller:" in str(caught.value)


def test_a_gap_in_time_is_not_bridged() -> None:
    controller = case().controller
    assert controller is not None
    whole = case().recordings[0]
    kept = (whole.t < 2.5) | (whole.t > 3.0)
    cut = replace(
        whole,
        t=whole.t[kept],
        q=whole.q[kept],
        tau=None,
        dq=None,
        q_ref=whole.q_ref[kept],
        dq_ref=whole.dq_ref[kept],
    )
    assert whole.tau is not None
    torque = commanded_torques(case().arm, controller, [cut])[0]
    late = cut.t > 3.4
    assert (
        np.abs(torque - whole.tau[kept])[late].max() < 0.2 * whole.tau.std(axis=0).max()
    )


@pytest.mark.slow
@pytest.mark.shared_data
@pytest.mark.nightly
def test_a_sample_case_without_its_torque(sample_cases: Path) -> None:
    """Delays of case005 on all joints, by another simulator, from positions and references alone."""
    document = diagnose(without(load_case(sample_cases / "case005"), "tau")).document
    assert [(e["effect"], e["joints"]) for e in document["effects"]] == [
        ("actuator_delay", [1, 2, 3, 4, 5, 6])
    ]
