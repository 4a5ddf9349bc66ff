"""The torque gap against its definition written out: 12 Hz, order 4 and zero phase, 0.3 s, the 5 % rule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from scipy.signal import butter, sosfiltfilt
from synthetic import Truth

from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.environment import tilt
from gapscope.model.conditioning import Segment, condition, torque_scale
from gapscope.model.jacobian import Bodies, LinearisationPoint
from gapscope.model.readings import gravity_by_torque, turn_of_base
from gapscope.model.rows import Rows
from gapscope.model.terms import Terms
from gapscope.model.torque_gap import gap_on_rows, torque_gap


def segments(truth: synthetic.Truth, rate: float = 250.0) -> list[Segment]:
    return [
        s
        for r in synthetic.recordings(truth, duration=6.0, rate=rate)
        for s in condition(r, 0.4 * rate)
    ]


def by_hand(
    measured: np.ndarray, predicted: np.ndarray, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    sos = butter(4, min(12.0, 0.95 * rate / 2), output="sos", fs=rate)
    edge = round(0.3 * rate)
    return tuple(sosfiltfilt(sos, x, axis=0)[edge:-edge] for x in (measured, predicted))


def nrmse(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    deviation = np.std(measured, axis=0)
    rms = np.sqrt(np.mean((measured - predicted) ** 2, axis=0))
    return rms / np.maximum(deviation, 0.05 * deviation.max())


@pytest.mark.parametrize("rate", [250.0, 125.0, 20.0])
def test_definition(rate: float) -> None:
    """A gap of Coulomb friction and offset."""
    truth = synthetic.Truth(coulomb=(3.0, 0.0, 1.0), offset=(0.0, 4.0, 0.0))
    (segment, *_) = segments(truth, rate)
    nominal = CorrectedArm(synthetic.arm())
    found = torque_gap(nominal, synthetic.body(), [segment])
    assert segment.torque is not None
    predicted = nominal.predict(synthetic.body(), segment.motion)
    pair = by_hand(segment.torque, predicted, rate)
    np.testing.assert_allclose(found.nrmse, nrmse(*pair), rtol=1e-3)
    expected = np.sqrt(np.mean((pair[0] - pair[1]) ** 2, axis=0))
    np.testing.assert_allclose(found.rmse, expected, rtol=1e-3)


def test_five_percent_rule() -> None:
    """Standard deviations 10, 1 and 0.1: the last is raised to 0.5."""
    torque = np.tile([1.0, -1.0], 50)[:, None] * [10.0, 1.0, 0.1] + 7.0
    np.testing.assert_allclose(torque_scale(torque), [10.0, 1.0, 0.5])


def test_what_lies_above_12_hz_is_no_gap() -> None:
    """A torque of 5 N m at 40 Hz leaves nothing, one at 3 Hz leaves 5 / sqrt 2."""
    (segment, *_) = segments(synthetic.Truth())
    nominal, t = CorrectedArm(synthetic.arm()), segment.motion.t[:, None]
    predicted = nominal.predict(synthetic.body(), segment.motion)
    for frequency, rms in ((40.0, 0.0), (3.0, 5 / np.sqrt(2))):
        wave = [0, 5.0, 0] * np.sin(2 * np.pi * frequency * t)
        shaken = Segment("s", segment.motion, predicted + wave)
        found = torque_gap(nominal, synthetic.body(), [shaken])
        assert found.rmse[1] == pytest.approx(rms, abs=0.02 + 0.01 * rms)
        assert found.rmse[[0, 2]].max() < 1e-9


def test_several_segments_are_stacked_before_they_are_normalised() -> None:
    three = segments(synthetic.Truth(coulomb=(2.0, 2.0, 2.0)))
    nominal = CorrectedArm(synthetic.arm())
    parts = [torque_gap(nominal, synthetic.body(), [s]) for s in three]
    found = torque_gap(nominal, synthetic.body(), three)
    measured = np.vstack([p.measured for p in parts])
    np.testing.assert_array_equal(found.measured, measured)
    np.testing.assert_allclose(found.nrmse, nrmse(found.measured, found.predicted))
    np.testing.assert_array_equal(found.error, found.measured - found.predicted)


def test_a_limit_that_is_none_leaves_a_gap() -> None:
    """It cuts off what was recorded, and not what is needed: on rows as on all samples."""
    (one, *_) = synthetic.recordings(synthetic.Truth(), duration=6.0)
    rows, body = Rows.recorded([[one]]), synthetic.body()
    limit = np.quantile(np.abs(one.tau[:, 1]), [0.5])
    believed = AppliedEffect("torque_saturation", (2,), {"limit": limit})
    arm = CorrectedArm(synthetic.arm(), (believed,))
    found = np.sqrt((gap_on_rows(rows, arm, body) ** 2).mean(axis=0))
    expected = torque_gap(arm, body, condition(one)).rmse
    assert found[1] > 1.0
    np.testing.assert_allclose(found, expected, rtol=0.05, atol=0.01)


# Changes of a prediction, against predictions of the changed arms.


EFFECTS = {
    "viscous_friction": ((1, 3), {"coefficient": [2.0, 1.0]}),
    "coulomb_friction": ((2,), {"torque": [1.5]}),
    "actuator_delay": ((1, 2), {"delay": [0.004, 0.01]}),
    "actuator_lag": ((3,), {"time_constant": [0.02]}),
    "torque_scale": ((2,), {"scale": [0.1]}),
    "torque_ripple": ((1,), {"amplitude": [0.5], "cycles": [12.0], "phase": [0.3]}),
    "encoder_offset": ((2,), {"offset": [0.02]}),
}


def effect(name: str) -> AppliedEffect:
    joints, values = EFFECTS[name]
    arrays = {key: np.array(value) for key, value in values.items()}
    return AppliedEffect(name, joints, arrays)


ARM = CorrectedArm(synthetic.arm(), tuple(effect(name) for name in EFFECTS))


def test_arms_at_once_change_as_each_alone() -> None:
    """Arms of which some undo another way from the recorded torque to the joint."""
    body, recording = synthetic.body(), synthetic.recordings(Truth(), duration=4.0)[1]
    motion = condition(recording, 20.0)[0].motion
    segment = Segment("moved.csv", motion, None)
    terms = Terms(len(motion.q.T))
    theta = np.zeros(terms.size)
    at = LinearisationPoint.of(ARM, Bodies(body, segment), terms, theta)
    names = [name for name in EFFECTS if name != "encoder_offset"]
    others = (tuple(e for e in ARM.effects if e.name != name) for name in names)
    arms = [replace(ARM, effects=some) for some in others]
    changes = at.changes(arms)
    for change, arm in zip(np.moveaxis(changes, 1, 0), arms, strict=True):
        expected = arm.predict(body, motion) - ARM.predict(body, motion)
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(change, expected, atol=1e-9)


# Gravity as the torque shows it, and the turn of the base that gives it.


DOWN = np.array([0.0, 0.0, -9.81])


@pytest.mark.parametrize(
    ("found", "turn"),
    [
        (-DOWN, (np.pi, 0.0)),
        ([0.0, 9.81, 0.0], (-np.pi / 2, 0.0)),
        ([9.81 * np.sin(0.5), 0.0, -9.81 * np.cos(0.5)], (0.0, 0.5)),
        (0.7 * (tilt(2.0, -0.8).T @ DOWN), (2.0, -0.8)),
        # a vector of another size is no gravity, a small tilt no turn
        (0.0 * DOWN, None),
        (0.3 * DOWN, None),
        (3.0 * DOWN, None),
        (tilt(0.2, 0.2).T @ DOWN, None),
    ],
)
def test_turn_of_the_base_that_gives_a_direction_of_gravity(
    found: np.ndarray, turn: tuple[float, float] | None
) -> None:
    given = turn_of_base(DOWN, np.array(found))
    assert (given is None) == (turn is None)
    if given is not None and turn is not None:
        # roll counts within a turn
        assert np.cos(given[0] - turn[0]) == pytest.approx(1.0, abs=1e-6)
        assert given[1] == pytest.approx(turn[1], abs=1e-4)
    assert turn_of_base(np.zeros(3), np.array(found)) is None


def test_gravity_is_found_beside_friction_and_offset() -> None:
    rubs = {"coulomb": (3.0, 2.0, 1.0), "viscous": (2.0, 4.0, 1.0)}
    truth = Truth(tilt=(2.0, -0.8), offset=(5.0, -3.0, 1.0), **rubs)
    path, t = synthetic.motion(7, 0.3, 8.0), np.arange(0.0, 8.0, 0.02)
    q, dq, ddq = path.position(t), path.velocity(t), path.acceleration(t)
    body, arm = synthetic.body(), synthetic.arm()
    regressor = body.gravity_regressor(q)
    needed = synthetic.needed(truth, path, t) - arm.armature * ddq
    without_gravity = needed - body.inverse_dynamics(q, dq, ddq)
    without_gravity += regressor @ body.gravity
    found = gravity_by_torque(without_gravity, regressor, dq, np.ones(3))
    np.testing.assert_allclose(found, tilt(2.0, -0.8).T @ DOWN, atol=0.2)
