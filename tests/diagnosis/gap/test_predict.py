"""The torque predicted at every sample: finite for each row, of t and q alone, and the same that the gap uses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import condition, low_pass
from gapscope.model.torque_gap import torque_gap

COULOMB = AppliedEffect("coulomb_friction", (2,), {"torque": [2.0]})
DELAY = AppliedEffect("actuator_delay", (1, 3), {"delay": [0.01, 0.02]})
PAYLOAD = AppliedEffect("payload", (), {"mass": 1.0, "com": [0.2, 0.0, 0.0]})


def corrected(*effects: AppliedEffect) -> CorrectedArm:
    return CorrectedArm(synthetic.arm(), effects)


def recording(truth: Truth = Truth(), rate: float = 250.0) -> Recording:  # noqa: B008
    return synthetic.recordings(truth, 4, duration=6.0, rate=rate)[1]


def only(r: Recording, keep: np.ndarray | slice | None = None) -> Recording:
    """Some rows of a recording, t and q alone."""
    rows = slice(None) if keep is None else keep
    return Recording(r.name, r.t[rows], r.q[rows])


def standing(arm: CorrectedArm, q: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(q)
    return synthetic.body().inverse_dynamics(q, zero, zero)


@pytest.mark.parametrize("rate", [30.0, 250.0, 1000.0])
def test_one_finite_row_per_sample_near_the_recorded_torque(rate: float) -> None:
    truth = Truth(coulomb=(0.0, 2.0, 0.0), delay=(0.01, 0.0, 0.02))
    r = recording(truth, rate)
    predicted = predict_torque(corrected(COULOMB, DELAY), only(r))
    assert predicted.shape == (len(r.t), 3) and np.isfinite(predicted).all()
    edge = round(0.3 * rate)
    error = low_pass(r.tau - predicted, rate, 5.0)[edge:-edge]
    assert (np.sqrt((error**2).mean(axis=0)) < 0.06 * np.std(r.tau, axis=0)).all()


def test_of_the_recording_only_t_and_q_are_used() -> None:
    r = recording()
    reference = predict_torque(corrected(COULOMB, DELAY), only(r))
    rng = np.random.default_rng(0)
    noisy = {
        name: rng.standard_normal(r.q.shape)
        for name in ("tau", "dq", "q_ref", "dq_ref", "tau_sensor")
    }
    np.testing.assert_array_equal(
        predict_torque(corrected(COULOMB, DELAY), replace(r, **noisy)), reference
    )
    np.testing.assert_array_equal(
        predict_torque(corrected(COULOMB, DELAY), r), reference
    )
    moved = Recording(r.name, r.t, r.q + 0.1)
    assert (
        np.abs(predict_torque(corrected(COULOMB, DELAY), moved) - reference).max() > 0.1
    )


def test_agrees_with_the_prediction_of_the_gap() -> None:
    """At one cut-off both are the same series."""
    r = recording(Truth(coulomb=(0.0, 2.0, 0.0)))
    segments = condition(r)
    gap = torque_gap(corrected(COULOMB, DELAY, PAYLOAD), synthetic.body(), segments)
    predicted = low_pass(
        predict_torque(corrected(COULOMB, DELAY, PAYLOAD), r), 250.0, 12.0
    )[segments[0].inner]
    np.testing.assert_allclose(predicted, gap.predicted, atol=1e-6)


@pytest.mark.parametrize("rate", [500.0, 1000.0])
def test_agrees_on_a_fast_log(rate: float) -> None:
    r = recording(rate=rate)
    predicted = predict_torque(corrected(), only(r))
    expected = synthetic.needed(Truth(), synthetic.motion(41, 0.2, 6.0), r.t)
    error = low_pass(predicted - expected, rate, 12.0)[300:-300]
    assert (np.sqrt((error**2).mean(axis=0)) < 0.02 * expected.std(axis=0)).all()


def test_repeated_time_stamps_give_repeated_rows() -> None:
    r = recording()
    keep = np.sort(np.r_[np.arange(len(r.t)), [10, 10, 700, len(r.t) - 1]])
    expected = predict_torque(corrected(COULOMB), only(r))[keep]
    np.testing.assert_allclose(
        predict_torque(corrected(COULOMB), only(r, keep)), expected, atol=1e-9
    )


def test_on_both_sides_of_a_gap() -> None:
    r = recording()
    keep = (r.t < 2.5) | (r.t > 3.2)
    torn = predict_torque(corrected(COULOMB, DELAY), only(r, keep))
    assert torn.shape == (keep.sum(), 3) and np.isfinite(torn).all()
    whole = predict_torque(corrected(COULOMB, DELAY), only(r))[keep]
    t = r.t[keep]
    far = ((t > 0.5) & (t < 2.0)) | ((t > 3.7) & (t < 5.5))
    difference = low_pass(torn - whole, 250.0, 12.0)[far]
    assert np.sqrt((difference**2).mean(axis=0)).max() < 0.5


def test_short_pieces_are_taken_to_stand_still() -> None:
    r = recording()
    keep = (r.t < 3.0) | ((r.t > 3.5) & (r.t < 3.6)) | (r.t > 4.0)
    predicted = predict_torque(corrected(PAYLOAD), only(r, keep))
    assert np.isfinite(predicted).all() and predicted.shape == (keep.sum(), 3)
    short = (r.t[keep] > 3.5) & (r.t[keep] < 3.6)
    np.testing.assert_allclose(
        predict_torque(corrected(), only(r, keep))[short],
        standing(corrected(), r.q[keep][short]),
        atol=1e-9,
    )


@pytest.mark.parametrize("rows", [1, 2, 7, 100])
def test_recording_too_short_to_differentiate(rows: int) -> None:
    r = only(recording(), slice(0, rows))
    predicted = predict_torque(corrected(COULOMB, DELAY, PAYLOAD), r)
    assert predicted.shape == (rows, 3) and np.isfinite(predicted).all()


def test_all_rows_of_one_instant() -> None:
    r = only(recording(), np.zeros(5, dtype=int))
    predicted = predict_torque(corrected(DELAY), r)
    np.testing.assert_allclose(predicted, standing(corrected(), r.q), atol=1e-9)


def test_jittered_time_stamps() -> None:
    r = recording()
    t = r.t + np.random.default_rng(1).uniform(-0.3, 0.3, len(r.t)) / 250
    q = synthetic.motion(41, 0.2, 6.0).position(t)
    predicted = predict_torque(corrected(), Recording("jitter", t, q))
    expected = synthetic.needed(Truth(), synthetic.motion(41, 0.2, 6.0), t)
    error = low_pass(predicted - expected, 250.0, 12.0)[75:-75]
    assert np.isfinite(predicted).all()
    assert (np.sqrt((error**2).mean(axis=0)) < 0.08 * expected.std(axis=0)).all()
