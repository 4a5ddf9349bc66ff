"""Estimators that simulate: what noise in the motion does to least squares, and how they fail."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import iiwa_of_three
from cases import swinging
from sweeps import daily

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.ident.estimators.linear import weighted_least_squares
from gapscope.ident.estimators.simulating import (
    closed_loop,
    direct_inverse,
    instrumental_variables,
    output_error,
)
from gapscope.ident.model.base_parameters import base_parameters, random_states
from gapscope.ident.samples import FrictionLaw, ModelColumns, Samples

SIMULATING = {
    "IDIM-IV": instrumental_variables,
    "DIDIM": direct_inverse,
    "output error": output_error,
}
CENTRE = np.array([0.0, 0.6, -1.2])
EFFECTS = (
    AppliedEffect("payload", (), {"mass": 2.0, "com": [0.03, 0.02, 0.1]}),
    AppliedEffect("viscous_friction", (1, 2, 3), {"coefficient": [1.5, -1.0, 0.8]}),
)


@pytest.fixture(scope="module")
def arm():
    """Three joints of the iiwa, with rotors and friction."""
    return iiwa_of_three()


@pytest.fixture(scope="module")
def world(arm):
    """Controller, model, base parameters and the true ones."""
    columns, law = ModelColumns(arm), FrictionLaw()
    states = random_states(columns.regressor, np.random.default_rng(0), 300)
    base = base_parameters(columns.matrix(states, law), columns.names(law))
    pi = columns.nominal(law)
    pi[:30] += CorrectedArm(arm, EFFECTS).inertial_increments(columns.body).ravel()
    pi[33:36] += [1.5, -1.0, 0.8]
    return position_controller(arm, CENTRE), columns, base, base.of(pi)


def recorded(arm, controller, seed, noise=0.0, torque_noise=0.0):
    rng = np.random.default_rng(seed)
    limits = {"speed": 1.5, "acceleration": 6.0, "frequency": 0.25}
    motion = swinging(arm, rng, CENTRE, duration=5.0, **limits)
    noise = {"encoder_step": 0.0, "encoder_noise": noise, "torque_noise": torque_noise}
    return record(arm, EFFECTS, motion, controller, duration=5.0, rng=rng, **noise)


def experiment(world, recordings, **other):
    controller, columns, base, _ = world
    law, arm = FrictionLaw(), columns.arm
    samples = Samples(columns, recordings, 25.0)
    problem = samples.problem(law, base.kept, base.kept_names)
    case = Case("c", Path(), arm, recordings, controller=controller)
    made = closed_loop(case, recordings, samples, base, problem)
    return replace(made, **({"prior": columns.nominal(law)} | other))


@pytest.fixture(scope="module")
def clean(arm, world):
    """Two recordings without noise, and their experiment."""
    return experiment(world, [recorded(arm, world[0], seed) for seed in (1, 2)])


@pytest.fixture(scope="module")
def noisy(arm, world):
    """The same with noise on the encoders that the controller feeds back."""
    made = [recorded(arm, world[0], seed, 1e-3, 0.02) for seed in (1, 2)]
    return experiment(world, made)


def miss(clean, beta, truth):
    """RMS of the torque that the error of the parameters makes, over that of the torque [1], shape (n,)."""
    problem = clean.build(clean.recordings)
    off = problem.matrix @ (beta - truth)
    return np.sqrt(np.mean(off**2, axis=0)) / problem.torque.std(axis=0)


def test_the_rolled_out_loop_repeats_a_recording_of_another_simulator(clean, world):
    (again, *_), recording = clean.simulate(world[3]), clean.recordings[0]
    error = np.abs(recording.q_ref - recording.q).max()
    assert np.abs(again.q - recording.q).max() < 0.15 * error
    left = np.sqrt(np.mean((again.tau - recording.tau) ** 2, axis=0))
    assert left.max() < 0.02 * recording.tau.std(axis=0).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", daily(SIMULATING, "output error"))
def test_parameters_are_recovered_from_a_clean_recording(clean, world, name):
    alone = experiment(world, clean.recordings[:1])
    problem = alone.build(alone.recordings)
    estimate = SIMULATING[name](problem, alone)
    assert estimate.warnings == () and tuple(estimate.names) == tuple(problem.names)
    assert (miss(clean, estimate.value, world[3]) < 0.02).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", daily(SIMULATING, "IDIM-IV", "DIDIM"))
def test_encoder_noise_that_biases_least_squares_does_not_bias_them(
    clean, noisy, world, name
):
    problem = noisy.build(noisy.recordings)
    plain = miss(clean, weighted_least_squares(problem).value, world[3])
    estimate = SIMULATING[name](problem, noisy)
    own = miss(clean, estimate.value, world[3])
    assert np.linalg.norm(own) < 0.6 * np.linalg.norm(plain)
    assert np.mean(np.abs(estimate.value - world[3]) < 3 * estimate.deviation) > 0.85


REFUSED = {
    "no reference": {"q_ref": None, "dq_ref": None},
    "known payload": {"payload": KnownLoad(1.0, (0.0, 0.0, 0.1))},
}


@pytest.mark.parametrize("why", REFUSED)
def test_a_recording_that_cannot_be_simulated_is_refused(clean, world, why):
    changed = replace(clean.recordings[0], **REFUSED[why])
    with pytest.raises(InputError, match=why):
        experiment(world, [changed])


def test_wrong_gains_are_named_with_the_factor(clean, world):
    controller = replace(world[0], kp=world[0].kp * [1, 0.5, 1])
    with pytest.raises(InputError, match="joint 2 fits kp times 2") as raised:
        experiment((controller, *world[1:]), clean.recordings)
    assert "gains" in str(raised.value)


def test_a_torque_that_the_controller_did_not_command_is_warned_of(clean, world):
    first = clean.recordings[0]
    wave = 30 * np.sin(7 * first.t)[:, None] * [0, 0, 1]
    found = experiment(world, [replace(first, tau=first.tau + wave)])
    assert any("joint 3" in x and "feedforward" in x for x in found.warnings)


@pytest.mark.parametrize("name", SIMULATING)
def test_an_arm_that_runs_away_ends_with_causes(clean, world, name):
    prior = world[1].nominal(FrictionLaw())
    prior[:30:10] *= 0.1
    prior[30:33] = -0.5
    started = experiment(world, clean.recordings, prior=prior)
    said = r"(?s)diverged in iteration 0.*\(a\).*\(b\).*\(c\)"
    with pytest.raises(GapscopeError, match=said):
        SIMULATING[name](started.build(started.recordings), started)
