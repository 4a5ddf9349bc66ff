"""When a parameter changed, and by how much; and silence where nothing did."""

from dataclasses import replace

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.kalman.alarm import alarm
from gapscope.ident.kalman.change_hypothesis import (
    ChangeHypothesis,
    friction_hypothesis,
    payload_hypothesis,
)
from gapscope.ident.kalman.change_point import find_change
from gapscope.ident.kalman.change_scan import ChangeScan, ChangeSums
from gapscope.ident.kalman.recursive import Recursive
from gapscope.ident.kalman.whitening import white
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.linear_problem import Problem

SLOPE = ChangeHypothesis("slope", ("slope",), np.array([[1.0], [0.0]]))
LEVEL = ChangeHypothesis("level", ("level",), np.array([[0.0], [1.0]]))


def line(rng, count=300, step=0.0, colour=0.0):
    """Tau = 2 x + 1 + noise of deviation 0.1, coloured by an autoregression; the slope changes halfway."""
    x = rng.standard_normal(count)
    noise = 0.1 * np.sqrt(1 - colour**2) * rng.standard_normal(count)
    for k in range(1, count):
        noise[k] += colour * noise[k - 1]
    slope = 2.0 + step * (np.arange(count) > count // 2)
    W = np.stack([x, np.ones(count)], axis=1)[:, None, :]
    return Problem(
        W,
        (slope * x + 1 + noise)[:, None],
        ("slope", "level"),
        np.zeros(count, dtype=int),
        0.1,
    )


def times(problem):
    return problem.interval * np.arange(len(problem.torque))


def test_a_step_is_found_with_moment_size_and_what_changed():
    problem = line(np.random.default_rng(1), step=0.2)
    change = find_change(problem, times(problem), [LEVEL, SLOPE])
    assert change.hypothesis.name == "slope"
    assert change.time == pytest.approx(15.0, abs=0.5)
    assert change.interval[0] <= 15.0 + 0.1 and change.interval[1] >= 15.0 - 0.1
    assert abs(change.size[0] - 0.2) < 3 * change.deviation[0]
    assert change.deviation[0] == pytest.approx(2 * 0.1 / np.sqrt(300), rel=0.2)
    assert change.statistic > 1


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_false_alarms_stay_below_the_probability_asked_for(colour):
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(60):
        problem = line(rng, colour=colour)
        found += (
            find_change(problem, times(problem), [LEVEL, SLOPE], false_alarms=0.05)
            is not None
        )
    assert found <= 6


def test_whitened_noise_is_white():
    rng = np.random.default_rng(3)
    problem = line(rng, 3000, colour=0.8)
    residual = problem.residual(np.array([2.0, 1.0]))
    left = white(problem, residual).residual(np.array([2.0, 1.0]))[:, 0]
    assert np.std(left) == pytest.approx(1.0, abs=0.05)
    assert abs(np.mean(left[1:] * left[:-1])) < 0.05


def test_a_record_that_is_too_short_is_refused():
    problem = line(np.random.default_rng(4), count=8)
    with pytest.raises(InputError, match="too short"):
        find_change(problem, times(problem), [SLOPE])


def test_friction_of_a_joint_without_columns_is_refused(world):
    with pytest.raises(InputError, match="joint 9"):
        friction_hypothesis(world.base, 9)


@pytest.mark.parametrize("seed", range(3))
def test_a_payload_picked_up_is_found_within_half_a_second_and_a_tenth_of_its_mass(
    world, seed
):
    rng = np.random.default_rng(100 + seed)
    moment, mass = rng.uniform(2.5, 5.5), rng.uniform(0.5, 3.0)
    recording = world.recorded(seed, pickup=(moment, mass))
    problem, t = world.assembly([recording]), world.assembly.times(recording)
    hypotheses = [
        payload_hypothesis(world.base, 3),
        *(friction_hypothesis(world.base, j) for j in (1, 2, 3)),
    ]
    change = find_change(problem, t, hypotheses)
    assert change.hypothesis.name == "payload"
    assert change.time == pytest.approx(moment, abs=0.5)
    assert change.size[0] == pytest.approx(mass, rel=0.1)
    track = Recursive(0.1 * np.ones(3)).follow(problem, t)
    heard = alarm(track, hypotheses[0])
    assert moment - 0.1 < heard.time < moment + 1.5


@pytest.mark.parametrize("seed", range(3))
def test_no_change_no_alarm(world, seed):
    stribeck = AppliedEffect(
        "stribeck_friction", (2,), {"torque": [0.5], "velocity": [0.1]}
    )
    recording = world.recorded(10 + seed, effects=(stribeck,))
    problem, t = world.assembly([recording]), world.assembly.times(recording)
    payload = payload_hypothesis(world.base, 3)
    assert find_change(problem, t, [payload]) is None
    assert alarm(Recursive(0.1 * np.ones(3)).follow(problem, t), payload).time is None


def test_an_alarm_needs_a_record_longer_than_its_settling(world):
    recording = world.recorded(1, duration=3.0)
    track = Recursive(np.ones(3)).follow(
        world.assembly([recording]), world.assembly.times(recording)
    )
    with pytest.raises(InputError, match="ends before an alarm"):
        alarm(track, payload_hypothesis(world.base, 3), settle=5.0)


def friction_of_one_joint(rng, torque_of):
    """Viscous and Coulomb friction and an offset of one joint; ``torque_of(v, since)`` adds to 2 v + 3 sgn v."""
    count = 600
    v = np.sin(2 * np.pi * np.arange(count) / 47) * (1 + 0.3 * rng.random(count))
    W = np.stack([v, np.sign(v), np.ones(count)], axis=1)[:, None, :]
    since = np.arange(count) / count
    tau = (
        2 * v + 3 * np.sign(v) + torque_of(v, since) + 0.1 * rng.standard_normal(count)
    )
    return Problem(
        W, tau[:, None], ("b1", "c1", "o1"), np.zeros(count, dtype=int), 0.02
    )


@pytest.mark.parametrize(
    ("torque_of", "found"),
    [
        (lambda v, since: (since > 0.6) * np.sign(v), True),
        (lambda v, since: 1.5 * np.exp(-since / 0.3) * np.sign(v), False),
        (lambda v, since: (since > 0.6) * np.ones_like(v), False),
    ],
    ids=["step", "fades from the start", "offset"],
)
def test_friction_that_fades_or_an_offset_is_no_change_of_friction(torque_of, found):
    problem = friction_of_one_joint(np.random.default_rng(5), torque_of)
    base = BaseParameters(("b1", "c1", "o1"), np.arange(3), np.eye(3))
    change = find_change(problem, times(problem), [friction_hypothesis(base, 1)])
    assert (change is not None) == found
    if found:
        assert change.time == pytest.approx(0.6 * 12, abs=0.1)
        assert change.size[1] == pytest.approx(1.0, abs=0.1)


def test_of_two_overwhelming_hypotheses_the_likelier_one_is_taken():
    problem = line(np.random.default_rng(6), step=3.0)
    tilted = ChangeHypothesis("tilted", ("tilt",), np.array([[1.0], [0.6]]))
    change = find_change(problem, times(problem), [tilted, SLOPE])
    assert change.hypothesis.name == "slope"


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_rounding_is_no_change(seed):
    """Few rows before most moments, body columns that hardly differ: the gain is that of a direct fit, not more."""
    rng = np.random.default_rng(seed)
    k = np.arange(200)
    sign = np.where(k < 60, -1.0, np.sign(np.sin(0.2 * k)))
    speed = 0.06 * np.abs(1 + 0.3 * rng.standard_normal(200)) * sign
    motion = np.sin(0.1 * np.outer(k, [1.0, 1.7]))
    bodies = motion @ rng.standard_normal((2, 5))
    bodies += 3e-5 * rng.standard_normal((200, 5))
    W = 1e3 * np.column_stack([speed, sign, np.ones(200), bodies])
    W[:60] *= (k[:60] % 20 == 0)[:, None]
    torque = W @ rng.standard_normal(8) + rng.standard_normal(200)
    problem = Problem(W[:, None], torque[:, None], tuple("bco12345"), 0 * k, 0.05)
    D = np.eye(8)
    friction = ChangeHypothesis("friction", ("b", "c"), D[:, :2], beside=D[:, 2:3])
    scan = ChangeScan.over(ChangeSums.of(problem, k[5:-5]), friction)

    def left(columns):
        scaled = columns / np.linalg.norm(columns, axis=0)
        fit = np.linalg.lstsq(scaled, torque, rcond=None)[0]
        return np.sum((torque - scaled @ fit) ** 2)

    changed = np.column_stack([W, (k > scan.moment)[:, None] * W[:, :3]])
    assert scan.peak < left(W) - left(changed) + 1.0


def test_a_push_is_no_change_and_hides_none():
    """A constant for 2 s soon after the beginning, and a step that stays."""
    rng = np.random.default_rng(6)
    pushes = np.array([[0.0], [1.0]])
    problem = line(rng)
    k = np.arange(300)
    x = problem.matrix[:, 0, 0]
    pushed = replace(
        problem, torque=problem.torque + (0.4 * ((k >= 6) & (k < 26)))[:, None]
    )
    assert find_change(pushed, times(problem), [LEVEL]) is not None
    assert find_change(pushed, times(problem), [LEVEL], pushes=pushes) is None
    stepped = replace(problem, torque=problem.torque + (0.2 * x * (k > 150))[:, None])
    change = find_change(stepped, times(problem), [SLOPE], pushes=pushes)
    assert change is not None
    assert change.time == pytest.approx(15.0, abs=0.5)
    # of an hour, 12 s apart
    far = find_change(stepped, 120 * times(problem), [SLOPE], pushes=pushes)
    assert far is not None
