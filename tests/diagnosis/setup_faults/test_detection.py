"""Setup faults are found in recordings that have them, whatever else the arm has; ordinary effects are none."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic
from cases import each
from fault_examples import FAULTS, found_as
from sweeps import daily
from synthetic import Truth

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.motions.trajectory import Fourier
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.fault_search import looks_late
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.setup_faults import (
    Fault,
    LateTorque,
    SignFlip,
    TimeStamps,
    TorqueUnit,
    UnitMismatch,
)
from gapscope.envs.mystery_arm import HIDDEN, iiwa
from gapscope.envs.randomisation import Randomisation, draw_effects
from gapscope.envs.recorder import Plan, record_case

ORDINARY = {
    "healthy": Truth(),
    "large payload": Truth(mass=10.0, com=(0.2, 0.03, 0.05)),
    "torque read 40 % high": Truth(scale=(-0.29, 0.0, -0.29)),
    "torque read 40 % low": Truth(scale=(0.67, 0.67, 0.0)),
    "triple Coulomb friction": Truth(coulomb=(4.0, 6.0, 2.0)),
    "triple viscous friction": Truth(viscous=(4.0, 6.0, 2.0)),
    "no friction": Truth(coulomb=(-2.0, -3.0, -1.0), viscous=(-2.0, -3.0, -1.0)),
    "load friction": Truth(load=(0.3, 0.3, 0.3)),
    "encoder offsets of 5 degrees": Truth(encoder=(0.0, 0.087, -0.087)),
    "torque offsets": Truth(offset=(5.0, -8.0, 3.0)),
    "rotor twice as heavy": Truth(armature=(1.0, 1.0, 0.4)),
    "rotor 25 times as heavy as its link": Truth(armature=(0.0, 0.0, 10.0)),
    "delay": Truth(delay=(0.05, 0.05, 0.05)),
    "several at once": Truth(
        mass=3.0, com=(0.1, 0.0, 0.0), scale=(0.0, 0.2, 0.0), coulomb=(2.0, 0.0, 1.0)
    ),
    "beyond the catalogue": Truth(
        extra=lambda t, q, dq: np.outer(np.sin(40.0 * t), [6.0, 6.0, 1.8])
    ),
}

NIGHTLY = {
    *("on a wall", "torque read 40 % high", "torque read 40 % low", "no friction"),
    *("triple viscous friction", "load friction", "torque offsets", "jitter"),
    *("rotor twice as heavy", "beyond the catalogue", "a load far off the axis"),
    *("torque of the last joint turned", "torques turned", "all torques turned"),
    *("joint turned", "joints exchanged", "degrees", "revolutions", "motor side"),
    *("inertials shifted back", "zero off by 60 degrees", "a command times four"),
}
"""More of what others of the lists have: another joint, another size, another cause that looks alike."""


def labels(of: Iterable[str]) -> list[Any]:
    """The labels, those that are asked every night marked."""
    return daily(of, *(label for label in of if label not in NIGHTLY))


@cache
def sound(label: str) -> Case:
    """A case without a setup fault."""
    return synthetic.case(ORDINARY[label], seed=3)


def spoilt(case: Case, fault: Fault) -> Case:
    """The case as a set-up with the fault would have recorded it."""
    return fault.in_case(case, np.random.default_rng(0), case.arm)


def without_friction() -> Case:
    """Unknown friction in the data sheet."""
    case, zeros = sound("healthy"), np.zeros(synthetic.N)
    return replace(case, arm=replace(case.arm, coulomb=zeros, viscous=zeros))


def poor_inertials() -> Case:
    """A heavier link, and another whose centre lies 2 cm off."""
    case = sound("healthy")
    urdf = case.arm.urdf.with_name("poor.urdf")
    text = synthetic.URDF.replace('mass value="5"', 'mass value="5.6"')
    urdf.write_text(text.replace('"0.15 0.03', '"0.13 0.03'))
    return replace(case, arm=replace(case.arm, urdf=urdf))


def taken_unevenly() -> Case:
    """Samples taken at uneven times and stamped rightly."""
    truth, rng, recordings = Truth(), np.random.default_rng(0), []
    for k, recording in enumerate(synthetic.recordings(truth, 3)):
        jitter = np.clip(rng.standard_normal(len(recording.t)), -3, 3)
        t = recording.t + 0.15 / synthetic.RATE * jitter
        path = synthetic.motion(30 + k, (0.1, 0.2, 0.3)[k], 8.0)
        tau = synthetic.needed(truth, path, t)
        recordings.append(replace(recording, t=t, q=path.position(t), tau=tau))
    return replace(sound("healthy"), recordings=tuple(recordings))


def load_off_the_axis() -> Case:
    """Load, torque constant and dry friction made right inertials look extraordinary."""
    rng, arm = np.random.default_rng((16, 0, 5)), iiwa()
    drawn = Randomisation(HIDDEN, count=(3, 3), severity=(1.5, 1.5))
    effects = draw_effects(rng, arm, drawn, ArmScale.of(arm))
    assert {e.name for e in effects} == {"coulomb_friction", "payload", "torque_scale"}
    return record_case("loaded", arm, effects, Plan(), rng)


def moving(change: Callable[[Fourier], Fourier]) -> Case:
    """The sound arm with its motions changed."""
    rng, motions = np.random.default_rng(3), (synthetic.motion(k) for k in range(3))
    recordings = tuple(
        synthetic.recording(Truth(), change(motion), rng, f"recording_{k}.csv")
        for k, motion in enumerate(motions)
    )
    return replace(sound("healthy"), recordings=recordings)


def moving_little() -> Case:
    """A twentieth of its motion: the torque is nearly all friction."""
    return moving(lambda x: replace(x, sine=0.05 * x.sine, cosine=0.05 * x.cosine))


def two_at_rest() -> Case:
    """Two joints rest, and dry friction takes what the third one's motion asks of them."""
    case = moving(lambda x: synthetic.held(synthetic.held(x, 1), 2))
    stuck = []
    for one in case.recordings:
        asked = one.tau - one.tau.mean(axis=0)
        taken = np.clip(asked, -case.arm.coulomb, case.arm.coulomb)
        stuck.append(replace(one, tau=one.tau - taken * [1, 1, 0]))
    return replace(case, recordings=tuple(stuck))


NO_FAULT: dict[str, Callable[[], Case]] = {
    **{label: partial(sound, label) for label in ORDINARY},
    "friction unknown": without_friction,
    "inertials off": poor_inertials,
    # gravity turned looks like all torques turned, but friction then keeps its sign
    "hung": lambda: synthetic.case(Truth(tilt=(np.pi, 0.0)), seed=3),
    "on a wall": lambda: synthetic.case(Truth(tilt=(np.pi / 2, 0.0)), seed=3),
    "uneven samples": taken_unevenly,
    "a load far off the axis": load_off_the_axis,
    "little motion": moving_little,
    "two joints at rest": two_at_rest,
}


@pytest.mark.parametrize("label", labels(NO_FAULT))
def test_a_right_set_up_has_no_fault(label: str) -> None:
    assert find_setup_faults(NO_FAULT[label]()) == ()


def test_what_friction_holds_is_not_unexplained() -> None:
    assert diagnose(two_at_rest()).document["verdict"] == "no_gap"


@pytest.mark.parametrize("placeholder", daily((0.0, 20.0), 20.0))
def test_all_torques_turned_are_found_whatever_friction_the_data_sheet_claims(
    placeholder: float,
) -> None:
    case = sound("healthy")
    coulomb, viscous = (
        case.arm.coulomb + placeholder / 4,
        case.arm.viscous + placeholder,
    )
    arm = replace(case.arm, coulomb=coulomb, viscous=viscous)
    claimed = replace(case, arm=arm)
    assert find_setup_faults(claimed) == ()
    found = found_in(SignFlip((1, 2, 3)), claimed)
    assert found.fault == SignFlip((1, 2, 3))
    # an arm that hangs is the alternative, and a bad one where friction shows
    assert sum(p for other, p in found.others if other.name == "base_tilt") < 0.05


@pytest.mark.parametrize("roll", daily((1.0, np.pi / 2, 2.5, np.pi), np.pi / 2))
def test_all_torques_turned_are_found_on_a_base_that_is_turned(roll: float) -> None:
    """Neither shows without the other: gravity is the same if both are the other way round."""
    mounted = synthetic.case(Truth(tilt=(roll, 0.0)), seed=3)
    assert found_in(SignFlip((1, 2, 3)), mounted).fault == SignFlip((1, 2, 3))


@pytest.mark.parametrize("unit", daily((1e-3, 1e3), 1e-3))
def test_a_unit_of_torque_is_a_power_of_ten(unit: float) -> None:
    """What friction or a load adds to the nominal torque is no part of the unit."""
    found = found_in(TorqueUnit("current", factor=(unit, unit, unit)))
    assert found.name == "torque_unit"
    assert found.fault.values()["factor"] == (unit,) * 3


@pytest.mark.parametrize("label", labels(FAULTS))
def test_fault_is_found_and_put_right(label: str) -> None:
    case = sound("healthy")
    bad = spoilt(case, FAULTS[label])
    (found,) = find_setup_faults(bad)
    variant = found.variant
    assert (found.name, variant, found.joints) == found_as(label)
    assert found.probability > 0.7
    right = repaired(bad, (found,))
    # what was lost stays lost, and what was written twice is still told
    if variant not in ("repeats", "gaps"):
        assert find_setup_faults(right) == ()
    if found.gap_before is not None and variant not in ("repeats", "jitter", "gaps"):
        assert found.gap_after is not None
        assert found.gap_after.max() < found.gap_before.max() / 2


OTHERS = ("large payload", "torque read 40 % low", "no friction", "delay")
BESIDE = ("torque turned", "joints exchanged", "a joint in degrees", "repeats")


@pytest.mark.parametrize(
    ("label", "ordinary"),
    [
        pytest.param(label, ordinary, marks=() if j == k else pytest.mark.nightly)
        for j, label in enumerate(BESIDE)
        for k, ordinary in enumerate(OTHERS)
    ],
)
def test_fault_is_found_beside_an_ordinary_effect(label: str, ordinary: str) -> None:
    found = found_in(FAULTS[label], sound(ordinary))
    assert (found.name, found.variant, found.joints) == found_as(label)


def found_in(fault: Fault, case: Case | None = None) -> FoundFault:
    """The one fault that is found in a case that has it."""
    (found,) = find_setup_faults(spoilt(case or sound("healthy"), fault))
    return found


def test_values_come_with_their_deviations() -> None:
    found = found_in(UnitMismatch("motor_side", (2,), 80.0))
    (ratio,), (std,) = found.fault.values()["ratio"], found.std["ratio"]
    assert abs(ratio - 80.0) < max(3 * std, 4.0)
    found = found_in(TimeStamps("repeats", 0.06))
    assert abs(found.fault.values()["amount"][0] - 0.06) < 0.01
    assert found.document()["variant"] == "repeats"
    assert set(found.document()["parameters"]["amount"]) == {"unit", "value", "std"}


def test_one_gear_ratio_for_all_joints_is_found_as_one() -> None:
    ratios = found_in(UnitMismatch("motor_side", (), 120.0)).fault.values()["ratio"]
    assert len(set(ratios)) == 1 and ratios[0] == pytest.approx(120.0, rel=0.02)


def test_gear_ratios_of_their_own_are_told_apart() -> None:
    """Wide errors of an arm may not stand in for a wrong ratio: the nominal arm fits the recordings as read."""
    case = sound("healthy")
    for joint, ratio in ((1, 50.0), (2, 100.0)):
        case = spoilt(case, UnitMismatch("motor_side", (joint,), ratio))
    found = found_in(UnitMismatch("motor_side", (3,), 160.0), case)
    ratios = found.fault.values()["ratio"]
    assert ratios == pytest.approx((50.0, 100.0, 160.0), rel=0.05)
    assert found.gap_after is not None and found.gap_after.max() < 0.06


def with_velocities(unit: float = 1.0) -> Case:
    """The sound case with velocities in a unit [rad/s]."""

    def one(r: Recording) -> Recording:
        return replace(r, dq=unit * np.gradient(r.q, r.t, axis=0))

    return each(sound("healthy"), one)


def test_recorded_velocities_tell_a_wrong_rate() -> None:
    moving = with_velocities()
    assert find_setup_faults(moving) == ()
    found = found_in(TimeStamps("wrong_rate", 0.9), moving)
    assert found.variant == "wrong_rate"
    assert found.fault.values()["amount"][0] == pytest.approx(0.9, rel=0.01)


@pytest.mark.parametrize(
    ("unit", "reason"),
    [
        (180 / np.pi, "in rad with velocities in deg/s"),
        (np.pi / 180, "in deg with velocities in rad/s"),
        (30 / np.pi, "in rad with velocities in rpm"),
    ],
)
def test_units_of_positions_and_velocities_that_do_not_fit(
    unit: float, reason: str
) -> None:
    """By the velocities alone the rate would be wrong."""
    with pytest.raises(InputError, match=reason):
        find_setup_faults(with_velocities(unit))


@pytest.mark.shared_data
@pytest.mark.parametrize("number", daily(range(9), 0))
def test_sample_cases_have_no_setup_fault(number: int, sample_cases: Path) -> None:
    assert find_setup_faults(load_case(sample_cases / f"case00{number}")) == ()


ARMS = ("ur10", "kinova_gen3_current", "kinova_gen3_sensor", "panda", "staubli_tx40")


@pytest.mark.shared_data
@pytest.mark.parametrize("name", daily(ARMS, "ur10"))
def test_real_arms_have_no_setup_fault(name: str, data_root: Path) -> None:
    path = Path(__file__).parents[3] / "experiments" / "cases" / f"{name}.yaml"
    assert find_setup_faults(load_case(path, data_root=data_root)) == ()


def late_by(*delays: float) -> Case:
    """A case in which the torque of each joint is late by a time of its own [s]."""

    def late(r: Recording) -> Recording:
        series = zip(delays, np.transpose(r.tau), strict=True)
        columns = [np.interp(r.t - x, r.t, tau) for x, tau in series]
        return replace(r, tau=np.column_stack(columns))

    return each(sound("healthy"), late)


@pytest.mark.parametrize(
    ("delays", "named"), [((0.05, 0.05, 0.05), True), ((0.08, 0.02, 0.08), False)]
)
def test_a_late_torque_is_late_on_all_joints(
    delays: tuple[float, ...], named: bool
) -> None:
    names = [fault.name for fault in find_setup_faults(late_by(*delays))]
    assert ("late_torque" in names) == named


def test_a_late_torque_is_hinted_at() -> None:
    healthy = sound("healthy")
    assert not looks_late(healthy)
    assert looks_late(spoilt(healthy, LateTorque("delay", 0.04)))
