"""The generator: that its laws act, and that severity is what was asked for."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from small_cases import CLEAN

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.check import BlindPlan, allocate_cases
from gapscope.blind_check.generator.case import (
    CaseSetup,
    draw_cause,
    draw_joints,
    draw_setup,
    make_case,
)
from gapscope.blind_check.generator.laws import BEYOND, INSIDE, LAWS, SETUP
from gapscope.blind_check.generator.rigid import inverse_dynamics
from gapscope.blind_check.generator.simulate import CaseSpec, simulate
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.setup_faults import FAULTS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def setup() -> CaseSetup:
    made = draw_setup(CLEAN, np.random.default_rng(3))
    assert made is not None
    return made


def test_laws_of_effects_have_the_names_and_units_of_the_catalogue() -> None:
    catalogued = {
        name: {key: effect.parameter(key).unit for key in effect.needed}
        for name, effect in CATALOGUE.items()
    }
    assert {name: LAWS[name].units for name in INSIDE} == catalogued
    # faults that came later are measured by experiments of their own: sealed sets are drawn from these
    assert set(SETUP) <= set(FAULTS)


@pytest.mark.parametrize(
    "name", [n for n in (*INSIDE, *BEYOND) if LAWS[n].measure == "torque"]
)
def test_a_law_changes_the_torque_and_the_label_is_whole(
    name: str, setup: CaseSetup
) -> None:
    rng = np.random.default_rng(5)
    joints = draw_joints(LAWS[name].joints, setup.arm.n, rng)
    assert joints is not None
    drawn = (LAWS[name].cause(rng, setup, joints) for _ in range(6))
    cause, added = next(
        (c, a) for c in drawn if (a := setup.signature((c,))) is not None
    )
    assert added is not None and added.max() > 0.05
    assert set(cause.label()["parameters"]) == set(LAWS[name].units)
    assert cause.sized(np.full(max(len(joints), 1), 1.0)).label() == cause.label()


def test_the_inverse_dynamics_is_that_of_the_arm_by_another_library(
    setup: CaseSetup, tmp_path: Path
) -> None:
    (tmp_path / "robot.urdf").write_text(setup.arm.urdf, encoding="utf-8")
    body = RigidBody(load_nominal_arm("robot.urdf", folder=tmp_path))
    q, dq, ddq = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 5, setup.arm.n))
    assert inverse_dynamics(setup.model, q, dq, ddq) == pytest.approx(
        body.inverse_dynamics(q, dq, ddq), rel=1e-6
    )


def test_a_single_effect_has_the_severity_that_was_drawn() -> None:
    spec = CaseSpec("single", ("torque_offset",), (5.0, 10.0), CLEAN)
    label = make_case(spec, (8,)).label
    assert 5.0 <= max(label["signature"]) <= 10.0
    assert label["ratio"] >= 3.0


def test_a_clamp_that_is_nothing_and_then_nearly_everything_gets_its_size(
    setup: CaseSetup,
) -> None:
    rng, law = np.random.default_rng(5), LAWS["torque_saturation"]
    drawn = [draw_cause(law, setup, (3.0, 5.0), rng) for _ in range(4)]
    made = [cause for cause in drawn if cause is not None]
    assert len(made) > 1
    for cause in made:
        ratios = setup.signature((cause,))
        assert ratios is not None and 3.0 <= ratios.max() <= 6.0


def test_a_healthy_arm_is_its_own_twin_and_the_same_for_the_same_seed() -> None:
    spec = CaseSpec("healthy", (), None, CLEAN)
    one, two, other = (make_case(spec, seed) for seed in ((2, 7), (2, 7), (2, 8)))
    assert one.label["ratio"] == 1.0
    assert max(one.label["floor"]) < 0.1
    np.testing.assert_array_equal(one.rows[0]["tau"], two.rows[0]["tau"])
    assert not np.array_equal(one.rows[0]["tau"], other.rows[0]["tau"])


def test_a_steered_arm_reads_its_encoders_one_tick_late(setup: CaseSetup) -> None:
    """What is steered by takes the place of the feedforward, and sees what was recorded at the tick before."""
    motion, ahead, noise = setup.motions[0], setup.ahead[0], setup.noise[0]
    seen = []

    def steer(k: int, q: np.ndarray) -> np.ndarray:
        seen.append(q.copy())
        return ahead[k]

    plant = setup.plant(())
    plain = simulate(plant, motion, ahead, noise)
    steered = simulate(plant, motion, 0 * ahead, noise, steer)
    assert plain is not None and steered is not None
    np.testing.assert_array_equal(steered["tau"], plain["tau"])
    np.testing.assert_array_equal(seen[1:], plain["q"][:-1])
    np.testing.assert_array_equal(seen[0], motion.q[0])


def test_a_plan_deals_every_kind_and_the_shares_of_the_conditions() -> None:
    specs = allocate_cases(BlindPlan(), 5)
    assert Counter(s.kind for s in specs) == {
        **{"single": 100, "pair": 60, "triple": 30},
        **{"outside": 30, "healthy": 80, "ladder": 60},
    }
    assert sum(s.conditions.bare for s in specs) == 120
    assert {s.laws[0] for s in specs if s.kind == "single"} == {*INSIDE, *SETUP}
    assert specs == allocate_cases(BlindPlan(), 5) != allocate_cases(BlindPlan(), 6)


@pytest.mark.parametrize("name", LAWS)
def test_the_documentation_says_how_each_law_is_generated(name: str) -> None:
    text = (ROOT / "docs" / "blind_check.md").read_text(encoding="utf-8")
    row = next(line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
    assert LAWS[name].form.replace("|", "\\|") in row
