"""Evaluation: measures by hand, what a better model gives, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.agents.evaluation import (
    EvaluationPlan,
    TrackingBench,
    evaluate,
    relation,
    summarise,
)
from gapscope.agents.models import (
    AgentModel,
    ArmModel,
    Gravity,
    named,
    read_model,
    read_models,
)
from gapscope.agents.tracking import TrackingMetrics, TrackingRun, Tuning
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm

HIDDEN = (
    AppliedEffect(
        "payload", (), {"mass": np.array(2.0), "com": np.array([0.4, 0.0, 0.0])}
    ),
    AppliedEffect("viscous_friction", (1, 2), {"coefficient": [4.0, 3.0]}),
)
SHORT = EvaluationPlan(("fourier",), ("none", "push"), (0, 1), ("pybullet",), 2.0)


def test_measures_by_hand(pendulum: NominalArm) -> None:
    """An error of 0.01 rad halves the tracking reward; 1 m from the base it is 10 mm, but the tool is the link's."""
    arm = replace(pendulum, torque_limit=np.array([10.0]))
    body = RigidBody(arm)
    t = np.arange(1000) * 1e-3
    tau = np.linspace(0.0, 5.0, 1000)[:, None]
    measured = TrackingMetrics(arm, body, workspace(body))(
        TrackingRun(t, np.zeros((1000, 1)), np.full((1000, 1), 0.01), tau, False),
        1e-3,
        1.0,
    )
    assert measured["joint_error"] == pytest.approx(0.01)
    assert measured["torque_rate"] == pytest.approx(5.0 * 1000 / 999)
    load, jump = np.mean((tau / 10) ** 2), 20 * 5 / 999 / 10
    assert measured["reward"] == pytest.approx(
        49 / 50 * (0.5 - 0.1 * load - 0.05 * jump**2), abs=3e-3
    )


def test_a_better_model_tracks_better(two: NominalArm) -> None:
    bench = TrackingBench(two, HIDDEN, SHORT)
    models = {
        "pd": None,
        "gravity": Gravity(two),
        "nominal": ArmModel(CorrectedArm(two)),
        "truth": ArmModel(CorrectedArm(two, HIDDEN)),
    }
    said = []
    episodes, margins = evaluate(models, bench, said.append)
    every = summarise(episodes, margins)
    assert [line["disturbance"] for line in every] == ["none"] * 4 + ["push"] * 4
    lines = {line["model"]: line for line in every[:4]}
    assert list(lines) == list(models) and len(episodes) == 16 and len(said) == 12
    errors = [lines[name]["joint_error"]["value"] for name in models]
    assert errors[3] < 0.2 * errors[2] < 0.2 * errors[0]
    assert (
        lines["truth"]["torque_error"]["value"] == pytest.approx(0.0)
        and lines["pd"]["torque_error"]["value"] > 0.5
    )
    assert lines["truth"]["reward"]["value"] > lines["nominal"]["reward"]["value"]
    pushed = [
        e["joint_error"]
        for e in episodes
        if e["model"] == "truth" and e["disturbance"] == "push"
    ]
    calm = [
        e["joint_error"]
        for e in episodes
        if e["model"] == "truth" and e["disturbance"] == "none"
    ]
    assert min(pushed) > max(calm)
    correlation = relation(every)
    assert correlation is not None and correlation > 0.7
    (margin,) = {line["margin"] for line in lines.values()}
    assert margin > 4.0  # one loop
    assert not any(line["diverged"]["count"] for line in lines.values())
    again, _ = evaluate(
        {"nominal": models["nominal"]}, TrackingBench(two, HIDDEN, SHORT)
    )
    assert again == [e for e in episodes if e["model"] == "nominal"]


def test_an_arm_that_runs_away_counts_as_diverged(two: NominalArm) -> None:
    free = replace(two, torque_limit=np.full(2, 1e6))
    delay = AppliedEffect("actuator_delay", (1, 2), {"delay": [0.03, 0.03]})
    bench = TrackingBench(
        free, (delay,), replace(SHORT, tuning=Tuning(40.0), disturbances=("none",))
    )
    episodes = [
        e for seed in (0, 1) for e in bench.episodes("pd", None, "pybullet", seed)
    ]
    assert all(e["diverged"] and e["joint_error"] == np.inf for e in episodes)


def test_computed_torque_needs_a_model_with_inertia(two: NominalArm) -> None:
    bench = TrackingBench(two, (), replace(SHORT, law="computed"))
    for model in (None, Gravity(two)):
        with pytest.raises(InputError, match="inertia"):
            evaluate({"x": model}, bench)


@pytest.mark.parametrize(
    "bad",
    [
        {"motions": ()},
        {"law": "fuzzy"},
        {"disturbances": ("wind",)},
        {"engines": ("unity",)},
        {"duration": 0.0},
        {"seeds": (-1,)},
        {"seeds": (0, 1.5)},
        {"seeds": ("a",)},
    ],
)
def test_bad_plans_are_refused(bad: dict) -> None:
    with pytest.raises(InputError):
        replace(SHORT, **bad)


def test_straight_lines_need_three_joints_and_a_push_no_other_force(
    two: NominalArm,
) -> None:
    with pytest.raises(InputError, match="three joints"):
        TrackingBench(two, (), replace(SHORT, motions=("pick",)))
    values = {"force": np.ones(3), "start": np.array(0.0), "end": np.array(1.0)}
    with pytest.raises(InputError, match="external force"):
        TrackingBench(two, (AppliedEffect("external_force", (), values),), SHORT)


def test_names_of_models() -> None:
    assert named("pd") == ("pd", "pd") and named("mine=a/b.yaml") == (
        "mine",
        "a/b.yaml",
    )
    assert (
        named("out/arm_7/corrected.yaml")[0] == "arm_7"
        and named("out/stiff.yaml")[0] == "stiff"
    )


def _no_agent(folder: Path, arm: NominalArm) -> AgentModel:
    raise AssertionError(f"{folder} is no agent's")


def test_models_of_files(two: NominalArm, tmp_path: Path) -> None:
    text = "schema: 1\neffects:\n  - {effect: viscous_friction, joints: [2], parameters: {coefficient: [3.0]}}\n"
    (tmp_path / "found.yaml").write_text(text)
    entries = ["pd", "gravity", "nominal", str(tmp_path / "found.yaml")]
    models = read_models(entries, two, _no_agent)
    assert (
        list(models) == ["pd", "gravity", "nominal", "found"] and models["pd"] is None
    )
    fast = (np.zeros(2), np.ones(2), np.zeros(2))
    nominal, found = models["nominal"], models["found"]
    assert nominal is not None and found is not None
    np.testing.assert_allclose(found(*fast) - nominal(*fast), [0.0, 3.0], atol=1e-9)
    with pytest.raises(InputError, match="two models"):
        read_models(["pd", "pd"], two, _no_agent)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("none.yaml", None, "no such file"),
        ("none.json", None, "no such file"),
        ("bad.json", "{", "not valid JSON"),
        ("bare.json", "{}", "names no files"),
        (
            "far.yaml",
            "schema: 1\neffects:\n  - {effect: coulomb_friction, joints: [7], parameters: {torque: [1]}}\n",
            "7",
        ),
        ("odd.txt", "", "unknown model"),
    ],
)
def test_bad_files_are_refused(
    two: NominalArm, tmp_path: Path, name: str, text: str | None, message: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_model(str(tmp_path / name), two)
