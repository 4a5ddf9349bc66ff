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
    ArmModel,
    Gravity,
    named,
    read_models,
)
from gapscope.agents.tracking import TrackingMetrics, TrackingRun, Tuning
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, carried
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import write_corrected

HIDDEN = (
    carried(2.0, (0.4, 0.0, 0.0)),
    AppliedEffect("viscous_friction", (1, 2), {"coefficient": [4.0, 3.0]}),
)
SHORT = EvaluationPlan(("fourier",), ("none", "push"), (0, 1), ("pybullet",), 1.0)
FIRST = ("pybullet", 0)


def test_measures_by_hand(pendulum: NominalArm) -> None:
    """An error of 0.01 rad halves the tracking reward; 1 m from the base it is 10 mm, but the tool is the link's."""
    arm = replace(pendulum, torque_limit=np.array([10.0]))
    body = RigidBody(arm)
    t = np.arange(1000) * 1e-3
    tau = np.linspace(0.0, 5.0, 1000)[:, None]
    run = TrackingRun(t, 0 * tau, 0 * tau + 0.01, tau, False)
    measured = TrackingMetrics(arm, body, workspace(body))(run, 1e-3, 1.0)
    assert measured["joint_error"] == pytest.approx(0.01)
    assert measured["torque_rate"] == pytest.approx(5.0 * 1000 / 999)
    load, jump = np.mean((tau / 10) ** 2), 20 * 5 / 999 / 10
    reward = 49 / 50 * (0.5 - 0.1 * load - 0.05 * jump**2)
    assert measured["reward"] == pytest.approx(reward, abs=3e-3)


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
    assert lines["truth"]["torque_error"]["value"] == pytest.approx(0.0)
    assert lines["pd"]["torque_error"]["value"] > 0.5
    assert lines["truth"]["reward"]["value"] > lines["nominal"]["reward"]["value"]
    truth = [e for e in episodes if e["model"] == "truth"]
    pushed, calm = (
        [e["joint_error"] for e in truth if e["disturbance"] == disturbance]
        for disturbance in ("push", "none")
    )
    assert min(pushed) > max(calm)
    correlation = relation(every)
    assert correlation is not None and correlation > 0.7
    # one loop
    (margin,) = {line["margin"] for line in lines.values()}
    assert margin > 4.0
    assert not any(line["diverged"]["count"] for line in lines.values())
    # seeds alone decide what is drawn
    again = TrackingBench(two, HIDDEN, SHORT).episodes("truth", models["truth"], *FIRST)
    assert again == [e for e in truth if e["seed"] == 0]


def test_an_arm_that_runs_away_counts_as_diverged(two: NominalArm) -> None:
    free = replace(two, torque_limit=np.full(2, 1e6))
    delay = AppliedEffect("actuator_delay", (1, 2), {"delay": [0.03, 0.03]})
    plan = replace(SHORT, tuning=Tuning(40.0), disturbances=("none",))
    (episode,) = TrackingBench(free, (delay,), plan).episodes("pd", None, *FIRST)
    assert episode["diverged"] and episode["joint_error"] == np.inf


@pytest.mark.parametrize(
    "bad", [{"motions": ()}, {"duration": 0.0}, {"seeds": (-1,)}, {"seeds": (0, 1.5)}]
)
def test_bad_plans_are_refused(bad: dict) -> None:
    with pytest.raises(InputError):
        replace(SHORT, **bad)


def test_models_of_files_are_called_after_their_folder(
    two: NominalArm, tmp_path: Path
) -> None:
    assert named("pd") == ("pd", "pd") and named("a=b/c.yaml") == ("a", "b/c.yaml")
    assert named("out/stiff.yaml")[0] == "stiff"
    friction = AppliedEffect("viscous_friction", (2,), {"coefficient": [3.0]})
    file = tmp_path / "arm_7" / "corrected.yaml"
    write_corrected("two", (friction,), file)
    models = read_models(["pd", "gravity", "nominal", str(file)], two, pytest.fail)
    assert list(models) == ["pd", "gravity", "nominal", "arm_7"]
    assert models["pd"] is None
    fast = (np.zeros(2), np.ones(2), np.zeros(2))
    nominal, found = models["nominal"], models["arm_7"]
    assert nominal is not None and found is not None
    np.testing.assert_allclose(found(*fast) - nominal(*fast), [0.0, 3.0], atol=1e-9)
