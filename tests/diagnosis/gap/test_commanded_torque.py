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
    controller, bare = case().controller, without(case(), *channels).recordings
    assert controller is not None
    found = commanded_torques(case().arm, controller, bare)
    for told, torque in zip(case().recordings, found, strict=True):
        assert told.tau is not None
        error = np.sqrt(((torque - told.tau)[75:-75] ** 2).mean(axis=0))
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
    plan, rng = Plan(recordings=2, duration=6.0, noise=0.0), np.random.default_rng(2)
    made = record_case(kind, synthetic.arm(), effects, plan, rng, controller=kind)
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
    said = "the torque there is the one that the controller must have commanded"
    assert bare["judged_on"].endswith(said)
    (warning,) = (w for w in bare["warnings"] if "must have commanded" in w)
    assert "gains" in warning
    before, after = (bare["gap"][stage]["replay_rmse"] for stage in ("before", "after"))
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
    silent = without(case(), "tau")
    less = {"controller": replace(silent, controller=None)}
    bare = less.get(unknown) or without(silent, "q_ref")
    with pytest.raises(GapscopeError, match="no recording carries a torque") as caught:
        diagnose(bare)
    assert "q_ref1" in str(caught.value) and "controller:" in str(caught.value)


def test_a_gap_in_time_is_not_bridged() -> None:
    controller = case().controller
    assert controller is not None
    whole = case().recordings[0]
    kept = (whole.t < 2.5) | (whole.t > 3.0)
    cut = replace(whole.part(kept), tau=None, dq=None)
    assert whole.tau is not None
    torque = commanded_torques(case().arm, controller, [cut])[0]
    error = (torque - whole.tau[kept])[cut.t > 3.4]
    assert np.abs(error).max() < 0.2 * whole.tau.std(axis=0).max()


@pytest.mark.slow
@pytest.mark.shared_data
@pytest.mark.nightly
def test_a_sample_case_without_its_torque(sample_cases: Path) -> None:
    """Delays of case005 on all joints, by another simulator, from positions and references alone."""
    document = diagnose(without(load_case(sample_cases / "case005"), "tau")).document
    assert [(e["effect"], e["joints"]) for e in document["effects"]] == [
        ("actuator_delay", [1, 2, 3, 4, 5, 6])
    ]
