"""The recursive estimate against batch estimates, and what drift does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import changed_during
from sweeps import daily

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.estimators.kalman import Kalman
from gapscope.ident.estimators.linear import WeightedLeastSquares
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)
from gapscope.ident.identification_json import check, document, plain
from gapscope.ident.kalman import Opening, Recursive, Unscented, follow, follow_states
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.regressor import Regressor
from gapscope.model.effective_samples import variance_inflation


def line(count=400, step=0.0, noise=0.1, seed=0):
    """Tau = 2 x + 1 + noise of one joint, the slope changed by ``step`` halfway."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal(count)
    slope = 2.0 + step * (np.arange(count) >= count // 2)
    W = np.stack([x, np.ones(count)], axis=1)[:, None, :]
    tau = (slope * x + 1 + noise * rng.standard_normal(count))[:, None]
    return Problem(W, tau, ("slope", "level"), np.zeros(count, dtype=int), 0.04)


def test_the_last_estimate_is_that_of_weighted_least_squares():
    problem = line()
    batch = np.linalg.lstsq(problem.stacked()[0], problem.stacked()[1], rcond=None)[0]
    recursive = Recursive(np.array([0.1])).follow(problem)
    assert recursive.value[-1] == pytest.approx(batch, abs=1e-5)
    plain = 0.1**2 * np.linalg.inv(problem.stacked()[0].T @ problem.stacked()[0])
    assert recursive.covariance[-1] == pytest.approx(plain, rel=1e-3, abs=1e-8)


def test_a_prior_and_one_sample_give_the_textbook_update():
    problem = Problem(
        np.ones((1, 1, 1)), np.array([[3.0]]), ("level",), np.zeros(1, dtype=int), 1.0
    )
    start, covariance = np.array([1.0]), np.array([[1.0]])
    found = Recursive(np.ones(1), 0.0, start, covariance).follow(problem)
    assert found.value[-1] == pytest.approx([2.0])
    assert found.covariance[-1] == pytest.approx(np.array([[0.5]]))


def test_innovations_are_white_with_unit_variance_where_the_model_holds():
    track = Recursive(np.array([0.1])).follow(line(2000))
    late = track.innovation[50:, 0]
    assert np.var(late) == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean(late[1:] * late[:-1])) < 0.08


def test_drift_follows_a_change_that_a_constant_parameter_averages():
    problem = line(1000, step=1.0)
    still = Recursive(np.array([0.1])).follow(problem)
    moving = Recursive(np.array([0.1]), np.array([0.5, 0.0])).follow(problem)
    assert 2.3 < still.value[-1, 0] < 2.7
    assert moving.of("slope")[0][480] == pytest.approx(2.0, abs=0.15)
    assert moving.of("slope")[0][-1] == pytest.approx(3.0, abs=0.15)


@pytest.mark.parametrize("seed", daily((1, 2), 1))
def test_on_a_recorded_arm_it_agrees_with_the_batch_within_intervals(world, seed):
    problem = world.assembly([world.recorded(seed)])
    batch = WeightedLeastSquares().estimate(problem)
    recursive = Recursive(batch.residual).follow(problem)
    assert (np.abs(recursive.value[-1] - batch.value) < 1.96 * batch.deviation).all()
    assert recursive.deviation[-1] == pytest.approx(batch.deviation, rel=0.2)


# A filter over stretches: least squares without drift, friction that wanders, honest bands, jumps.


TRUTH = np.array([2.0, -1.0, 0.5, 3.0])
NAMES = ("m1", "mx1", "b1", "c1")


def made(
    seed: int,
    beta: np.ndarray = TRUTH,
    correlation: float = 0.0,
    samples: int = 1000,
) -> Problem:
    """Two joints over 20 s, noise of 0.1 and 0.3 N m; beta of shape (4,) or (N, 4)."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((samples, 2, 4))
    noise = rng.standard_normal((samples, 2)) * [0.1, 0.3]
    for k in range(1, samples):
        noise[k] += correlation * noise[k - 1]
    W[:, :, 0] = np.cumsum(W[:, :, 0], axis=0) / np.sqrt(samples)
    beta = np.broadcast_to(beta, (samples, 4))
    torque = np.einsum("kja,ka->kj", W, beta) + noise
    group = np.arange(samples) * 2 // samples
    return Problem(W, torque, NAMES, group, 0.02)


def test_last_estimate_without_drift_is_that_of_weighted_least_squares() -> None:
    problem = made(0)
    found = follow(problem)
    assert found.level == 0.0
    sigma = found.noise * np.sqrt(found.inflation)
    W = (problem.matrix / sigma[:, None]).reshape(-1, 4)
    tau = (problem.torque / sigma).ravel()
    expected = np.linalg.lstsq(W, tau, rcond=None)[0]
    deviation = np.sqrt(np.diag(np.linalg.inv(W.T @ W)))
    np.testing.assert_allclose(
        found.track.value[-1], expected, atol=0.01 * deviation.min()
    )
    np.testing.assert_allclose(found.track.deviation[-1], deviation, rtol=0.01)


def test_intervals_hold_the_truth_under_coloured_noise() -> None:
    inside = []
    for seed in range(40):
        estimate = Kalman().estimate(made(seed, correlation=0.8))
        inside.append(np.abs(estimate.value - TRUTH) < 1.96 * estimate.deviation)
    assert np.mean(inside) > 0.93


def test_friction_that_warms_up_is_followed_and_masses_stay() -> None:
    count = 1000
    fading = np.exp(-np.arange(count) / 400)
    beta = np.tile(TRUTH, (count, 1))
    beta[:, 3] *= 1 + fading
    found = follow(made(1, beta))
    assert found.level > 0
    ends = [rows.stop - 1 for rows in found.stretches.rows]
    value, deviation = found.track.of("c1")
    late = len(ends) // 4
    error = np.abs(value - beta[ends, 3])[late:]
    assert np.mean(error < 3 * deviation[late:]) > 0.8
    assert error.max() < 0.15
    mass, _ = found.track.of("m1")
    assert abs(mass[-1] - TRUTH[0]) < 0.1


def test_innovations_of_a_right_model_are_noise() -> None:
    found = follow(made(2))
    late = found.innovation[300:]
    np.testing.assert_allclose(late.std(axis=0), 1.0, atol=0.1)
    assert (variance_inflation(late, np.zeros(len(late), dtype=int)) < 1.5).all()


def test_an_opening_lets_the_estimate_jump() -> None:
    count, moment = 1000, 600
    beta = np.tile(TRUTH, (count, 1))
    beta[moment:, 0] += 1.5
    problem = made(3, beta)
    covariance = np.diag([4.0, 0.0, 0.0, 0.0])
    opened = follow(problem, [Opening(moment, covariance)])
    mass, deviation = opened.track.of("m1")
    ends = np.array([rows.stop for rows in opened.stretches.rows])
    before, after = mass[ends <= moment][-1], mass[-1]
    assert abs(before - TRUTH[0]) < 4 * deviation[ends <= moment][-1]
    assert abs(after - TRUTH[0] - 1.5) < 4 * deviation[-1]
    # a filter that is not told stays off
    unaware, _ = follow(problem).track.of("m1")
    assert abs(unaware[-1] - TRUTH[0] - 1.5) > 0.1


# Friction that warms up, followed by the filter.


AMPLITUDE, CONSTANT = 0.8, 8.0


@pytest.fixture(scope="module")
def warming(world):
    """Thirty seconds of an arm whose second joint warms up: problem, times and noise."""
    drift = AppliedEffect(
        "friction_drift", (2,), {"amplitude": [AMPLITUDE], "time_constant": [CONSTANT]}
    )
    recording = world.recorded(5, effects=(drift,), duration=30.0)
    problem = world.assembly([recording])
    return (
        problem,
        world.assembly.times(recording),
        WeightedLeastSquares().estimate(problem).residual,
    )


def test_the_filter_follows_friction_that_warms_up(warming, world):
    problem, t, noise = warming
    drift = np.array([{"b2": 0.5, "c2": 0.3}.get(name, 0.0) for name in problem.names])
    track = Recursive(noise, drift).follow(problem, t)
    value, deviation = track.of("b2")
    truth = world.arm.viscous[1] * (1 + AMPLITUDE * np.exp(-t / CONSTANT))
    assert np.mean(np.abs(value - truth) < 1.96 * deviation) > 0.9
    assert np.abs(value - truth)[(t > 2) & (t < 28)].max() < 0.15 * truth.max()


# The unscented filter over state and parameters.


PAYLOAD = ("m3", "mx3", "my3", "mz3")


def unscented(world, names=PAYLOAD, spread=(0.3, 0.02, 0.02, 0.02)):
    spread = np.array(spread)
    return Unscented(world.regressor, names, spread, spread, 3e-5, np.full(3, 0.5))


@pytest.mark.slow
def test_a_payload_shows_in_the_parameters_soon_after_it_was_picked_up(world):
    recording = world.recorded(3, pickup=(3.0, 2.0), duration=5.0)
    track = unscented(world).follow(recording, every=2)
    mass, deviation = track.of("m3")
    assert np.abs(mass[(track.t > 1) & (track.t < 3.0)]).max() < 0.5
    assert mass[track.t > 3.5] == pytest.approx(2.0, abs=0.5)
    assert abs(mass[-1] - 2.0) < 4 * deviation[-1]
    assert track.value[:, :3] == pytest.approx(recording.q[::2], abs=5e-4)


@pytest.mark.slow
def test_velocity_follows_without_differentiating(world):
    recording = world.recorded(4, duration=3.0)
    track = unscented(world, ("b2",), (0.5,)).follow(recording)
    late = track.t > 0.5
    smooth = np.gradient(recording.q, recording.t, axis=0)
    assert track.value[late, 3:6] == pytest.approx(smooth[late], abs=0.05)
    assert track.of("b2")[0][-1] == pytest.approx(0.0, abs=3 * track.of("b2")[1][-1])


def test_what_does_not_fit_is_named(world):
    with pytest.raises(InputError, match="m9 is no parameter"):
        unscented(world, ("m9",), (1.0,))
    with pytest.raises(InputError, match="one per name"):
        unscented(world, ("m3", "b1"), (1.0,))
    with pytest.raises(InputError, match="columns of all quantities"):
        Unscented(
            Regressor(world.arm, quantities=()),
            ("m3",),
            np.ones(1),
            np.ones(1),
            1e-5,
            np.ones(3),
        )
    with pytest.raises(InputError, match="no torque"):
        unscented(world).follow(replace(world.recorded(1, duration=2.5), tau=None))
    with pytest.raises(InputError, match="known payload"):
        unscented(world).follow(
            replace(world.recorded(1, duration=2.5), payload=KnownLoad(1.0))
        )


# States and friction together: friction that differs from where the filter starts is found.


def test_friction_moves_to_that_of_the_recording(world) -> None:
    more = AppliedEffect("viscous_friction", (2,), {"coefficient": [1.2]})
    recording = world.recorded(3, effects=(more,), duration=4.0)
    nominal = dict(
        zip(world.regressor.names, world.regressor.nominal().tolist(), strict=True)
    )
    found = follow_states(world.arm, recording, nominal, np.full(3, 0.1))
    assert found.names == ("b1", "b2", "b3", "c1", "c2", "c3")
    b2 = found.friction[-1, 1]
    assert abs(b2 - 5.2) < 0.5


def test_what_it_cannot_follow_is_refused(world) -> None:
    recording = world.recorded(1, duration=2.5)
    with pytest.raises(InputError, match="no torque"):
        follow_states(world.arm, replace(recording, tau=None), {}, np.ones(3))
    coupled = replace(world.arm, coupling=np.array([[1.0, 0, 0], [0, 1, 0], [0, 1, 1]]))
    with pytest.raises(InputError, match="several joints"):
        follow_states(coupled, recording, {}, np.ones(3))


def test_an_unknown_filter_is_named(world, tmp_path) -> None:
    case = Case("c", tmp_path, world.arm, (world.recorded(1, duration=2.5),))
    with pytest.raises(InputError, match="unknown filter 'magic'"):
        identify(case, IdentificationSettings(filter="magic"))


# A load picked up in the middle of a recording is told by ``identify``, and none is where there was none.


LOAD = AppliedEffect("payload", (), {"mass": 1.5, "com": [0.0, 0.02, 0.08]})
MOMENT = 3.7


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    later = {"recording_1": (MOMENT, (LOAD,))}
    names = [f"recording_{i}" for i in range(3)]
    return changed_during("picked_up", tmp_path_factory.mktemp("case"), later, *names)


@pytest.mark.nightly
def test_a_load_that_is_picked_up_is_told_with_moment_and_mass(case: Case) -> None:
    result = identify(case)
    (found,) = result.changes
    assert found.recording == "recording_1" and found.term.is_load
    assert abs(found.time - MOMENT) < 0.1
    assert abs(found.value[0] - 1.5) < 0.15
    assert any("picked up at 3.7" in warning for warning in result.warnings)
    content = plain(document(result))
    check(content)
    (change,) = content["changes"]
    assert change["what"] == "payload" and change["parameters"][0] == "mass"
    assert abs(change["size"][0] - 1.5) < 0.15
    # the filter is told, and follows the arm from one load to the other
    (moved,) = result.filtered.moved
    track, (before, after) = result.filtered.followed.track, _sides(result, MOMENT)
    plainest = int(np.abs(moved / track.deviation[before]).argmax())
    change = track.value[after, plainest] - track.value[before, plainest]
    assert change == pytest.approx(moved[plainest], rel=0.3)


def _sides(result: Identification, moment: float) -> tuple[int, int]:
    """The last stretch before a moment of the recording with the change, and the last of that recording."""
    review = result.filtered
    own = np.array(review.recordings) == "recording_1"
    return int(np.flatnonzero(own & (review.times < moment))[-1]), int(
        np.flatnonzero(own)[-1]
    )
