"""Simulators made from models: there the model's own feedforward leaves hardly an error."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import case_of, limits

from gapscope.agents.models import ArmModel
from gapscope.agents.training.task import Task, idle, judge
from gapscope.arm.io.write_case import write_case
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, motion_of
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect, carried
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import write_corrected
from gapscope.effects.residual import (
    Inputs,
    Layout,
    Network,
    ResidualNetwork,
    Trust,
    write_residual,
)
from gapscope.envs.effect_ranges import EffectRanges, effect_range
from gapscope.envs.environment import VectorArmTracking
from gapscope.envs.mystery_arm import HIDDEN

from .conftest import short

EFFECTS = (
    carried(0.5, (0.4, 0.0, 0.0)),
    AppliedEffect("viscous_friction", (1,), {"coefficient": [1.5]}),
)


def network() -> ResidualNetwork:
    """2 N m times tanh(dq / (0.5 rad/s)), whatever else is seen."""
    c, near = Layout(1).channels, len(Layout(1).neighbourhood)
    inputs = Inputs(1, 2, 0.02, np.zeros((1, c)), np.ones((1, c)))
    first = np.zeros((1, 1, len(inputs.seen_by_mlp), 1))
    head = np.zeros((1, 1, 1, 2))
    first[0, 0, list(inputs.seen_by_mlp).index(c), 0], head[0, 0, 0, 0] = 2.0, 1.0
    biases = (np.zeros((1, 1, 1)), np.zeros((1, 1, 2)))
    net = Network("mlp", inputs.seen_by_mlp, (first, head), biases)
    trust, which = Trust(np.zeros((1, 1, near)), np.full(1, 1e3)), np.zeros(1, int)
    size, bound = np.full(1, 2.0), np.full(1, 9.0)
    return ResidualNetwork(inputs, (net,), which, trust, size, bound, 12.0)


@pytest.fixture
def files(arm: NominalArm, tmp_path: Path) -> dict[str, str]:
    """Models by name, as the user would give them."""
    write_corrected("rod", EFFECTS, tmp_path / "corrected.yaml")
    write_residual(network(), tmp_path / "residual.npz")
    write_corrected("rod", EFFECTS, tmp_path / "with_network.yaml", "residual.npz")
    identified = replace(arm, armature=np.array([0.7]), viscous=np.array([0.8]))
    still = Recording("still", 0.01 * np.arange(10), *np.zeros((2, 10, 1)))
    folder = tmp_path / "identified"
    write_case(case_of("rod", identified, still), folder)
    names = {"case": "case.yaml", "effects": "effects.yaml"}
    (folder / "identification.json").write_text(json.dumps({"files": names}))
    write_corrected("rod", EFFECTS, folder / "effects.yaml")
    return {
        "nominal": "nominal",
        "corrected": str(tmp_path / "corrected.yaml"),
        "network": str(tmp_path / "with_network.yaml"),
        "identified": str(folder / "identification.json"),
    }


def motion() -> tuple[Fourier, Motion]:
    how = {"duration": 1.0, "frequency": 0.5, "ramp": 0.3}
    allowed = limits(1, 1.0, 1.5, 6.0)
    reference = Fourier.random(np.random.default_rng(1), allowed, **how)
    return reference, motion_of(reference, 1e-3 * np.arange(1251))


@pytest.mark.parametrize("name", ["nominal", "corrected", "network", "identified"])
def test_simulator_follows_the_models_inverse_dynamics(
    name: str, files: dict[str, str], arm: NominalArm
) -> None:
    reference, seen = motion()
    task, settings = Task.of(files[name], arm), short()
    with_other = Task.of("nominal", arm).simulator(settings)
    env = task.simulator(settings)
    # gains are equal over models
    np.testing.assert_array_equal(env.torque_scale, with_other.torque_scale)
    with_other.close()
    env.reset(seed=0, options={"motion": reference})
    expected = ArmModel(task.believed).series(seen)[:1001:20] / env.setup.control.rated
    planned = env.unwrapped._course.planned[:-1, -1:]
    np.testing.assert_allclose(planned, expected, atol=1e-9)
    env.close()
    alone = task.trials(settings, 1)
    assert judge(alone, idle(alone), [("own", reference)])["joint_error"] < 4e-4


def test_the_network_acts_in_the_simulator(
    files: dict[str, str], arm: NominalArm
) -> None:
    """The arm has the network's torque; feedforward with the network tracks it, feedforward without does not."""
    reference, _ = motion()
    true = Task.of(files["network"], arm)
    errors = []
    for name in ("network", "corrected"):
        env = VectorArmTracking(
            1,
            arm,
            simulated=true.believed,
            feedforward=ArmModel(Task.of(files[name], arm).believed),
            episode_length=short().episode_length,
            engine=short().engine,
        )
        errors.append(judge(env, idle(env), [("own", reference)])["joint_error"])
    assert errors[0] < 0.1 * errors[1]


def test_what_is_unknown_is_drawn_around_a_model(
    files: dict[str, str], arm: NominalArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Effects of the catalogue around the nominal arm; around a diagnosed one what its diagnosis leaves open."""
    open_ = short(randomise=None)
    assert Task.of("nominal", arm).settled(open_).randomise == HIDDEN
    assert Task.of("pd", arm).settled(open_).randomise == ()
    assert Task.of(files["corrected"], arm).settled(open_).randomise == HIDDEN

    def intervals(file: Path, found: CorrectedArm, units: tuple) -> EffectRanges:
        deviations = [
            {n: 0.1 * abs(v) for n, v in e.parameters.items()} for e in EFFECTS
        ]
        each = zip(found.effects, deviations, strict=True)
        return EffectRanges(tuple(effect_range(*pair) for pair in each))

    monkeypatch.setattr("gapscope.agents.training.task.read_ranges", intervals)
    diagnosed = Task.of(files["corrected"], arm)
    settings = diagnosed.settled(open_)
    assert settings.randomise == () and diagnosed.ranges is not None
    env = diagnosed.simulator(settings)
    drawn = []
    for seed in (0, 1):
        env.reset(seed=seed)
        drawn.append({e.name: e for e in env.unwrapped.effects})
    names = [{e.name for e in EFFECTS}] * 2
    assert [set(effects) for effects in drawn] == names
    masses = [float(e["payload"].parameters["mass"]) for e in drawn]
    assert masses[0] != masses[1] and np.allclose(masses, 0.5, rtol=0.2)
    env.close()
