"""Every candidate keeps its limits, rests at both ends, and the exact gradients are those of finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from sweeps import daily

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Limits
from gapscope.arm.motions.way_points import WayPoints
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.candidate_model import ExcitationModel
from gapscope.ident.excitation.criteria import CRITERIA
from gapscope.ident.excitation.families import KINDS, family
from gapscope.ident.excitation.trajectory_parametrisation import Parametrisation

DURATION = 10.0


def space(kind: str, limits: Limits, frequency: float = 0.1) -> Parametrisation:
    return Parametrisation(family(kind, 3, DURATION, 4, frequency), limits)


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


@pytest.mark.parametrize("kind", KINDS)
def test_full_amplitude_meets_a_limit_on_every_joint(kind: str, limits: Limits) -> None:
    made, t = space(kind, limits), np.linspace(0, DURATION, 10001)
    x = made.draw(np.random.default_rng(1))
    x[3:6] = 9.0
    reference = made.reference(x)
    q, dq, ddq = reference.position(t), reference.velocity(t), reference.acceleration(t)
    centre = q[0]
    room = np.where(
        q > centre,
        (q - centre) / (limits.upper - centre),
        (centre - q) / (centre - limits.lower),
    )
    use = np.maximum.reduce(
        [
            room.max(0),
            np.abs(dq / limits.velocity).max(0),
            np.abs(ddq / limits.acceleration).max(0),
        ]
    )
    np.testing.assert_allclose(use, 1.0, atol=0.005)


@pytest.mark.parametrize("kind", KINDS)
def test_starts_and_ends_at_rest(kind: str, limits: Limits) -> None:
    made = space(kind, limits)
    reference = made.reference(made.draw(np.random.default_rng(2)))
    ends = np.array([0.0, DURATION])
    np.testing.assert_allclose(
        np.diff(reference.position(ends), axis=0), 0.0, atol=1e-12
    )
    np.testing.assert_allclose(reference.velocity(ends), 0.0, atol=1e-9)
    np.testing.assert_allclose(reference.acceleration(ends), 0.0, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_motion_on_a_basis_is_that_of_the_reference(kind: str, limits: Limits) -> None:
    made, t = space(kind, limits), np.linspace(0, DURATION, 50)
    x = made.draw(np.random.default_rng(3))
    motion, reference = made.motion(x, t, made.family.basis(t)), made.reference(x)
    np.testing.assert_allclose(motion.q, reference.position(t), atol=1e-12)
    np.testing.assert_allclose(motion.dq, reference.velocity(t), atol=1e-12)
    np.testing.assert_allclose(motion.ddq, reference.acceleration(t), atol=1e-11)


def test_multisine_has_the_same_velocity_at_all_harmonics(limits: Limits) -> None:
    made = family("multisine", 3, DURATION, 4, 0.1)
    sine, cosine = np.split(
        made.coefficients(np.random.default_rng(0).standard_normal(made.size)), 2
    )
    amplitude = np.hypot(sine, cosine) * np.arange(1, 5)[:, None]
    np.testing.assert_allclose(amplitude, 1.0)


def numeric(
    function: Callable[[np.ndarray], float], x: np.ndarray, h: float = 1e-6
) -> np.ndarray:
    """Gradient by central differences, of the shape of x."""
    rows = np.eye(x.size).reshape(x.size, *x.shape)
    return np.array(
        [(function(x + h * e) - function(x - h * e)) / (2 * h) for e in rows]
    ).reshape(x.shape)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", daily(range(4), 0))
def test_gradient_through_the_limits_agrees_with_finite_differences(
    kind: str, seed: int, limits: Limits
) -> None:
    made, t, rng = (
        space(kind, limits, 0.2),
        np.linspace(0, DURATION, 40),
        np.random.default_rng(seed),
    )
    basis, weights = made.family.basis(t), rng.standard_normal((3, len(t), 3))

    def value(x: np.ndarray) -> float:
        motion = made.motion(x, t, basis)
        return float(
            sum(
                (w * y).sum()
                for w, y in zip(weights, (motion.q, motion.dq, motion.ddq), strict=True)
            )
        )

    x = made.draw(rng)
    np.testing.assert_allclose(
        made.pullback(x, basis, tuple(weights)), numeric(value, x), atol=1e-6, rtol=1e-6
    )


def test_gradient_of_regressor_and_torque_agrees_with_finite_differences(
    arm: NominalArm,
) -> None:
    smooth = NominalArm(
        "three", arm.urdf, arm.joints, armature=arm.armature, viscous=arm.viscous
    )
    model = ExcitationModel(smooth, RigidBody(smooth), ("rotor", "damping"))
    rng, t = np.random.default_rng(5), np.arange(4.0)
    motion, weight = rng.standard_normal((3, 4, 3)), rng.standard_normal((4, 3))
    by_matrix = rng.standard_normal((4, 3, len(model.names)))

    def value(motion: np.ndarray) -> float:
        made = Motion(t, *motion)
        return float(
            (by_matrix * model.matrix(made)).sum() + (weight * model.torque(made)).sum()
        )

    found = model.pullback(Motion(t, *motion), by_matrix, weight)
    np.testing.assert_allclose(np.array(found), numeric(value, motion), atol=1e-6)


@pytest.mark.parametrize("name", CRITERIA)
def test_gradient_of_a_criterion_agrees_with_finite_differences(name: str) -> None:
    rng, criterion = np.random.default_rng(6), CRITERIA[name]
    matrix, reference = (
        rng.standard_normal((10, 2, 4)) * [1.0, 2.0, 0.5, 3.0],
        np.array([1.0, 1.5, 1.0, 2.0]),
    )
    expected = numeric(lambda w: criterion.evaluate(w, reference), matrix)
    np.testing.assert_allclose(
        criterion.gradient(matrix, reference), expected, atol=1e-8
    )


def test_way_points_are_passed_at_their_times() -> None:
    times, points = (
        np.array([0.0, 1.0, 2.5, 3.0]),
        np.array([[0.0], [1.0], [-1.0], [0.5]]),
    )
    motion = WayPoints(times, points)
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
        WayPoints(np.array(times), np.array(points))
