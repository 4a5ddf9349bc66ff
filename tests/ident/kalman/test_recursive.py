"""The recursive estimate against batch estimates, and what drift does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import case_of, changed_during
from scipy.signal import lfilter

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import check_document, plain
from gapscope.arm.known_load import KnownLoad
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import (
    IdentificationSettings,
    fit_parameters,
    identify,
)
from gapscope.ident.identification_json import document
from gapscope.ident.kalman import Track, follow, follow_states, kalman
from gapscope.ident.samples import Problem


def of(track: Track, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Value and standard error of one parameter, (N,) each."""
    place = track.names.index(name)
    return track.value[:, place], track.deviation[:, place]


SAMPLES = 1000


def made(
    seed: int, beta: np.ndarray | None = None, correlation: float = 0.0
) -> Problem:
    """Two joints over 20 s, noise of 0.1 and 0.3 N m; beta of shape (N, 4), or the truth throughout."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((SAMPLES, 2, 4))
    noise = rng.standard_normal((SAMPLES, 2)) * [0.1, 0.3]
    noise = lfilter([1.0], [1.0, -correlation], noise, axis=0)
    W[:, :, 0] = np.cumsum(W[:, :, 0], axis=0) / np.sqrt(SAMPLES)
    beta = np.tile(TRUTH, (SAMPLES, 1)) if beta is None else beta
    torque = np.einsum("kja,ka->kj", W, beta) + noise
    group, interval = np.arange(SAMPLES) * 2 // SAMPLES, np.full(SAMPLES, 0.02)
    return Problem(W, torque, NAMES, group, interval)


# A filter over stretches: least squares without drift, friction that wanders, honest bands, jumps.


TRUTH = np.array([2.0, -1.0, 0.5, 3.0])
NAMES = ("m1", "mx1", "b1", "c1")


def test_last_estimate_without_drift_is_that_of_weighted_least_squares() -> None:
    problem = made(0)
    found = follow(problem)
    assert found.level == 0.0
    sigma = found.noise * np.sqrt(found.inflation)
    W = (problem.matrix / sigma[:, None]).reshape(-1, 4)
    expected = np.linalg.lstsq(W, (problem.torque / sigma).ravel(), rcond=None)[0]
    deviation = np.sqrt(np.diag(np.linalg.inv(W.T @ W)))
    error = np.abs(found.track.value[-1] - expected)
    assert error.max() < 0.01 * deviation.min()
    np.testing.assert_allclose(found.track.deviation[-1], deviation, rtol=0.01)


def test_intervals_hold_the_truth_under_coloured_noise() -> None:
    inside = []
    for seed in range(20):
        estimate = kalman(made(seed, correlation=0.8))
        inside.append(np.abs(estimate.value - TRUTH) < 1.96 * estimate.deviation)
    assert np.mean(inside) > 0.93


def test_friction_that_warms_up_is_followed_and_masses_stay() -> None:
    beta = np.tile(TRUTH, (SAMPLES, 1))
    beta[:, 3] *= 1 + np.exp(-np.arange(SAMPLES) / 400)
    found = follow(made(1, beta))
    assert found.level > 0
    ends = [rows.stop - 1 for rows in found.rows]
    value, deviation = of(found.track, "c1")
    late = len(ends) // 4
    error = np.abs(value - beta[ends, 3])[late:]
    assert np.mean(error < 3 * deviation[late:]) > 0.8 and error.max() < 0.15
    mass, _ = of(found.track, "m1")
    assert abs(mass[-1] - TRUTH[0]) < 0.1


def test_an_opening_lets_the_estimate_jump() -> None:
    beta, moment = np.tile(TRUTH, (SAMPLES, 1)), 600
    beta[moment:, 0] += 1.5
    problem = made(3, beta)
    opened = follow(problem, [(moment, np.diag([4.0, 0.0, 0.0, 0.0]))])
    mass, deviation = of(opened.track, "m1")
    early = np.array([rows.stop for rows in opened.rows]) <= moment
    assert abs(mass[early][-1] - TRUTH[0]) < 4 * deviation[early][-1]
    assert abs(mass[-1] - TRUTH[0] - 1.5) < 4 * deviation[-1]
    # a filter that is not told stays off
    unaware, _ = of(follow(problem).track, "m1")
    assert abs(unaware[-1] - TRUTH[0] - 1.5) > 0.1


# States and friction together: friction that differs from where the filter starts is found.


def test_friction_moves_to_that_of_the_recording(world) -> None:
    more = AppliedEffect("viscous_friction", (2,), {"coefficient": [1.2]})
    recording, known = world.recorded(3, effects=(more,)), world.regressor
    nominal = dict(zip(known.names, known.nominal().tolist(), strict=True))
    found = follow_states(world.arm, recording, nominal, np.full(3, 0.1))
    assert found.friction.names == ("b1", "b2", "b3", "c1", "c2", "c3")
    assert abs(of(found.friction, "b2")[0][-1] - 5.2) < 0.5
    # velocity follows without differentiating
    late = found.friction.t > 0.5
    smooth = np.gradient(recording.q, recording.t, axis=0)
    rows = np.searchsorted(recording.t, found.friction.t[late])
    np.testing.assert_allclose(found.state[late, 3:], smooth[rows], atol=0.05)


def test_what_it_cannot_follow_is_refused(world) -> None:
    recording = world.recorded(1)
    silent = replace(recording, tau=None)
    loaded = replace(recording, payload=KnownLoad(1.0))
    coupled = replace(world.arm, coupling=np.array([[1.0, 0, 0], [0, 1, 0], [0, 1, 1]]))
    for message, arm, one in (
        ("no torque", world.arm, silent),
        ("known payload", world.arm, loaded),
        ("several joints", coupled, recording),
    ):
        with pytest.raises(InputError, match=message):
            follow_states(arm, one, {}, np.ones(3))
    # before anything is fitted
    case, said = case_of("loaded", world.arm, loaded, judged=(recording,)), []
    with pytest.raises(InputError, match="leave --filter unscented out"):
        fit_parameters(case, IdentificationSettings(filter="unscented"), said.append)
    assert not said


# A load picked up in the middle of a recording is told by ``identify``, and none is where there was none.


LOAD = AppliedEffect("payload", (), {"mass": 1.5, "com": [0.0, 0.02, 0.08]})
MOMENT = 3.7


@pytest.mark.nightly
def test_a_load_that_is_picked_up_is_told_with_moment_and_mass(tmp_path: Path) -> None:
    """And none is where there was none."""
    later = {"recording_1": (MOMENT, (LOAD,))}
    names = [f"recording_{i}" for i in range(3)]
    result = identify(changed_during("picked_up", tmp_path, later, *names))
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
    review = result.filtered
    (moved,) = review.moved
    own = np.array(review.recordings) == "recording_1"
    before = int(np.flatnonzero(own & (review.times < MOMENT))[-1])
    after = int(np.flatnonzero(own)[-1])
    value, deviation = review.track.value, review.track.deviation
    plainest = int(np.abs(moved / deviation[before]).argmax())
    change = value[after, plainest] - value[before, plainest]
    assert change == pytest.approx(moved[plainest], rel=0.3)
