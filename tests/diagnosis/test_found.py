"""What was put into an arm is found again with its joints and values, and nothing else is.

Recorded by ``synthetic``, which shares no code with ``effects``; but with laws of the same form, so that this is no
accuracy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import synthetic
from pytest import approx
from sweeps import daily, nightly
from synthetic import Truth, diagnosed, named

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose import diagnose
from gapscope.effects.catalogue import CATALOGUE, explained

Values = dict[str, Any]
Joints = tuple[int, ...]


def near(*values: float, by: float) -> Any:
    """Values of joints, each as near as that."""
    return approx(list(values), abs=by)


def gaps(document: dict[str, Any]) -> list[np.ndarray]:
    """Gaps of the joints before and after."""
    stages = ("before", "after")
    return [np.array(document["gap"][stage]["torque_nrmse"]) for stage in stages]


def on(joint: int, value: float) -> tuple[float, ...]:
    """A value on one joint, from 1, and none on the others."""
    return tuple(value if j == joint else 0.0 for j in (1, 2, 3))


# One effect at a time: its name, joints, values, and how sure it is.


def alone(truth: Truth, *joints: int, **values: Any) -> tuple[Truth, Joints, Values]:
    """An arm with one effect: its joints, and values that are near enough."""
    return truth, joints, values


EVERY: dict[str, tuple[Truth, Joints, Values]] = {
    "coulomb_friction": alone(
        Truth(coulomb=(0.0, 2.0, 0.8)), 2, 3, torque=near(2.0, 0.8, by=0.1)
    ),
    "viscous_friction": alone(
        Truth(viscous=on(1, 3.0)), 1, coefficient=near(3.0, by=0.15)
    ),
    "load_friction": alone(
        Truth(load=(0.0, 0.15, 0.12)), 2, 3, coefficient=near(0.15, 0.12, by=0.0075)
    ),
    "stribeck_friction": alone(
        Truth(stribeck=on(2, 3.0), stribeck_speed=0.2),
        2,
        torque=near(3.0, by=0.15),
        velocity=near(0.2, by=0.02),
    ),
    "saturating_friction": alone(
        Truth(saturation=(0.0, 6.0, 2.0), saturation_speed=0.3),
        *(2, 3),
        torque=near(6.0, 2.0, by=0.3),
        velocity=near(0.3, 0.3, by=0.05),
    ),
    "friction_drift": alone(
        Truth(drift=on(2, 0.8), drift_time=3.0),
        2,
        amplitude=near(0.8, by=0.04),
        time_constant=near(3.0, by=0.3),
    ),
    "payload": alone(
        Truth(mass=1.5, com=(0.2, 0.03, 0.02)),
        mass=approx(1.5, abs=0.075),
        com=near(0.2, 0.03, 0.02, by=0.01),
    ),
    "link_inertia": alone(
        Truth(link=2, link_mass=2.0, link_com=(0.03, 0.0, 0.0)),
        link=2,
        mass=approx(2.0, abs=0.2),
        com=near(0.03, 0.0, 0.0, by=0.01),
    ),
    "armature": alone(
        Truth(armature=(0.5, 0.0, 0.3)), 1, 3, inertia=near(0.5, 0.3, by=0.025)
    ),
    "base_tilt": alone(
        Truth(tilt=(0.05, -0.03)),
        roll=approx(0.05, abs=0.0025),
        pitch=approx(-0.03, abs=0.005),
    ),
    "joint_elasticity": alone(
        Truth(stiffness=on(1, 1500.0), damping=on(1, 3.0)),
        1,
        stiffness=near(1500.0, by=150.0),
    ),
    "backlash": alone(Truth(play=on(1, 0.003)), 1, width=near(0.003, by=9e-4)),
    "torque_ripple": alone(
        Truth(ripple=on(2, 1.5), cycles=16.0, phase=0.7),
        2,
        amplitude=near(1.5, by=0.075),
        cycles=near(16.0, by=0.1),
        phase=near(0.7, by=0.1),
    ),
    "parallel_spring": alone(
        Truth(spring=on(2, 6.0), rest=0.3),
        2,
        stiffness=near(6.0, by=0.3),
        rest=near(0.3, by=0.02),
    ),
    "torque_scale": alone(Truth(scale=on(2, 0.2)), 2, scale=near(0.2, by=0.01)),
    "torque_scale below one": alone(
        Truth(scale=on(3, -0.2)), 3, scale=near(-0.2, by=0.01)
    ),
    "torque_offset": alone(
        Truth(offset=(1.0, 0.0, -0.7)), 1, 3, torque=near(1.0, -0.7, by=0.05)
    ),
    "torque_saturation": alone(Truth(limit=on(2, 40.0)), 2, limit=near(40.0, by=2.0)),
    "actuator_lag": alone(
        Truth(lag=on(2, 0.012)), 2, time_constant=near(0.012, by=0.0012)
    ),
    "actuator_delay": alone(
        Truth(delay=(0.0, 0.012, 0.008)), 2, 3, delay=near(0.012, 0.008, by=7e-4)
    ),
    "encoder_offset": alone(
        Truth(encoder=on(2, 0.05)), 2, offset=near(0.05, by=0.0025)
    ),
    "external_force": alone(
        Truth(force=(8.0, 0.0, -12.0), window=(2.0, 4.0)),
        force=near(8.0, 0.0, -12.0, by=0.6),
        start=approx(2.0, abs=0.1),
        end=approx(4.0, abs=0.1),
    ),
}
DAILY = ("stribeck_friction", "payload", "base_tilt", "torque_scale", "actuator_delay")
"""One of each family: friction, bodies, gravity, size and time of the torque; others are daily in tests below."""
ALIKE = {"actuator_delay": "actuator_lag"}
"""What these motions cannot tell from it, which is listed beside it then."""


def test_every_effect_of_the_catalogue_is_here() -> None:
    """Quantisation, which shows in the positions themselves, aside."""
    names = {label.split()[0] for label in EVERY}
    assert names == {effect.name for effect in explained()}
    assert names == set(CATALOGUE) - {"encoder_quantization"}


@pytest.mark.parametrize("label", daily(EVERY, *DAILY))
def test_an_effect_is_found_with_its_joints_and_values(label: str) -> None:
    truth, joints, values = EVERY[label]
    name = label.split()[0]
    result = diagnosed(truth, duration=6.0)
    document = result.document
    (effect,) = document["effects"]
    rivals = {a["effect"]: a["probability"] for a in effect["alternatives"]}
    if effect["effect"] == ALIKE.get(name):
        assert named(result) == [(ALIKE[name], joints)] and rivals[name] > 0.005
        return
    assert document["verdict"] == "effects_found" and named(result) == [(name, joints)]
    if name in ALIKE and effect["probability"] < 0.9:
        assert effect["probability"] > 0.5 and rivals[ALIKE[name]] > 0.05
        assert ALIKE[name] in document["next_recording"]
    else:
        assert effect["probability"] > 0.8
    for key, expected in values.items():
        entry = effect["parameters"][key]
        assert entry["value"] == expected
        assert entry["unit"] == CATALOGUE[name].parameter(key).unit
        applied = result.effects[0].parameters[key]
        np.testing.assert_array_equal(applied, entry["value"])
        most = 0.5 * max(np.abs(applied).max(), 0.1)
        assert all(0.0 <= std < most for std in np.atleast_1d(entry["std"]))
    if name == "base_tilt":
        # roll of 0.05 and pitch of -0.03 rad
        assert effect["gravity"] == near(-0.294, -0.49, -9.81, by=0.1)
    assert effect["share"] > 0.9 and not document["unexplained"]["above_floor"]
    # a force that comes and goes at the same times in all recordings is told as an effect alone
    assert document["changes"] == []


@pytest.mark.nightly
@pytest.mark.parametrize(("link", "mass"), [(2, 1.0), (3, 1.2)])
def test_a_link_that_a_poor_data_sheet_may_be_off_by_is_not_named_otherwise(
    link: int, mass: float
) -> None:
    """Of three joints motion shows 13 combinations of the bodies, and four values of one link move five of them.

    A data sheet all of whose bodies are off by a tenth explains that as well: what is left of it goes by no other name.
    """
    truth = Truth(link=link, link_mass=mass, link_com=(0.02, 0.01, 0.0))
    assert named(diagnosed(truth, duration=6.0)) == []


# Several effects at once.


LOAD = {"mass": 1.0, "com": (0.15, 0.0, 0.0)}
FOUND_COULOMB, FOUND_LOAD = ("coulomb_friction", (2,)), ("payload", ())
TOGETHER: dict[str, tuple[Truth, list[tuple[str, Joints]]]] = {
    "Coulomb and delay": (
        Truth(coulomb=on(2, 2.0), delay=on(1, 0.01)),
        [("actuator_delay", (1,)), FOUND_COULOMB],
    ),
    "on the same joint": (
        Truth(viscous=on(2, 2.0), offset=on(2, 2.0)),
        [("torque_offset", (2,)), ("viscous_friction", (2,))],
    ),
    "a payload of a third of its link beside a rotor": (
        Truth(**LOAD, armature=on(3, 0.4)),
        [("armature", (3,)), FOUND_LOAD],
    ),
    "such a payload beside friction": (
        Truth(**LOAD, coulomb=on(2, 2.0)),
        [FOUND_COULOMB, FOUND_LOAD],
    ),
}


@pytest.mark.parametrize("label", daily(TOGETHER, *list(TOGETHER)[::2]))
def test_several_effects_are_told_apart(label: str) -> None:
    truth, expected = TOGETHER[label]
    result = diagnosed(truth, seed=2)
    document = result.document
    assert document["verdict"] == "effects_found" and named(result) == expected
    entries = document["effects"]
    assert [e.name for e in result.effects] == [e["effect"] for e in entries]
    shares = [entry["share"] for entry in entries]
    assert shares == sorted(shares, reverse=True) and 0.9 < sum(shares) <= 1.0 + 1e-9
    before, after = gaps(document)
    for entry in entries:
        only = np.array(entry["gap_with_only_this"]["torque_nrmse"])
        without = np.array(entry["gap_without_this"]["torque_nrmse"])
        assert (only < before - 0.01).any() and (without > after + 0.01).any()


def test_an_effect_its_rivals_and_an_unknown_cause_share_one_probability() -> None:
    (effect,) = diagnosed(EVERY["payload"][0], duration=6.0).document["effects"]
    rivals = {r["effect"]: r["separated_by"] for r in effect["alternatives"]}
    assert rivals and all(rivals.values()) and effect["effect"] not in rivals
    probabilities = [r["probability"] for r in effect["alternatives"]]
    assert 0.8 < effect["probability"] + sum(probabilities) <= 1.0 + 1e-9
    assert probabilities == sorted(probabilities, reverse=True)
    assert probabilities[0] <= effect["probability"]
    assert effect["set"][0] == effect["effect"]
    assert set(effect["set"][1:]) <= {"unknown", *rivals}


# The same effect in recordings of all kinds.


COULOMB = Truth(coulomb=on(2, 2.0))


def silent(recording: Recording) -> Recording:
    return replace(recording, tau=None)


def late(recording: Recording) -> Recording:
    """At half the rate as well."""
    half = recording.part(slice(None, None, 2))
    return replace(half, t=half.t + 1.7e9)


def torn(recording: Recording) -> Recording:
    return recording.part((recording.t < 3.0) | (recording.t > 3.4))


def kept(recording: Recording) -> Recording:
    return recording


def clipped(recording: Recording) -> Recording:
    most = 0.7 * np.abs(recording.tau).max(axis=0)
    return replace(recording, tau=np.clip(recording.tau, -most, most))


def stuck(recording: Recording) -> Recording:
    tau = np.array(recording.tau)
    tau[400:700, 1] = tau[400, 1]
    return replace(recording, tau=tau)


def coarse(recording: Recording) -> Recording:
    step = 0.03 * np.ptp(recording.tau, axis=0)
    return replace(recording, tau=step * np.round(recording.tau / step))


Change = Callable[[Recording], Recording]


def with_each(*changes: Change, truth: Truth = COULOMB, seed: int = 7) -> Case:
    """As many of the last recordings of a case, each changed."""
    case = synthetic.case(truth, seed)
    used = case.recordings[-len(changes) :]
    made = (change(r) for change, r in zip(changes, used, strict=True))
    return replace(case, recordings=tuple(made))


def held(truth: Truth = COULOMB) -> Case:
    """The last joint never moves."""
    case, still = synthetic.case(truth, 7), []
    for k, frequency in enumerate((0.1, 0.2, 0.3)):
        moved = synthetic.held(synthetic.motion(70 + k, frequency, 8.0), 3)
        rng = np.random.default_rng(k)
        still.append(synthetic.recording(truth, moved, rng, f"recording_{k}.csv"))
    return replace(case, recordings=tuple(still))


LOGS: dict[str, Callable[[], Case]] = {
    "one recording": lambda: with_each(kept, seed=8),
    "one silent, one late, one torn": lambda: with_each(silent, late, torn),
    "all late": lambda: with_each(late, late, late),
    "a joint that never moves": held,
    "torque clipped": lambda: with_each(clipped, clipped),
    "torque stuck": lambda: with_each(stuck, stuck),
}
LOGS_DAILY = (*list(LOGS)[:2], "a joint that never moves")


@pytest.mark.parametrize("label", daily(LOGS, *LOGS_DAILY))
def test_friction_is_found_in_logs_of_all_kinds(label: str) -> None:
    result = diagnose(LOGS[label]())
    synthetic.validate(result.document)
    (effect,) = result.effects
    assert (effect.name, effect.joints) == FOUND_COULOMB
    assert effect.parameters["torque"] == approx([2.0], rel=0.05)
    assert ("states" in result.document) == (label != "one recording")


# No gap.


COUPLING = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 1.0]])


def healthy(change: Change, count: int = 2) -> Case:
    return with_each(*[change] * count, truth=Truth(), seed=3)


def with_coupled_motors(case: Case) -> Case:
    return replace(case, arm=replace(case.arm, coupling=COUPLING))


CALM: dict[str, Callable[[], Case]] = {
    **{f"seed {k}": lambda k=k: synthetic.case(Truth(), k) for k in range(6)},
    # half a millisecond on every joint is what a held torque leaves
    "a delay as of sampling": lambda: synthetic.case(Truth(delay=(2e-4,) * 3), 5),
    "friction below a hundredth": lambda: synthetic.case(Truth(coulomb=on(2, 0.04)), 5),
    "one recording": lambda: with_each(kept, truth=Truth(), seed=8),
    "torque clipped": lambda: healthy(clipped),
    "torque stuck": lambda: healthy(stuck),
    "torque in coarse steps": lambda: healthy(coarse),
    "a declared motor of two joints": lambda: with_coupled_motors(healthy(kept, 3)),
}
CALM_DAILY = (
    *("seed 0", "a delay as of sampling", "friction below a hundredth"),
    *("torque clipped", "a declared motor of two joints"),
)


@pytest.mark.parametrize("label", daily(CALM, *CALM_DAILY))
def test_a_healthy_arm_has_no_gap(label: str) -> None:
    result = diagnose(CALM[label]())
    document = result.document
    synthetic.validate(document)
    assert document["verdict"] == "no_gap"
    assert result.effects == () and document["effects"] == []
    before, after = gaps(document)
    assert (before == after).all()
    assert not document["unexplained"]["above_floor"]


@pytest.mark.parametrize(
    ("truth", "most"),
    [
        # 0.3 kg on a link of 3 kg leave a gap of 0.16, a healthy arm one of 0.005: this is not no_gap
        (Truth(mass=0.3, com=(0.15, 0.0, 0.0)), 0.1),
        # gaps of six to seventeen hundredths
        nightly(Truth(encoder=on(3, 0.06)), 0.05),
        nightly(Truth(link=2, link_mass=1.0, ripple=on(1, 1.5)), 0.05),
    ],
)
def test_the_floor_does_not_rise_to_the_gap(truth: Truth, most: float) -> None:
    document = diagnosed(truth, seed=2).document
    assert document["verdict"] != "no_gap"
    assert max(document["gap"]["before"]["floor"]) < most


def test_a_limit_is_found_beside_friction_that_peaks() -> None:
    """The controller winds up: were any share lost beyond a limit, one at which most is would explain more."""
    result = diagnosed(Truth(limit=on(2, 42.0), stribeck=on(2, 12.0)), duration=6.0)
    both = [("stribeck_friction", (2,)), ("torque_saturation", (2,))]
    assert named(result) == both
    limit = next(e for e in result.document["effects"] if e["effect"] == both[1][0])
    assert limit["parameters"]["limit"]["value"] == near(42.0, by=1.0)


# What no effect explains.


def ripple(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    return np.outer(np.sin(2 * np.pi * 5 * t), [0.0, 3.0, 0.0])


def little_ripple(*of: np.ndarray) -> np.ndarray:
    return 0.4 * ripple(*of)


def large_ripple(*of: np.ndarray) -> np.ndarray:
    return 1.3 * ripple(*of)


def one_sided_drag(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    return np.where(dq > 0, 3 * dq**2, 0.0) * [0.0, 1.0, 0.0]


@pytest.mark.parametrize("extra", daily((ripple, one_sided_drag), ripple))
def test_effect_outside_the_catalogue_is_unexplained_on_its_joint(extra: Any) -> None:
    document = diagnosed(Truth(extra=extra), seed=3).document
    unexplained = document["unexplained"]
    assert document["verdict"] == "unexplained"
    assert unexplained["above_floor"] and unexplained["share"] > 0.3
    floor = np.array(document["gap"]["before"]["floor"])
    assert list(np.flatnonzero(gaps(document)[1] > 1.6 * floor) + 1) == [2]
    assert {region["joint"] for region in unexplained["where"]} <= {2}
    assert "joint 2" in document["next_recording"]
    assert all(effect["share"] < 0.9 for effect in document["effects"])
    if extra is ripple:
        assert "4 to 8 Hz" in [region["regime"] for region in unexplained["where"]]


@pytest.mark.parametrize(
    ("coulomb", "extra", "verdict", "joints"),
    [
        # joint 2 has an unknown cause, but friction explains more
        ((0.0, 4.0, 2.0), little_ripple, "effects_found", (2, 3)),
        # friction closes less of the gap than stays open, though more of its square
        (on(2, 4.0), large_ripple, "unexplained", (2,)),
        nightly((4.0, 0.0, 2.0), little_ripple, "unexplained", (1, 3)),
        nightly(on(1, 1.0), ripple, "unexplained", (1,)),
    ],
)
def test_effects_beside_an_unknown_cause(
    coulomb: tuple[float, ...], extra: Any, verdict: str, joints: Joints
) -> None:
    """Effects are found with most of the gap closed and no joint left alone, or nothing left above the floor."""
    result = diagnosed(Truth(coulomb=coulomb, extra=extra), seed=4)
    unexplained = result.document["unexplained"]
    assert result.document["verdict"] == verdict
    assert ("coulomb_friction", joints) in named(result)
    assert unexplained["above_floor"] == (verdict == "unexplained")
    assert 2 in unexplained["joints"] and unexplained["share"] > 0.0


def test_friction_that_the_data_sheet_has_and_the_arm_has_not_is_found_at_the_bound() -> (
    None
):
    without = Truth(coulomb=(-2.0, -3.0, -1.0), viscous=(-2.0, -3.0, -1.0))
    result = diagnosed(without, seed=3)
    assert result.document["closed"] > 0.95
    every = (1, 2, 3)
    expected = [("coulomb_friction", every), ("viscous_friction", every)]
    assert named(result) == expected
    for effect in result.effects:
        (values,) = effect.parameters.values()
        assert values == near(-2.0, -3.0, -1.0, by=0.05)
        assert (values >= [-2.0, -3.0, -1.0]).all()


@pytest.mark.nightly
def test_every_effect_named_lowers_a_gap_by_a_hundredth() -> None:
    truth = Truth(
        coulomb=(0.3, 2.0, 0.1), viscous=(0.1, 0.0, 0.3), armature=on(1, 0.05)
    )
    document = diagnosed(truth, seed=6).document
    _, after = gaps(document)
    for effect in document["effects"]:
        without = np.array(effect["gap_without_this"]["torque_nrmse"])
        assert (without - after).max() > 0.008


@pytest.mark.slow
@pytest.mark.nightly
def test_standard_deviations_cover_the_errors() -> None:
    """Over six seeds, for three effects at once; an arm without errors of its own does better than its intervals."""
    truth = Truth(viscous=on(1, 3.0), offset=on(2, 2.0), armature=on(3, 0.3))
    true = {"viscous_friction": 3.0, "torque_offset": 2.0, "armature": 0.3}
    errors: dict[str, list[float]] = {name: [] for name in true}
    stds: dict[str, list[float]] = {name: [] for name in true}
    for seed in range(10, 16):
        document = diagnosed(truth, seed, duration=6.0).document
        assert {e["effect"] for e in document["effects"]} == set(true)
        for effect in document["effects"]:
            name, (parameter,) = effect["effect"], effect["parameters"].values()
            errors[name].append(parameter["value"][0] - true[name])
            stds[name].append(parameter["std"][0])
    for name in true:
        ratio = np.sqrt(np.mean(np.square(errors[name]))) / np.mean(stds[name])
        assert ratio < 2.0, f"{name}: errors are {ratio:.2f} standard deviations"
        assert np.mean(stds[name]) < 0.05 * true[name], f"{name}: says too little"


@pytest.mark.nightly
def test_recordings_of_different_rates() -> None:
    """A sine of 5 Hz is found in its band although the recordings have 125, 250 and 250 Hz."""
    case = synthetic.case(Truth(extra=ripple), 3)
    first, *others = case.recordings
    mixed = (first.part(slice(None, None, 2)), *others)
    document = diagnose(replace(case, recordings=mixed)).document
    regions = document["unexplained"]["where"]
    assert "4 to 8 Hz" in [region["regime"] for region in regions]
