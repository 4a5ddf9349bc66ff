"""Optimisers: each beats random search, keeps the limits, and does the same again with the same seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
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
    design,
    prepare,
)
from gapscope.ident.excitation.trajectory_search import (
    CRITERIA,
    KINDS,
    Allowed,
    Budget,
    Checker,
    ExcitationModel,
    Parametrisation,
    TrajectorySearch,
    separator_of,
)
from gapscope.ident.model.regressor import JOINT_COLUMNS

COLUMNS = ("rotor", "damping")
LIMITS = LimitPlan(singular=0.0)
PAIR = ("coulomb_friction", "load_friction")
Searching = Callable[..., TrajectorySearch]


SEPARATELY = np.full(3, 40.0)
"""Torque limits that bind nothing [N m]."""


@pytest.fixture
def searching(arm: NominalArm, body: RigidBody, limits: Limits) -> Searching:
    """A search without collisions and singular poses."""

    def made(
        kind: str = "fourier",
        criterion: str = "condition",
        order: int = 3,
        columns: tuple[str, ...] = COLUMNS,
        torque: np.ndarray = SEPARATELY,
        budget: int = 10,
        **changed: np.ndarray,
    ) -> TrajectorySearch:
        within = limits._replace(**changed)
        return TrajectorySearch(
            Parametrisation(KINDS[kind](3, 10.0, order, 0.1), within),
            ExcitationModel(arm, body, columns),
            CRITERIA[criterion],
            Checker(arm, body, Allowed(within, torque, 0.0, 0.0), None),
            Budget(budget),
        )

    return made


@pytest.mark.parametrize(
    ("kind", "criterion"),
    [("fourier", "condition"), ("quintic", "d"), ("multisine", "e")],
)
def test_gradient_of_the_score_agrees_with_finite_differences(
    kind: str, criterion: str, searching: Searching
) -> None:
    """With torque limits broken, so that the penalty counts too."""
    search = searching(kind, criterion, torque=np.array([0.5, 12.0, 3.0]), budget=400)
    x, h = search.parametrisation.draw(np.random.default_rng(1)), 1e-6
    score, gradient = search.score_and_gradient(x)
    assert score == search.score(x)
    assert not search.found and search.hardest == ("torque",)
    ends = [[search.score(x + s * e) for e in h * np.eye(len(x))] for s in (1, -1)]
    numeric = np.subtract(*ends) / (2 * h)
    off = np.abs(gradient - numeric) / np.abs(numeric).max()
    # but for the sign of the velocity, which the gradient takes as constant
    assert np.median(off) < 1e-5 and off.max() < 0.05


def short(arm: NominalArm, optimiser: str) -> Excitation:
    """The best of 200 candidates."""
    few = {"order": 3, "budget": Budget(200), "rate": 200.0}
    plan = ExcitationPlan(optimiser=optimiser, **few)
    return design(prepare(arm, plan, LIMITS), np.random.default_rng(3))


@pytest.fixture(scope="module")
def plain(arm: NominalArm) -> Excitation:
    """The best of as many random ones."""
    return short(arm, "random")


@pytest.mark.parametrize("name", OPTIMISERS)
def test_optimiser_keeps_all_limits_and_repeats_itself(
    name: str, arm: NominalArm, body: RigidBody, plain: Excitation
) -> None:
    found = short(arm, name)
    again = plain if name == "random" else short(arm, name)
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
    searching: Searching,
) -> None:
    """Condition number after the same 600 evaluations, with friction that is hard to tell apart."""
    found = {}
    for name, optimise in OPTIMISERS.items():
        made = searching(order=5, columns=JOINT_COLUMNS, budget=600)
        optimise(made, np.random.default_rng(0))
        found[name] = np.exp(made.found[-1].value)
    half = found.pop("random") / 2
    assert all(value <= half for value in found.values())


def test_separation_finds_a_trajectory_that_tells_the_effects_apart(
    arm: NominalArm,
) -> None:
    apart = {"criterion": "separation", "effects": PAIR, "budget": Budget(80)}
    few = {"effects": PAIR, "budget": Budget(8), "optimiser": "random"}
    plans = (ExcitationPlan(order=2, **how) for how in (few, apart))
    first, found = (
        design(prepare(arm, plan, LIMITS), np.random.default_rng(0)) for plan in plans
    )
    assert found.separated is not None and first.separated is not None
    assert found.separated.least > first.separated.least


# Every candidate keeps its limits.


DURATION = 10.0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frequency", [0.1, 0.5])
def test_every_candidate_keeps_the_limits_at_every_millisecond(
    kind: str, frequency: float, limits: Limits
) -> None:
    made = Parametrisation(KINDS[kind](3, DURATION, 4, frequency), limits)
    rng, t = np.random.default_rng(0), np.linspace(0, DURATION, 10001)
    for _ in range(10):
        reference = made.reference(2 * made.draw(rng))
        q = reference.position(t)
        assert (q >= limits.lower).all() and (q <= limits.upper).all()
        assert (np.abs(reference.velocity(t)) <= limits.velocity).all()
        assert (np.abs(reference.acceleration(t)) <= limits.acceleration).all()


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.0], [0.5, 1.0]], ids=str)
def test_way_points_that_make_no_sense_are_refused(times: list[float]) -> None:
    with pytest.raises(InputError, match="way points"):
        way_points(np.array(times), np.ones((len(times), 1)))


def test_a_search_without_a_budget_is_refused() -> None:
    with pytest.raises(InputError, match="never end"):
        Budget(evaluations=None)


def test_way_points_are_passed_at_their_times() -> None:
    times = np.array([0.0, 1.0, 2.5, 3.0])
    points = np.array([[0.0], [1.0], [-1.0], [0.5]])
    motion = way_points(times, points)
    np.testing.assert_allclose(motion.position(times), points, atol=1e-12)
    beyond = motion.position(np.array([-1.0, 9.0]))
    np.testing.assert_allclose(beyond, points[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(motion.velocity(np.array([0.0, 3.0])), 0.0, atol=1e-9)
    t, h = np.linspace(0.01, 2.99, 40), 1e-6
    slope = (motion.position(t + h) - motion.position(t - h)) / (2 * h)
    np.testing.assert_allclose(motion.velocity(t), slope, atol=1e-6)


# Criteria by hand, and effects that can and cannot be separated.


MATRIX = np.array([[[3.0, 0.0]], [[0.0, 0.5]], [[4.0, 0.5]]])
"""Columns (3, 0, 4) and (0, 0.5, 0.5): norms 5 and sqrt(0.5), cosine 2 / (5 sqrt(0.5)) = 0.4 sqrt(2)."""


def test_d_and_e_by_hand() -> None:
    """W^T W / 3 with columns over (5, 1): [[25, 2], [2, 0.5]] / 3 scaled: determinant (0.5 - 0.16) / 9."""
    reference = np.array([5.0, 1.0])
    least = np.linalg.eigvalsh(np.array([[1.0, 0.4], [0.4, 0.5]]) / 3)[0]
    expected = {"d": -0.25 * np.log((0.5 - 0.16) / 9), "e": -0.5 * np.log(least)}
    for name, value in expected.items():
        assert CRITERIA[name].evaluate(MATRIX, reference) == pytest.approx(value)


def to_and_fro(amplitude: float, n: int = 400) -> Motion:
    t = np.linspace(0.0, 10.0, n)
    w = 2 * np.pi * np.array([0.3, 0.4, 0.5])
    return sines(t, amplitude, w, np.arange(3))


def test_an_effect_is_as_far_from_its_likeness_as_the_load_varies(
    arm: NominalArm, body: RigidBody
) -> None:
    """Load friction is Coulomb friction under constant load: telling them apart takes a load that changes."""
    separate, model = separator_of(arm, body, PAIR), ExcitationModel(arm, body)
    motions = [to_and_fro(0.01), to_and_fro(1.0)]
    small, large = (separate(m, model.matrix(m)) for m in motions)
    assert 0 <= small.least < large.least <= 1
    assert small.angle[PAIR] < large.angle[PAIR] <= np.pi / 2
    # what base parameters explain shows nothing of its own
    other = ("payload", "coulomb_friction")
    found = separator_of(arm, body, other)(motions[1], model.matrix(motions[1]))
    assert found.least < 1e-6 and found.angle[other] == 0.0
