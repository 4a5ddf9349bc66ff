"""Setup faults made in recordings."""

from collections.abc import Callable
from dataclasses import astuple, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.setup_faults import (
    FAULTS,
    CoarseReference,
    Fault,
    GainMismatch,
    GravityCompensatedTorque,
    IgnoredVelocityReference,
    JointSwap,
    LateTorque,
    SignFlip,
    SpeedScaling,
    TimeStamps,
    TorqueUnit,
    UnitMismatch,
    UnmeasuredTorque,
    VelocityOfReference,
    ZeroOffset,
)


@pytest.fixture
def recording() -> Recording:
    t = np.arange(0.0, 2.0, 0.004)
    q = np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    dq = np.gradient(q, t, axis=0)
    return Recording("r", t, q, 10 * q + [1.0, 2.0, 3.0], dq=dq, q_ref=1.01 * q)


@cache
def _arm() -> NominalArm:
    """An arm of three joints."""
    whole = load_nominal_arm("kuka_iiwa")
    return load_nominal_arm("kuka_iiwa", joints=whole.joints[:3])


def _apply(fault: Fault, recording: Recording) -> Recording:
    return fault.apply(recording, np.random.default_rng(0), _arm())


Change = Callable[[np.ndarray], np.ndarray]


def _times(*factors: float) -> Change:
    return lambda series: series * factors


def _swapped(series: np.ndarray) -> np.ndarray:
    return series[:, [2, 1, 0]]


def _further(series: np.ndarray) -> np.ndarray:
    return np.add(series, [0, np.pi / 2, 0])


NEGATED, GEARED = _times(1, -1, 1), _times(1, 50, 1)
DEGREES = _times(*[180 / np.pi] * 3)
MADE: list[tuple[Fault, dict[str, Change]]] = [
    (SignFlip((2,), "joint"), {"q": NEGATED, "dq": NEGATED, "q_ref": NEGATED, "tau": NEGATED}),
    (SignFlip((2,)), {"tau": NEGATED}),
    (JointSwap((1, 3)), {"tau": _swapped}),
    (JointSwap((1, 3), "joint"), {"q": _swapped, "q_ref": _swapped, "tau": _swapped}),
    (UnitMismatch("degrees"), {"q": DEGREES, "q_ref": DEGREES}),
    (UnitMismatch("milliseconds"), {"t": lambda t: 1e3 * t}),
    (UnitMismatch("motor_side", (2,), 50.0), {"q": GEARED, "q_ref": GEARED, "tau": _times(1, 0.02, 1)}),
    (TorqueUnit("current", factor=(12.0, 12.0, 8.0)), {"tau": _times(1 / 12, 1 / 12, 1 / 8)}),
    (TorqueUnit("command_scale", (1, 2), (0.25,)), {"tau": _times(4, 4, 1)}),
    (ZeroOffset((2,), np.pi / 2), {"q": _further, "q_ref": _further}),
]  # fmt: skip
"""Faults and what they make of channels."""


@pytest.mark.parametrize(("fault", "made"), MADE, ids=[str(fault) for fault, _ in MADE])
def test_what_a_fault_makes_of_channels(
    fault: Fault, made: dict[str, Change], recording: Recording
) -> None:
    """What it does not name stays as it is, torque sensors beside a torque in another unit too."""
    recording = replace(recording, tau_sensor=recording.tau)
    spoilt = _apply(fault, recording)
    for channel in ("t", "q", "dq", "q_ref", "tau"):
        series = getattr(recording, channel)
        expected = made[channel](series) if channel in made else series
        if not (channel == "dq" and fault.name in ("unit_mismatch", "joint_swap")):
            np.testing.assert_allclose(getattr(spoilt, channel), expected, rtol=1e-9)
    if fault.name == "torque_unit":
        np.testing.assert_array_equal(spoilt.tau_sensor, recording.tau)


def test_velocities_of_the_reference(recording: Recording) -> None:
    spoilt = _apply(VelocityOfReference(), recording)
    expected = np.gradient(recording.q_ref, recording.t, axis=0)
    np.testing.assert_allclose(spoilt.dq, expected, rtol=1e-9)
    assert (spoilt.q == recording.q).all() and (spoilt.tau == recording.tau).all()


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
    """The pendulum's gravity torque is -9.81 cos q N m."""
    q = np.linspace(-1.0, 1.0, 50)[:, None]
    right = Recording("r", np.arange(50) / 100, q, 2.0 * q)
    spoilt = GravityCompensatedTorque().apply(right, np.random.default_rng(0), pendulum)
    np.testing.assert_allclose(spoilt.tau, 2.0 * q + 9.81 * np.cos(q), rtol=1e-9)


def test_late_torque(recording: Recording) -> None:
    late = _apply(LateTorque("delay", 0.02), recording)
    np.testing.assert_allclose(late.tau[5:], recording.tau[:-5])
    # behind a low-pass of 20 ms a ramp of 1 N m/s is late by 20 ms less half a step, once it has started
    ramp = replace(recording, tau=np.tile(recording.t[:, None], 3))
    filtered = _apply(LateTorque("filter", 0.02), ramp)
    lateness = (ramp.tau - filtered.tau)[-1, 0]
    assert lateness == pytest.approx(0.018, abs=1e-4)


def test_an_ignored_velocity_leads_to_the_same_torque(recording: Recording) -> None:
    """kp (q_ref - q) + kd (dq_ref - dq) = kp (recorded q_ref - q) - kd dq with kd = 0.1 kp."""
    planned = replace(recording, dq_ref=1.01 * np.gradient(recording.q, 0.004, axis=0))
    spoilt = _apply(IgnoredVelocityReference(0.1), planned)
    used = planned.q_ref - planned.q + 0.1 * (planned.dq_ref - planned.dq)
    np.testing.assert_allclose(spoilt.q_ref - planned.q - 0.1 * planned.dq, used)


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
    before, after = recording.q_ref[[10, 15]]
    np.testing.assert_allclose(lines.q_ref[12], 0.6 * before + 0.4 * after)
    np.testing.assert_allclose(lines.dq_ref[12], (after - before) / 0.02)


def test_declared_gains_are_those_at_work_over_factors(recording: Recording) -> None:
    at_work = PD(rate=1000.0, kp=np.array([8.0, 4.0, 2.0]), kd=np.ones(3))
    case = Case("c", Path(), _arm(), (recording,), controller=at_work)
    rng, fault = np.random.default_rng(0), GainMismatch((4.0,), (0.5,), (2,))
    spoilt = fault.in_case(case, rng, case.arm)
    np.testing.assert_array_equal(spoilt.controller.kp, [8.0, 1.0, 2.0])
    np.testing.assert_array_equal(spoilt.controller.kd, [1.0, 2.0, 1.0])
    with pytest.raises(InputError, match="pd"):
        fault.in_case(replace(case, controller=None), rng, case.arm)


def test_a_torque_that_gains_gave(recording: Recording) -> None:
    computed = _apply(UnmeasuredTorque((80.0,), (2.5,), (1, 3)), recording)
    expected = 0.8 * recording.q + 0.025 * recording.dq
    np.testing.assert_allclose(computed.tau[:, [0, 2]], expected[:, [0, 2]], atol=1e-9)
    np.testing.assert_array_equal(computed.tau[:, 1], recording.tau[:, 1])


@pytest.mark.parametrize("fault", [VelocityOfReference(), SpeedScaling(0.5)])
def test_faults_of_references_need_them(recording: Recording, fault: Fault) -> None:
    with pytest.raises(InputError, match="q_ref"):
        _apply(fault, replace(recording, q_ref=None))


IMPOSSIBLE = [
    (lambda: SignFlip((9,)), "sign_flip"),
    (lambda: JointSwap((0, 1)), "joint_swap"),
    (lambda: JointSwap((2, 2)), "joint_swap"),
    (lambda: TorqueUnit("current", (4,)), "torque_unit"),
    (lambda: SignFlip((1,), "torqe"), "sign_flip"),
    (lambda: UnitMismatch("inches"), "unit_mismatch"),
    (lambda: UnitMismatch("motor_side", ratio=0.0), "unit_mismatch.ratio"),
    (lambda: ZeroOffset((1,), 90.0), "zero_offset.offset"),
    (lambda: TimeStamps("lost", 0.1), "time_stamps"),
    (lambda: TimeStamps("jitter", float("nan")), "time_stamps.amount"),
    (lambda: TorqueUnit("current", factor=(1.0, 0.0)), "torque_unit.factor"),
    (lambda: LateTorque("delay", -0.01), "late_torque.delay"),
    (lambda: CoarseReference("held", 0.004), "coarse_reference.period"),
]
"""Faults of joints, variants and values that cannot be, and what their errors name."""


@pytest.mark.parametrize(("fault", "where"), IMPOSSIBLE)
def test_what_cannot_be_is_refused(
    fault: Callable[[], Fault], where: str, recording: Recording
) -> None:
    with pytest.raises(InputError) as caught:
        _apply(fault(), recording)
    assert caught.value.where == where
    # of two joints the message itself says what is expected
    assert caught.value.remedy or "expected two joints" in str(caught.value)


REFERENCES = Path(__file__).parents[2] / "docs" / "references.md"


@pytest.mark.parametrize("kind", FAULTS.values(), ids=FAULTS)
def test_contract_of_every_fault(kind: type[Fault]) -> None:
    """Described, with typical values within the bounds."""
    assert kind.scope in ("joint", "arm") and kind.looks_like
    assert f"**{kind.reference}**" in REFERENCES.read_text(encoding="utf-8")
    for parameter in kind.parameters:
        (least, most), (low, high) = parameter.bounds, parameter.typical
        assert parameter.unit and least <= low < high <= most


JOINTS = {"sign_flip": (2,), "joint_swap": (1, 2), "zero_offset": (2,)}
"""Joints of faults that have to name some."""


def _examples(kind: type[Fault]) -> list[Fault]:
    """A fault of a kind of every variant, with values as real set-ups have them."""
    values = {p.name: float(np.dot(p.typical, (0.3, 0.7))) for p in kind.parameters}
    values |= {n: x for n, x in {"by": 1, "amount": 1.005}.items() if n in values}
    if kind.name in JOINTS:
        values["joints"] = JOINTS[kind.name]
    variants = [{"variant": name} for name in kind.variants] or [{}]
    return [kind(**variant, **values) for variant in variants]


LOST = {
    *(("time_stamps", variant) for variant in ("gaps", "repeats", "jitter")),
    ("late_torque", "filter"),
    *(("coarse_reference", variant) for variant in CoarseReference.variants),
    *((kind.name, "") for kind in (UnmeasuredTorque, VelocityOfReference)),
    ("ignored_velocity_reference", ""),
}
"""Faults that lose what no reading brings back, or not all of it."""


@pytest.mark.parametrize("kind", FAULTS.values(), ids=FAULTS)
def test_the_reading_of_a_fault_puts_right_what_the_fault_has_made(
    kind: type[Fault], recording: Recording
) -> None:
    """Every channel of every row that is left, the arm's inertials and the controller's gains."""
    gains = PD(rate=1000.0, kp=np.full(3, 8.0), kd=np.ones(3))
    more = {"dq_ref": 1.01 * recording.dq, "tau_sensor": recording.tau - 1.0}
    planned = replace(recording, **more)
    case = Case("c", Path(), _arm(), (planned,), controller=gains)
    for fault in _examples(kind):
        spoilt = fault.in_case(case, np.random.default_rng(0), case.arm)
        reading = fault.reading(3)
        assert _numbers(spoilt) != _numbers(case)
        if fault.kind[:2] in LOST:
            continue
        right = replace(
            spoilt,
            arm=reading.arm(spoilt.arm),
            recordings=tuple(reading(r, case.arm) for r in spoilt.recordings),
            controller=reading.controller(spoilt.controller),
        )
        (read,) = right.recordings
        assert len(read.t) > 0.3 * len(planned.t)
        rows = np.searchsorted(planned.t, read.t - 1e-6)
        # lines between samples cut corners: where a late torque begins, and a reference comes to rest
        late = reading.differs("torque_delay", "torque_drift", "pace")
        inner, slack = (slice(-3), 0.05) if late else (slice(None), 1e-9)
        for channel, series in read.channels.items():
            expected = getattr(planned, channel)[rows]
            np.testing.assert_allclose(series[inner], expected[inner], atol=slack)
        back, before = (_numbers(replace(x, recordings=())) for x in (right, case))
        assert back == pytest.approx(before)


def _numbers(case: Case) -> list[float]:
    """What the faults may change of a case: series, inertials, gains."""
    series = [x for r in case.recordings for x in (r.t, *r.channels.values())]
    inertials = RigidBody(case.arm).inertial_parameters()
    numbers = (*series, inertials, case.controller.kp, case.controller.kd)
    return np.concatenate([x.ravel() for x in numbers]).tolist()


def _flat(reading: Reading) -> list[float]:
    """All numbers of a reading."""
    return np.concatenate([np.ravel(x) for x in _leaves(astuple(reading))]).tolist()


def _leaves(values: tuple[object, ...]) -> list[object]:
    nested = [_leaves(x) if isinstance(x, tuple) else [x] for x in values]
    return [leaf for leaves in nested for leaf in leaves]


@pytest.mark.parametrize("kind", FAULTS.values(), ids=FAULTS)
def test_readings_of_faults_compose_invert_and_are_written(kind: type[Fault]) -> None:
    others = [fault for other in FAULTS.values() for fault in _examples(other)]
    last = JointSwap((1, 3), "joint").reading(3)
    for fault in _examples(kind):
        reading = fault.reading(3)
        assert hash(reading) == hash(fault.reading(3))
        for other in others:
            between = other.reading(3)
            together = reading.then(between).then(last)
            apart = reading.then(between.then(last))
            assert _flat(together) == pytest.approx(_flat(apart))
        if fault.kind[:2] not in LOST:
            back = reading.inverse()
            assert _flat(back.inverse()) == pytest.approx(_flat(reading))
            none = replace(reading.then(back), moved_only=False)
            assert _flat(none) == pytest.approx(_flat(Reading.identity(3)))
        written = yaml.safe_load(yaml.safe_dump(reading.to_mend()))
        restored = Reading.from_mend(written, 3)
        for name in SAID:
            assert getattr(restored, name) == getattr(reading, name)


SAID = [
    "motion",
    "torque",
    "sensor",
    "time_factor",
    "torque_delay",
    "gravity",
    "lead",
    "pace",
]
"""What ``mend:`` can say of a reading."""
