"""Optimisers: each beats random search, keeps the limits, and does the same again with the same seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from cases import sines

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Limits, way_points
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.design import (
    OPTIMISERS,
    Excitation,
    ExcitationPlan,
    LimitPlan,
    binding_limit,
    check_condition,
    design,
    prepare,
    sampled,
    write_joint_trajectory,
)
from gapscope.ident.excitation.trajectory_search import (
    CRITERIA,
    KINDS,
    SAMPLES,
    Allowed,
    Budget,
    Checker,
    ExcitationModel,
    Parametrisation,
    TrajectorySearch,
    separator_of,
)
from gapscope.ident.model.base_parameters import condition_number
from gapscope.ident.model.regressor import JOINT_COLUMNS

COLUMNS = ("rotor", "damping")
LIMITS = LimitPlan(singular=0.0)


@pytest.mark.parametrize(
    ("kind", "criterion"),
    [("fourier", "condition"), ("quintic", "d"), ("multisine", "e")],
)
def test_gradient_of_the_score_agrees_with_finite_differences(
    kind: str, criterion: str, arm: NominalArm, body: RigidBody, limits: Limits
) -> None:
    """With torque limits broken, so that the penalty counts too."""
    search = TrajectorySearch(
        Parametrisation(KINDS[kind](3, 10.0, 3, 0.1), limits),
        ExcitationModel(arm, body, COLUMNS),
        CRITERIA[criterion],
        Checker(arm, body, Allowed(limits, np.array([0.5, 12.0, 3.0]), 0.0, 0.0), None),
        Budget(400),
    )
    x, h = search.parametrisation.draw(np.random.default_rng(1)), 1e-6
    score, gradient = search.score_and_gradient(x)
    assert score == search.score(x)
    assert not search.found and search.hardest == ("torque",)
    rows = np.eye(len(x))
    numeric = np.array(
        [(search.score(x + h * e) - search.score(x - h * e)) / (2 * h) for e in rows]
    )
    off = np.abs(gradient - numeric) / np.abs(numeric).max()
    # but for the sign of the velocity, which the gradient takes as constant
    assert np.median(off) < 1e-5 and off.max() < 0.05


@pytest.fixture(scope="module")
def plain(arm: NominalArm) -> Excitation:
    """The best of 200 random candidates."""
    plan = ExcitationPlan(
        order=3, columns=COLUMNS, optimiser="random", budget=Budget(200), rate=200.0
    )
    return design(prepare(arm, plan, LIMITS), np.random.default_rng(3))


@pytest.mark.parametrize("name", OPTIMISERS)
def test_optimiser_keeps_all_limits_and_repeats_itself(
    name: str, arm: NominalArm, body: RigidBody, plain: Excitation
) -> None:
    plan = ExcitationPlan(
        order=3, columns=COLUMNS, optimiser=name, budget=Budget(200), rate=200.0
    )
    found, again = (
        design(prepare(arm, plan, LIMITS), np.random.default_rng(3)) for _ in range(2)
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
    for name, optimise in OPTIMISERS.items():
        space = Parametrisation(KINDS["fourier"](3, 10.0, 5, 0.1), limits)
        made = TrajectorySearch(
            space,
            model,
            CRITERIA["condition"],
            Checker(arm, body, allowed, None),
            Budget(600),
        )
        optimise(made, np.random.default_rng(0))
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
    few = replace(plan, criterion="condition", budget=Budget(8), optimiser="random")
    first = design(prepare(arm, few, LIMITS), np.random.default_rng(0))
    found = design(prepare(arm, plan, LIMITS), np.random.default_rng(0))
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
        plan = ExcitationPlan(order=2, budget=Budget(20), optimiser="random")
        limits = LimitPlan(torque=0.06, singular=0.0)
        design(prepare(arm, plan, limits), np.random.default_rng(0))


@pytest.mark.parametrize(
    "budget", [{"evaluations": 0}, {"seconds": -1.0}, {"evaluations": None}]
)
def test_budgets_that_make_no_sense_are_refused(
    budget: dict[str, float | None],
) -> None:
    with pytest.raises(InputError):
        Budget(**budget)  # type: ignore[arg-type]


def test_joint_trajectory_holds_the_motion(tmp_path: Path, limits: Limits) -> None:
    made = Parametrisation(KINDS["quintic"](3, 4.0, 2, 0.5), limits)
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


# Every candidate keeps its limits, rests at both ends, and the exact gradients are those of finite differences.


DURATION = 10.0


def space(kind: str, limits: Limits, frequency: float = 0.1) -> Parametrisation:
    return Parametrisation(KINDS[kind](3, DURATION, 4, frequency), limits)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frequency", [0.1, 0.5])
def test_every_candidate_keeps_the_limits_at_every_millisecond(
    kind: str, frequency: float, limits: Limits
) -> None:
    made, rng, t = (
        space(kind, limits, frequency),
        np.random.default_rng(0),
        np.linspace(0, DURATION, 10001),
    )
    for _ in range(10):
        x = 2 * made.draw(rng)
        reference = made.reference(x)
        q = reference.position(t)
        assert (q >= limits.lower).all() and (q <= limits.upper).all()
        assert (np.abs(reference.velocity(t)) <= limits.velocity).all()
        assert (np.abs(reference.acceleration(t)) <= limits.acceleration).all()


def test_multisine_has_the_same_velocity_at_all_harmonics(limits: Limits) -> None:
    made = KINDS["multisine"](3, DURATION, 4, 0.1)
    sine, cosine = np.split(
        made.coefficients(np.random.default_rng(0).standard_normal(made.size)), 2
    )
    amplitude = np.hypot(sine, cosine) * np.arange(1, 5)[:, None]
    np.testing.assert_allclose(amplitude, 1.0)


def test_way_points_are_passed_at_their_times() -> None:
    times, points = (
        np.array([0.0, 1.0, 2.5, 3.0]),
        np.array([[0.0], [1.0], [-1.0], [0.5]]),
    )
    motion = way_points(times, points)
    np.testing.assert_allclose(motion.position(times), points, atol=1e-12)
    np.testing.assert_allclose(
        motion.position(np.array([-1.0, 9.0])), [[0.0], [0.5]], atol=1e-12
    )
    np.testing.assert_allclose(motion.velocity(np.array([0.0, 3.0])), 0.0, atol=1e-9)
    t, h = np.linspace(0.01, 2.99, 40), 1e-6
    slope = (motion.position(t + h) - motion.position(t - h)) / (2 * h)
    np.testing.assert_allclose(motion.velocity(t), slope, atol=1e-6)


@pytest.mark.parametrize(
    ("times", "points"),
    [([0.0], [[1.0]]), ([0.0, 0.0], [[1.0], [2.0]]), ([0.5, 1.0], [[1.0], [2.0]])],
)
def test_bad_way_points_are_refused(
    times: list[float], points: list[list[float]]
) -> None:
    with pytest.raises(InputError, match="way points|times"):
        way_points(np.array(times), np.array(points))


# Criteria by hand, and effects that can and cannot be separated.


MATRIX = np.array([[[3.0, 0.0]], [[0.0, 0.5]], [[4.0, 0.5]]])
"""Columns (3, 0, 4) and (0, 0.5, 0.5): norms 5 and sqrt(0.5), cosine 2 / (5 sqrt(0.5)) = 0.4 sqrt(2)."""


def test_d_and_e_by_hand() -> None:
    """W^T W / 3 with columns over (5, 1): [[25, 2], [2, 0.5]] / 3 scaled: determinant (0.5 - 0.16) / 9."""
    reference = np.array([5.0, 1.0])
    gram = np.array([[1.0, 0.4], [0.4, 0.5]]) / 3
    values = np.linalg.eigvalsh(gram)
    assert CRITERIA["d"].evaluate(MATRIX, reference) == pytest.approx(
        -0.25 * np.log((0.5 - 0.16) / 9)
    )
    assert CRITERIA["e"].evaluate(MATRIX, reference) == pytest.approx(
        -0.5 * np.log(values[0])
    )


def to_and_fro(amplitude: float, n: int = 400) -> Motion:
    t = np.linspace(0.0, 10.0, n)
    w = 2 * np.pi * np.array([0.3, 0.4, 0.5])
    return sines(t, amplitude, w, np.arange(3))


def test_an_effect_is_as_far_from_its_likeness_as_the_load_varies(
    arm: NominalArm, body: RigidBody
) -> None:
    """Load friction is Coulomb friction under constant load: telling them apart takes a load that changes."""
    separate = separator_of(arm, body, ("coulomb_friction", "load_friction"))
    model = ExcitationModel(arm, body)
    small, large = (
        separate(m, model.matrix(m)) for m in (to_and_fro(0.01), to_and_fro(1.0))
    )
    assert 0 <= small.least < large.least <= 1
    pair = ("coulomb_friction", "load_friction")
    assert small.angle[pair] < large.angle[pair] <= np.pi / 2


def test_an_effect_that_base_parameters_explain_shows_nothing_of_its_own(
    arm: NominalArm, body: RigidBody
) -> None:
    motion, model = to_and_fro(1.0), ExcitationModel(arm, body)
    found = separator_of(arm, body, ("payload", "coulomb_friction"))(
        motion, model.matrix(motion)
    )
    assert found.least < 1e-6
    assert found.angle[("payload", "coulomb_friction")] == 0.0


@pytest.mark.parametrize(
    "names", [(), ("payload",), ("payload", "payload"), ("payload", "stiction")]
)
def test_effects_that_cannot_be_compared_are_refused(
    names: tuple[str, ...], arm: NominalArm, body: RigidBody
) -> None:
    with pytest.raises(InputError):
        separator_of(arm, body, names)


# Trajectories that determine no parameter: the limit that keeps them small, a warning, and a refusal.


Candidate = Callable[..., tuple[TrajectorySearch, np.ndarray, float]]
TINY = {
    "acceleration": {"acceleration": np.full(3, 1e-3)},
    "velocity": {"velocity": np.full(3, 1e-3)},
    "position": {"lower": np.full(3, 0.500), "upper": np.full(3, 0.501)},
}
"""Limits that keep a motion of the arm small, each alone."""


@pytest.fixture
def candidate(arm: NominalArm, body: RigidBody, limits: Limits) -> Candidate:
    """A search within changed limits, a random candidate of it, and its condition number."""

    def made(**changed: np.ndarray) -> tuple[TrajectorySearch, np.ndarray, float]:
        within = limits._replace(**changed)
        space = Parametrisation(KINDS["fourier"](3, 10.0, 3, 0.1), within)
        model = ExcitationModel(arm, body, ("rotor", "damping"))
        checker = Checker(arm, body, Allowed(within, np.full(3, 40.0), 0.0, 0.0), None)
        search = TrajectorySearch(
            space, model, CRITERIA["condition"], checker, Budget(10)
        )
        x, t = space.draw(np.random.default_rng(0)), np.linspace(0, 10.0, SAMPLES)
        return (
            search,
            x,
            condition_number(model.matrix(space.motion(x, t, space.family.basis(t)))),
        )

    return made


@pytest.mark.parametrize("name", TINY)
def test_the_limit_that_keeps_a_motion_small_is_named(
    name: str, candidate: Candidate
) -> None:
    search, x, condition = candidate(**TINY[name])
    found = binding_limit(search, x, condition)
    assert found is not None and found[0] == name and found[1] < condition / 5


def test_a_useless_trajectory_is_refused_with_the_option_that_helps(
    candidate: Candidate,
) -> None:
    search, x, condition = candidate(acceleration=np.full(3, 1e-5))
    assert condition > 1e8
    with pytest.raises(
        InputError,
        match="(?s)acceleration keeps it small.*remedy: raise --acceleration",
    ):
        check_condition(search, x, condition)
