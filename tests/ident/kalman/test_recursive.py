"""The recursive estimate against batch estimates, and what drift does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import changed_during

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import check_document, plain
from gapscope.arm.known_load import KnownLoad
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import (
    Identification,
    identify,
)
from gapscope.ident.identification_json import document
from gapscope.ident.kalman import Track, follow, follow_states, kalman
from gapscope.ident.samples import Problem


def of(track: Track, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Value and standard error of one parameter, (N,) each."""
    place = track.names.index(name)
    return track.value[:, place], track.deviation[:, place]


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
    return Problem(W, torque, NAMES, group, np.full(samples, 0.02))


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
        estimate = kalman(made(seed, correlation=0.8))
        inside.append(np.abs(estimate.value - TRUTH) < 1.96 * estimate.deviation)
    assert np.mean(inside) > 0.93


def test_friction_that_warms_up_is_followed_and_masses_stay() -> None:
    count = 1000
    fading = np.exp(-np.arange(count) / 400)
    beta = np.tile(TRUTH, (count, 1))
    beta[:, 3] *= 1 + fading
    found = follow(made(1, beta))
    assert found.level > 0
    ends = [rows.stop - 1 for rows in found.rows]
    value, deviation = of(found.track, "c1")
    late = len(ends) // 4
    error = np.abs(value - beta[ends, 3])[late:]
    assert np.mean(error < 3 * deviation[late:]) > 0.8
    assert error.max() < 0.15
    mass, _ = of(found.track, "m1")
    assert abs(mass[-1] - TRUTH[0]) < 0.1


def test_an_opening_lets_the_estimate_jump() -> None:
    count, moment = 1000, 600
    beta = np.tile(TRUTH, (count, 1))
    beta[moment:, 0] += 1.5
    problem = made(3, beta)
    covariance = np.diag([4.0, 0.0, 0.0, 0.0])
    opened = follow(problem, [(moment, covariance)])
    mass, deviation = of(opened.track, "m1")
    ends = np.array([rows.stop for rows in opened.rows])
    before, after = mass[ends <= moment][-1], mass[-1]
    assert abs(before - TRUTH[0]) < 4 * deviation[ends <= moment][-1]
    assert abs(after - TRUTH[0] - 1.5) < 4 * deviation[-1]
    # a filter that is not told stays off
    unaware, _ = of(follow(problem).track, "m1")
    assert abs(unaware[-1] - TRUTH[0] - 1.5) > 0.1


# States and friction together: friction that differs from where the filter starts is found.


def test_friction_moves_to_that_of_the_recording(world) -> None:
    more = AppliedEffect("viscous_friction", (2,), {"coefficient": [1.2]})
    recording = world.recorded(3, effects=(more,), duration=4.0)
    nominal = dict(
        zip(world.regressor.names, world.regressor.nominal().tolist(), strict=True)
    )
    found = follow_states(world.arm, recording, nominal, np.full(3, 0.1))
    assert found.friction.names == ("b1", "b2", "b3", "c1", "c2", "c3")
    assert abs(of(found.friction, "b2")[0][-1] - 5.2) < 0.5
    # velocity follows without differentiating
    t = found.friction.t
    smooth = np.gradient(recording.q, recording.t, axis=0)
    rows = np.searchsorted(recording.t, t[t > 0.5])
    np.testing.assert_allclose(found.state[t > 0.5, 3:], smooth[rows], atol=0.05)


def test_what_it_cannot_follow_is_refused(world) -> None:
    recording = world.recorded(1, duration=2.5)
    with pytest.raises(InputError, match="no torque"):
        follow_states(world.arm, replace(recording, tau=None), {}, np.ones(3))
    loaded = replace(recording, payload=KnownLoad(1.0))
    with pytest.raises(InputError, match="known payload"):
        follow_states(world.arm, loaded, {}, np.ones(3))
    coupled = replace(world.arm, coupling=np.array([[1.0, 0, 0], [0, 1, 0], [0, 1, 1]]))
    with pytest.raises(InputError, match="several joints"):
        follow_states(coupled, recording, {}, np.ones(3))


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
    check_document(content, "identification")
    (change,) = content["changes"]
    assert change["what"] == "payload" and change["parameters"][0] == "mass"
    assert abs(change["size"][0] - 1.5) < 0.15
    # the filter is told, and follows the arm from one load to the other
    (moved,) = result.filtered.moved
    track, (before, after) = result.filtered.track, _sides(result, MOMENT)
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
