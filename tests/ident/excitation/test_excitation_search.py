"""Optimisers: each beats random search, keeps the limits, and does the same again with the same seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Limits
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.candidate_model import ExcitationModel
from gapscope.ident.excitation.criteria import CRITERIA
from gapscope.ident.excitation.design import Excitation, design, sampled
from gapscope.ident.excitation.excitation_plan import (
    OPTIMISERS,
    ExcitationPlan,
    LimitPlan,
)
from gapscope.ident.excitation.families import family
from gapscope.ident.excitation.limits import Allowed, Checker
from gapscope.ident.excitation.random_search import RandomSearch
from gapscope.ident.excitation.trajectory_files import write_joint_trajectory
from gapscope.ident.excitation.trajectory_parametrisation import Parametrisation
from gapscope.ident.excitation.trajectory_search import Budget, TrajectorySearch
from gapscope.ident.model.regressor import JOINT_COLUMNS

COLUMNS = ("rotor", "damping")
LIMITS = LimitPlan(singular=0.0)


@pytest.fixture
def search(arm: NominalArm, body: RigidBody, limits: Limits) -> TrajectorySearch:
    made = Parametrisation(family("fourier", 3, 10.0, 3, 0.1), limits)
    allowed = Allowed(limits, np.array([40.0, 40.0, 40.0]), 0.0, 0.0)
    checker = Checker(arm, body, allowed, None)
    return TrajectorySearch(
        made,
        ExcitationModel(arm, body, COLUMNS),
        CRITERIA["condition"],
        checker,
        Budget(400),
    )


def test_gradient_of_the_score_agrees_with_finite_differences(
    search: TrajectorySearch,
) -> None:
    """With torque limits broken, so that the penalty counts too."""
    search.checker.allowed.torque[:] = [0.5, 12.0, 3.0]
    x, h = search.parametrisation.draw(np.random.default_rng(1)), 1e-6
    score, gradient = search.score_and_gradient(x)
    assert (
        score == search.score(x) and not search.found and search.hardest == ("torque",)
    )
    rows = np.eye(len(x))
    numeric = np.array(
        [(search.score(x + h * e) - search.score(x - h * e)) / (2 * h) for e in rows]
    )
    off = np.abs(gradient - numeric) / np.abs(numeric).max()
    assert (
        np.median(off) < 1e-5
    )  # but for the sign of the velocity, which the gradient takes as constant
    assert off.max() < 0.05


def test_found_ones_get_better_and_the_budget_holds(search: TrajectorySearch) -> None:
    RandomSearch().run(search, np.random.default_rng(0))
    values = [found.value for found in search.found]
    assert (
        search.evaluations == 400
        and values == sorted(values, reverse=True)
        and len(values) > 1
    )


def test_random_search_stops_after_enough_feasible_ones(
    search: TrajectorySearch,
) -> None:
    RandomSearch(feasible=7).run(search, np.random.default_rng(0))
    assert search.feasible == 7


@pytest.fixture(scope="module")
def plain(arm: NominalArm) -> Excitation:
    """The best of 200 random candidates."""
    plan = ExcitationPlan(
        order=3, columns=COLUMNS, optimiser="random", budget=Budget(200), rate=200.0
    )
    return design(arm, plan, LIMITS, np.random.default_rng(3))


@pytest.mark.parametrize("name", OPTIMISERS)
def test_optimiser_keeps_all_limits_and_repeats_itself(
    name: str, arm: NominalArm, body: RigidBody, plain: Excitation
) -> None:
    plan = ExcitationPlan(
        order=3, columns=COLUMNS, optimiser=name, budget=Budget(200), rate=200.0
    )
    found, again = (
        design(arm, plan, LIMITS, np.random.default_rng(3)) for _ in range(2)
    )
    np.testing.assert_array_equal(found.motion.q, again.motion.q)
    assert found.evaluations < 210 and found.condition <= plain.condition
    assert all(margin.kept for margin in found.margins)
    limits = LIMITS.allowed(arm, body)
    assert (np.abs(found.motion.dq) <= limits.motion.velocity).all()
    assert (np.abs(found.torque) <= limits.torque).all()
    kinds = {"position", "velocity", "acceleration", "jerk", "torque", "distance"}
    assert kinds == {m.name for m in found.margins}
    for ends in (found.motion.dq[[0, -1]], found.motion.ddq[[0, -1]]):
        np.testing.assert_allclose(ends, 0.0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.nightly
def test_every_optimiser_at_most_halves_what_random_search_finds(
    arm: NominalArm, body: RigidBody, limits: Limits
) -> None:
    """Condition number after the same 600 evaluations, with friction that is hard to tell apart."""
    model, allowed = (
        ExcitationModel(arm, body, JOINT_COLUMNS),
        Allowed(limits, np.full(3, 40.0), 0.0, 0.0),
    )
    found = {}
    for name, make in OPTIMISERS.items():
        space = Parametrisation(family("fourier", 3, 10.0, 5, 0.1), limits)
        made = TrajectorySearch(
            space,
            model,
            CRITERIA["condition"],
            Checker(arm, body, allowed, None),
            Budget(600),
        )
        make().run(made, np.random.default_rng(0))
        found[name] = np.exp(made.found[-1].value)
    assert all(
        found[name] <= found["random"] / 2 for name in OPTIMISERS if name != "random"
    )


def test_separation_finds_a_trajectory_that_tells_the_effects_apart(
    arm: NominalArm,
) -> None:
    effects = ("coulomb_friction", "load_friction")
    plan = ExcitationPlan(
        order=2, criterion="separation", effects=effects, budget=Budget(80)
    )
    first = design(
        arm,
        ExcitationPlan(order=2, effects=effects, budget=Budget(8), optimiser="random"),
        LIMITS,
        np.random.default_rng(0),
    )
    found = design(arm, plan, LIMITS, np.random.default_rng(0))
    assert found.separated is not None and first.separated is not None
    assert found.separated.least > first.separated.least


def test_when_no_candidate_keeps_the_limits_the_hardest_is_named(
    arm: NominalArm,
) -> None:
    """The arm can be held upright with 6 % of its torque, but hardly moved."""
    with pytest.raises(
        InputError,
        match="(?s)none of 20 candidates keeps all limits; broken most: torque.*--torque",
    ):
        design(
            arm,
            ExcitationPlan(order=2, budget=Budget(20), optimiser="random"),
            LimitPlan(torque=0.06, singular=0.0),
            np.random.default_rng(0),
        )


@pytest.mark.parametrize(
    "budget", [{"evaluations": 0}, {"seconds": -1.0}, {"evaluations": None}]
)
def test_budgets_that_make_no_sense_are_refused(
    budget: dict[str, float | None],
) -> None:
    with pytest.raises(InputError):
        Budget(**budget)  # type: ignore[arg-type]


def test_joint_trajectory_holds_the_motion(tmp_path: Path, limits: Limits) -> None:
    made = Parametrisation(family("quintic", 3, 4.0, 2, 0.5), limits)
    motion = sampled(made.reference(made.draw(np.random.default_rng(0))), 4.0, 250.0)
    write_joint_trajectory(motion, ("a", "b: c", "it's"), tmp_path / "x.yaml")
    message = yaml.safe_load((tmp_path / "x.yaml").read_text())
    assert message["joint_names"] == ["a", "b: c", "it's"]
    times = np.array(
        [
            p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"]
            for p in message["points"]
        ]
    )
    assert (
        times[0] == 0 and times[-1] == pytest.approx(4.0) and (np.diff(times) > 0).all()
    )
    rows = np.searchsorted(motion.t, times - 1e-6)
    for key, series in (
        ("positions", motion.q),
        ("velocities", motion.dq),
        ("accelerations", motion.ddq),
    ):
        np.testing.assert_allclose(
            [p[key] for p in message["points"]], series[rows], atol=1e-9
        )
    assert message["points"][-1]["velocities"] == [0.0, 0.0, 0.0]


def test_names_for_another_number_of_joints_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        write_joint_trajectory(
            Motion(np.arange(2.0), *np.zeros((3, 2, 3))), ("a",), tmp_path / "x.yaml"
        )
