"""Faults of references, velocities and gains, found in recordings of an arm under PD and put right.

The arm's motion and torque are given; the references are those under which a PD controller commands this torque:
T d(q_ref - q)/dt + (q_ref - q) = tau / kp with T = kd / kp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from cases import each
from sweeps import daily
from synthetic import Truth

from gapscope.arm.case import Case
from gapscope.arm.control import PD, feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.commanded_torque import with_commanded_torque
from gapscope.diagnosis.prepare import with_torque
from gapscope.diagnosis.setup_faults.references import find_reference_faults
from gapscope.effects.setup_faults import (
    CoarseReference,
    Fault,
    GainMismatch,
    IgnoredVelocityReference,
    SpeedScaling,
    UnmeasuredTorque,
    VelocityOfReference,
)

KP, KD = np.array([800.0, 900.0, 300.0]), np.array([60.0, 66.0, 22.0])
STEP = 1.0 / synthetic.RATE
ORDINARY = {
    "healthy": Truth(),
    "payload": Truth(mass=3.0, com=(0.1, 0.0, 0.0)),
    "friction": Truth(coulomb=(3.0, 3.0, 1.0), viscous=(2.0, 2.0, 1.0)),
    "delay": Truth(delay=(0.02, 0.02, 0.02)),
    "torque scale": Truth(scale=(0.3, -0.2, 0.2)),
}


@cache
def under_pd(label: str) -> Case:
    """A case with its references and controller; the torque recorded is the one commanded."""
    case = each(synthetic.case(ORDINARY[label], seed=3), _with_references)
    return replace(case, controller=PD(rate=synthetic.RATE, kp=KP, kd=KD))


def _with_references(recording: Recording) -> Recording:
    assert recording.tau is not None
    dq = np.gradient(recording.q, recording.t, axis=0)
    kept, target = np.exp(-STEP * KP / KD), recording.tau / KP
    error = np.array(target)
    for k in range(1, len(error)):
        error[k] = kept * error[k - 1] + (1 - kept) * target[k]
    rate = (target - error) * KP / KD
    tau = KP * error + KD * rate
    return replace(
        recording, dq=dq, tau=tau, q_ref=recording.q + error, dq_ref=dq + rate
    )


def with_fault(case: Case, fault: Fault) -> Case:
    return fault.in_case(case, np.random.default_rng(0), case.arm)


def without_torque(case: Case) -> Case:
    return each(case, lambda r: replace(r, tau=None))


@pytest.mark.parametrize("label", daily(ORDINARY, "healthy", "payload"))
@pytest.mark.parametrize("given", [lambda case: case, without_torque])
def test_a_right_set_up_has_no_fault(label: str, given: Callable[[Case], Case]) -> None:
    case = given(under_pd(label))
    same, found = find_reference_faults(case)
    assert found == () and same is case


def test_a_case_without_references_has_no_fault() -> None:
    case = synthetic.case(Truth(), seed=3)
    assert find_reference_faults(case) == (case, ())


def test_a_torque_that_is_its_law_to_the_last_digit_is_right() -> None:
    case = under_pd("payload")
    right, found, told = with_torque(case)
    assert right.controller == case.controller and (found, told) == ((), None)


Expected = tuple[Fault, str, dict[str, float]]
GAINS = {"kp_factor": 3.0, "kd_factor": 0.4}
FAULTS: dict[str, Expected] = {
    "velocity of the reference": (VelocityOfReference(), "", {}),
    "velocity reference ignored": (
        IgnoredVelocityReference(0.075),
        "",
        {"lead": 0.0745},
    ),
    "half speed": (SpeedScaling(0.5), "", {"factor": 0.5}),
    "nine tenths of the speed": (SpeedScaling(0.9), "", {"factor": 0.9}),
    "held at 50 Hz": (CoarseReference("held", 0.02), "held", {"period": 0.02}),
    "held at 10 Hz": (CoarseReference("held", 0.1), "held", {"period": 0.1}),
    "interpolated at 25 Hz": (
        *(CoarseReference("interpolated", 0.04), "interpolated"),
        {"period": 0.04},
    ),
    "gains of a firmware": (GainMismatch((3.0,), (0.4,)), "", GAINS),
    "computed with other gains": (
        *(UnmeasuredTorque((80.0,), (2.5,)), ""),
        {"kp": 80.0, "kd": 2.5},
    ),
}
DAILY = set(FAULTS) - {"nine tenths of the speed", "held at 10 Hz"}


@pytest.mark.parametrize("arm", daily(("healthy", "friction"), "healthy"))
@pytest.mark.parametrize("label", daily(FAULTS, *DAILY))
def test_faults_are_found_with_their_values(label: str, arm: str) -> None:
    fault, variant, values = FAULTS[label]
    _, (found,) = find_reference_faults(with_fault(under_pd(arm), fault))
    assert (found.name, found.variant) == (fault.name, variant)
    for name, value in values.items():
        np.testing.assert_allclose(found.fault.values()[name], value, rtol=0.03)


@pytest.mark.parametrize(
    ("fault", "tolerance"),
    [
        (IgnoredVelocityReference(0.075), 0.1),
        (SpeedScaling(0.5), 0.12),
        (CoarseReference("held", 0.02), 0.1),
        (GainMismatch((3.0,), (0.4,)), 0.05),
        (UnmeasuredTorque((80.0,), (2.5,)), 0.02),
    ],
)
def test_what_is_put_right_commands_the_torque_of_the_right_set_up(
    fault: Fault, tolerance: float
) -> None:
    """The law of the controller, worked out from references and gains as repaired, gives the true torque."""
    case = under_pd("healthy")
    repaired, _ = find_reference_faults(with_fault(case, fault))
    commanded = with_commanded_torque(without_torque(repaired))
    for right, given in zip(case.recordings, commanded.recordings, strict=True):
        assert right.tau is not None and given.tau is not None
        error = (given.tau - right.tau[: len(given.t)])[25:-25]
        most = tolerance * right.tau.std(axis=0)
        assert (np.median(np.abs(error), axis=0) < most).all()


def test_a_wrong_gravity_in_the_feedforward_does_not_pass_for_gains() -> None:
    """The case states gravity upside down; under a load position errors go with gravity, as if gains were larger."""
    case = under_pd("healthy")
    body = RigidBody(case.arm)

    def loaded(r: Recording) -> Recording:
        """The controller fed the right gravity forward; a load of a fifth of it is left to the tracking error."""
        still = np.zeros_like(r.q)
        load = 0.2 * body.inverse_dynamics(r.q, still, still)
        followed = _with_references(replace(r, tau=load))
        fed = body.inverse_dynamics(followed.q_ref, still, still)
        return replace(followed, tau=fed + load)

    controller = replace(case.controller, feedforward="gravity")
    turned = replace(case.arm, gravity=-case.arm.gravity)
    given = replace(each(case, loaded), controller=controller, arm=turned)
    assert find_reference_faults(given)[1] == ()


def test_gains_are_not_doubted_on_a_log_at_100_hz_of_a_fast_reference() -> None:
    """The feedforward is nearly all of the torque; what finite differences lose of its inertia is not the gains'."""
    case, t = under_pd("healthy"), np.arange(1000) / 100
    frequency = 2 * np.pi * np.array([6.8, 6.1, 7.2])
    size, slow = 0.02, np.sin(0.7 * t)[:, None]
    angle = t[:, None] * frequency
    q_ref = size * np.sin(angle) + slow
    dq_ref = size * frequency * np.cos(angle) + 0.7 * np.cos(0.7 * t)[:, None]
    ddq_ref = -size * frequency**2 * np.sin(angle) - 0.49 * slow
    # as a rotor that is heavier than stated leaves it
    error = 1e-4 * ddq_ref
    rate = 1e-4 * (-size * frequency**3 * np.cos(angle))
    body = RigidBody(case.arm)
    fed = feedforward(case.arm, body, "nominal", q_ref, dq_ref, ddq_ref)
    tau = fed + KP * error + KD * rate
    logged = Recording(
        "r", t, q_ref - error, tau, dq_ref - rate, q_ref=q_ref, dq_ref=dq_ref
    )
    controller = replace(case.controller, feedforward="nominal")
    given = replace(case, recordings=(logged,), controller=controller)
    assert find_reference_faults(given)[1] == ()


def test_steps_that_the_torque_follows_are_no_fault() -> None:
    def following(r: Recording) -> Recording:
        return replace(r, tau=KP * (r.q_ref - r.q) + KD * (r.dq_ref - r.dq))

    stepped = with_fault(under_pd("healthy"), CoarseReference("held", 0.04))
    _, found = find_reference_faults(each(stepped, following))
    assert "coarse_reference" not in {fault.name for fault in found}


def test_an_arm_led_by_hand_has_its_own_velocity() -> None:
    def led(r: Recording) -> Recording:
        dq = np.gradient(r.q, r.t, axis=0)
        return replace(r, dq=dq, q_ref=r.q, dq_ref=dq)

    assert find_reference_faults(each(synthetic.case(Truth(), 3), led))[1] == ()


def test_wrong_stamps_do_not_make_a_velocity_the_references() -> None:
    slower = each(under_pd("healthy"), lambda r: replace(r, t=1.3 * r.t))
    _, found = find_reference_faults(slower)
    assert "velocity_of_reference" not in {fault.name for fault in found}


def test_a_computed_torque_that_fits_the_motion_is_a_warning() -> None:
    case = replace(under_pd("healthy"), controller=None)
    same, found = find_reference_faults(case)
    assert found == ()
    (warning,) = same.warnings
    assert "kp 800, 900, 300 N m/rad" in warning and "not measured" in warning


def test_gains_of_a_computed_torque_that_does_not_fit_are_found_by_the_motion() -> None:
    """No controller is declared: the gains at work come from what the nominal arm needs."""
    case = replace(under_pd("healthy"), controller=None)
    fault = UnmeasuredTorque((800.0, 900.0, 300.0), (1.0, 1.0, 1.0))
    repaired, (found,) = find_reference_faults(with_fault(case, fault))
    assert found.name == "unmeasured_torque"
    assert found.fault.values()["kp_at_work"] == pytest.approx(KP, rel=0.1)
    assert found.fault.values()["kd_at_work"] == pytest.approx(KD, rel=0.2)
    for right, given in zip(case.recordings, repaired.recordings, strict=True):
        error = (given.tau - right.tau).std(axis=0)
        assert (error < 0.2 * right.tau.std(axis=0)).all()
