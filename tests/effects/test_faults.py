"""Setup faults made in recordings."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.control.pd import PD
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.arm.torque_column import advanced, with_gravity
from gapscope.effects.setup_faults.channel_faults import (
    JointSwap,
    SignFlip,
    UnitMismatch,
)
from gapscope.effects.setup_faults.controller_faults import (
    GainMismatch,
    UnmeasuredTorque,
)
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.fault_catalogue import FAULTS
from gapscope.effects.setup_faults.inertial_fault import ShiftedInertials
from gapscope.effects.setup_faults.reference_faults import (
    CoarseReference,
    IgnoredVelocityReference,
    SpeedScaling,
    VelocityOfReference,
)
from gapscope.effects.setup_faults.time_stamp_fault import TimeStamps
from gapscope.effects.setup_faults.torque_faults import (
    GravityCompensatedTorque,
    LateTorque,
    TorqueUnit,
)
from gapscope.effects.setup_faults.zero_fault import ZeroOffset


@pytest.fixture
def recording() -> Recording:
    t = np.arange(0.0, 2.0, 0.004)
    q = np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    return Recording(
        "r",
        t,
        q,
        10 * q + [1.0, 2.0, 3.0],
        dq=np.gradient(q, t, axis=0),
        q_ref=1.01 * q,
    )


@cache
def _arm() -> NominalArm:
    """An arm of three joints."""
    whole = load_nominal_arm("kuka_iiwa")
    return load_nominal_arm("kuka_iiwa", joints=whole.joints[:3])


def _apply(fault: Fault, recording: Recording) -> Recording:
    return fault.apply(recording, np.random.default_rng(0), _arm())


def test_sign_flip(recording: Recording) -> None:
    flipped = _apply(SignFlip((2,), "joint"), recording)
    for channel in ("q", "dq", "tau", "q_ref"):
        np.testing.assert_array_equal(
            getattr(flipped, channel), getattr(recording, channel) * [1, -1, 1]
        )
    np.testing.assert_array_equal(_apply(SignFlip((2,)), recording).q, recording.q)


def test_joint_swap(recording: Recording) -> None:
    np.testing.assert_array_equal(
        _apply(JointSwap((1, 3)), recording).tau, recording.tau[:, [2, 1, 0]]
    )
    np.testing.assert_array_equal(
        _apply(JointSwap((1, 3), "joint"), recording).q, recording.q[:, [2, 1, 0]]
    )


def test_units(recording: Recording) -> None:
    np.testing.assert_allclose(
        _apply(UnitMismatch("degrees"), recording).q, np.rad2deg(recording.q)
    )
    assert _apply(UnitMismatch("milliseconds"), recording).t[-1] == pytest.approx(
        1996.0
    )
    motor = _apply(UnitMismatch("motor_side", (2,), 50.0), recording)
    np.testing.assert_allclose(motor.q, recording.q * [1, 50, 1])
    np.testing.assert_allclose(motor.tau, recording.tau / [1, 50, 1])


def test_time_stamps(recording: Recording) -> None:
    assert _apply(TimeStamps("wrong_rate", 0.5), recording).rate == pytest.approx(500.0)
    jitter = np.diff(_apply(TimeStamps("jitter", 0.2), recording).t)
    assert jitter.min() > 0 and jitter.std() > 0.0005
    gaps = np.diff(_apply(TimeStamps("gaps", 0.1), recording).t)
    assert gaps.max() > 0.05
    twice = _apply(TimeStamps("repeats", 0.05), recording)
    assert (np.diff(twice.q, axis=0) == 0).all(axis=1).sum() == 25
    np.testing.assert_array_equal(twice.t, recording.t)
    ramp = replace(recording, tau=np.tile(recording.t[:, None], 3))
    slow = _apply(TimeStamps("torque_clock", 1.01), ramp)
    np.testing.assert_allclose(slow.tau[:, 0], slow.t / 1.01)


def test_gravity_left_out_of_a_pendulums_torque(pendulum: NominalArm) -> None:
    """The pendulum's gravity torque is -9.81 cos q N m; putting it back gives the recording."""
    q = np.linspace(-1.0, 1.0, 50)[:, None]
    right = Recording("r", np.arange(50) / 100, q, 2.0 * q)
    spoilt = GravityCompensatedTorque().apply(right, np.random.default_rng(0), pendulum)
    np.testing.assert_allclose(spoilt.tau, 2.0 * q + 9.81 * np.cos(q), rtol=1e-9)
    np.testing.assert_allclose(with_gravity(spoilt, pendulum).tau, right.tau)


def test_current_in_place_of_torque(recording: Recording) -> None:
    sensed = replace(recording, tau_sensor=recording.tau)
    amperes = _apply(TorqueUnit("current", factor=(12.0, 12.0, 8.0)), sensed)
    np.testing.assert_allclose(amperes.tau, recording.tau / [12.0, 12.0, 8.0])
    np.testing.assert_array_equal(amperes.tau_sensor, recording.tau)
    commands = _apply(TorqueUnit("command_scale", (1, 2), (0.25,)), recording)
    np.testing.assert_allclose(commands.tau, recording.tau * [4.0, 4.0, 1.0])


def test_late_torque(recording: Recording) -> None:
    late = _apply(LateTorque("delay", 0.02), recording)
    np.testing.assert_allclose(late.tau[5:], recording.tau[:-5])
    # behind a low-pass of 20 ms a ramp of 1 N m/s is late by 20 ms less half a step, once it has started
    ramp = replace(recording, tau=np.tile(recording.t[:, None], 3))
    filtered = _apply(LateTorque("filter", 0.02), ramp)
    lateness = (ramp.tau - filtered.tau)[-1, 0]
    assert lateness == pytest.approx(0.018, abs=1e-4)


def test_late_torque_is_put_right_but_for_its_end_and_the_rows_before_a_gap(
    recording: Recording,
) -> None:
    late = _apply(LateTorque("delay", 0.02), recording)
    right = advanced(late, 0.02)
    np.testing.assert_array_equal(right.t, recording.t[:-5])
    np.testing.assert_allclose(right.tau, recording.tau[:-5], atol=1e-6)
    kept = np.r_[0:200, 300:500]
    gap = advanced(late.part(kept), 0.02)
    np.testing.assert_array_equal(gap.t, recording.t[np.r_[0:195, 300:495]])
    with pytest.raises(InputError, match="delay"):
        advanced(recording, 5.0)


def test_zero_offset_moves_positions_and_references_alone(recording: Recording) -> None:
    moved = _apply(ZeroOffset((2,), np.pi / 2), recording)
    for channel in ("q", "q_ref"):
        added = getattr(moved, channel) - getattr(recording, channel)
        np.testing.assert_allclose(added, [[0.0, np.pi / 2, 0.0]] * len(added))
    for channel in ("dq", "tau"):
        np.testing.assert_array_equal(
            getattr(moved, channel), getattr(recording, channel)
        )


def test_an_ignored_velocity_reference_leads_to_the_same_torque(
    recording: Recording,
) -> None:
    """kp (q_ref - q) + kd (dq_ref - dq) = kp (recorded q_ref - q) - kd dq with kd = 0.1 kp."""
    planned = replace(recording, dq_ref=1.01 * np.gradient(recording.q, 0.004, axis=0))
    spoilt = _apply(IgnoredVelocityReference(0.1), planned)
    used = planned.q_ref - planned.q + 0.1 * (planned.dq_ref - planned.dq)
    np.testing.assert_allclose(spoilt.q_ref - planned.q - 0.1 * planned.dq, used)


def test_the_references_velocity_in_place_of_the_arms(recording: Recording) -> None:
    spoilt = _apply(VelocityOfReference(), recording)
    np.testing.assert_allclose(spoilt.dq, 1.01 * recording.dq)


def test_a_reference_at_twice_the_arms_pace(recording: Recording) -> None:
    """It ends in the middle of the recording and rests."""
    spoilt = _apply(SpeedScaling(0.5), recording)
    np.testing.assert_allclose(spoilt.q_ref[:250], recording.q_ref[:500:2], atol=1e-9)
    assert (spoilt.q_ref[250:] == recording.q_ref[-1]).all()
    assert (spoilt.dq_ref[251:] == 0).all()


def test_coarse_references(recording: Recording) -> None:
    held = _apply(CoarseReference("held", 0.02), recording)
    np.testing.assert_array_equal(held.q_ref[10:15], recording.q_ref[[10] * 5])
    lines = _apply(CoarseReference("interpolated", 0.02), recording)
    np.testing.assert_allclose(
        lines.q_ref[12], 0.6 * recording.q_ref[10] + 0.4 * recording.q_ref[15]
    )
    np.testing.assert_allclose(
        lines.dq_ref[12], (recording.q_ref[15] - recording.q_ref[10]) / 0.02
    )
    with pytest.raises(InputError, match="period"):
        _apply(CoarseReference("held", 0.004), recording)


def test_gains_declared_are_those_at_work_over_the_factors(
    recording: Recording,
) -> None:
    at_work = PD(rate=1000.0, kp=np.array([8.0, 4.0]), kd=np.array([2.0, 1.0]))
    declared = GainMismatch((4.0,), (0.5,), (2,)).declared(at_work)
    assert isinstance(declared, PD)
    np.testing.assert_array_equal(declared.kp, [8.0, 1.0])
    np.testing.assert_array_equal(declared.kd, [2.0, 2.0])
    with pytest.raises(InputError, match="pd"):
        GainMismatch((4.0,), (0.5,)).declared(None)


def test_a_torque_that_gains_gave(recording: Recording) -> None:
    computed = _apply(UnmeasuredTorque((80.0,), (2.5,), (1, 3)), recording)
    expected = 0.8 * recording.q + 0.025 * recording.dq
    np.testing.assert_allclose(computed.tau[:, [0, 2]], expected[:, [0, 2]], atol=1e-9)
    np.testing.assert_array_equal(computed.tau[:, 1], recording.tau[:, 1])


@pytest.mark.parametrize("fault", [VelocityOfReference(), SpeedScaling(0.5)])
def test_faults_of_references_need_references(
    recording: Recording, fault: Fault
) -> None:
    with pytest.raises(InputError, match="q_ref"):
        _apply(fault, replace(recording, q_ref=None))


def test_shifted_inertials() -> None:
    links = "".join(
        f'<link name="l{i}"><inertial><mass value="{i}"/></inertial></link>'
        for i in range(1, 4)
    )
    text = ShiftedInertials().urdf(
        f'<robot name="r"><link name="base"/>{links}</robot>'
    )
    masses = {
        link.get("name"): link.find("inertial/mass")
        for link in ET.fromstring(text).iter("link")
    }
    values = {
        name: mass.get("value") for name, mass in masses.items() if mass is not None
    }
    assert values == {"l1": "3", "l2": "1", "l3": "2"}


@pytest.mark.parametrize(
    "fault",
    [
        SignFlip((9,)),
        JointSwap((0, 1)),
        JointSwap((2, 2)),
        TorqueUnit("current", (4,)),
    ],
)
def test_joints_that_cannot_be_are_refused(recording: Recording, fault: Fault) -> None:
    with pytest.raises(InputError) as caught:
        _apply(fault, recording)
    assert caught.value.where == fault.name


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda: SignFlip((1,), "torqe"), "sign_flip"),
        (lambda: UnitMismatch("inches"), "unit_mismatch"),
        (lambda: UnitMismatch("motor_side", ratio=0.0), "unit_mismatch.ratio"),
        (lambda: ZeroOffset((1,), 90.0), "zero_offset.offset"),
        (lambda: TimeStamps("lost", 0.1), "time_stamps"),
        (lambda: TimeStamps("jitter", float("nan")), "time_stamps.amount"),
        (lambda: TorqueUnit("current", factor=(1.0, 0.0)), "torque_unit.factor"),
        (lambda: LateTorque("delay", -0.01), "late_torque.delay"),
    ],
)
def test_variants_and_values_that_cannot_be_are_refused(
    make: Callable[[], Fault], where: str
) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.remedy and caught.value.where == where


def test_names() -> None:
    assert set(FAULTS) == {
        "sign_flip",
        "joint_swap",
        "unit_mismatch",
        "shifted_inertials",
        "time_stamps",
        "gravity_compensated_torque",
        "torque_unit",
        "late_torque",
        "zero_offset",
        "ignored_velocity_reference",
        "velocity_of_reference",
        "speed_scaling",
        "coarse_reference",
        "gain_mismatch",
        "unmeasured_torque",
    }


@pytest.mark.parametrize("kind", FAULTS.values(), ids=FAULTS)
def test_contract_of_every_fault(kind: type[Fault], recording: Recording) -> None:
    """Described, with typical values within the bounds, drawn alike from one seed, and seen in recording or URDF."""
    assert kind.scope in ("joint", "arm") and kind.looks_like
    assert f"**{kind.reference}**" in (
        Path(__file__).parents[2] / "docs" / "references.md"
    ).read_text(encoding="utf-8")
    for parameter in kind.parameters:
        assert (
            parameter.unit
            and parameter.bounds[0]
            <= parameter.typical[0]
            < parameter.typical[1]
            <= parameter.bounds[1]
        )
    for seed in range(20):
        drawn, again = (kind.draw(np.random.default_rng(seed), 3) for _ in range(2))
        assert drawn == again
        if not isinstance(drawn, (ShiftedInertials, GainMismatch)):
            spoiled = _apply(drawn, recording)
            names = ("t", "q", "dq", "tau", "q_ref")
            assert any(
                not np.array_equal(getattr(spoiled, x), getattr(recording, x))
                for x in names
            )
    drawn = {kind.draw(np.random.default_rng(seed), 3) for seed in range(60)}
    assert {getattr(x, "variant", "") for x in drawn} == set(kind.variants or ("",))
