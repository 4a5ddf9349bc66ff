"""Recovery check: what was put into synthetic recordings comes out again together, and nothing else does.

Recorded and explained with laws of the same form, so that this is no accuracy; but the recordings are made by
``synthetic``, which shares no code with ``effects``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import synthetic
from pytest import mark, param
from sweeps import daily, nightly
from synthetic import Truth

from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.result import Diagnosis


def named(result: Diagnosis) -> list[tuple[str, tuple[int, ...]]]:
    return sorted(
        (effect["effect"], tuple(effect["joints"]))
        for effect in result.document["effects"]
    )


PAIRS = {
    "Coulomb and delay": (
        Truth(coulomb=(0.0, 2.0, 0.0), delay=(0.01, 0.0, 0.0)),
        [("actuator_delay", (1,)), ("coulomb_friction", (2,))],
    ),
    "on the same joint": (
        Truth(viscous=(0.0, 2.0, 0.0), offset=(0.0, 2.0, 0.0)),
        [("torque_offset", (2,)), ("viscous_friction", (2,))],
    ),
    "payload and friction": (
        Truth(mass=2.0, com=(0.15, 0.0, 0.0), coulomb=(0.0, 2.0, 0.0)),
        [("coulomb_friction", (2,)), ("payload", ())],
    ),
}
NIGHTLY = ("on the same joint",)


@mark.parametrize(
    ("truth", "other"),
    [
        (
            Truth(mass=1.0, com=(0.15, 0.0, 0.0), armature=(0.0, 0.0, 0.4)),
            ("armature", (3,)),
        ),
        nightly(
            Truth(mass=1.0, com=(0.15, 0.0, 0.0), coulomb=(0.0, 2.0, 0.0)),
            ("coulomb_friction", (2,)),
        ),
    ],
    ids=["armature", "Coulomb"],
)
def test_payload_of_a_third_of_its_link_beside(
    truth: Truth, other: tuple[str, tuple[int, ...]]
) -> None:
    """The payload alone, of 0.6 kg and more, is found."""
    assert named(diagnose(synthetic.case(truth, seed=2))) == [other, ("payload", ())]


def test_floor_does_not_rise_to_the_gap() -> None:
    """0.3 kg on a link of 3 kg leave a gap of 0.16, a healthy arm one of 0.005: this is not no_gap."""
    document = diagnose(
        synthetic.case(Truth(mass=0.3, com=(0.15, 0.0, 0.0)), seed=2)
    ).document
    assert document["verdict"] != "no_gap"
    assert max(document["gap"]["before"]["floor"]) < 0.1


@mark.parametrize(
    ("truth", "expected"),
    [
        param(*pair, id=name, marks=mark.nightly if name in NIGHTLY else ())
        for name, pair in PAIRS.items()
    ],
)
def test_a_pair_of_effects(
    truth: Truth, expected: list[tuple[str, tuple[int, ...]]]
) -> None:
    result = diagnose(synthetic.case(truth, seed=2))
    assert result.document["verdict"] == "effects_found"
    assert named(result) == expected
    assert [e.name for e in result.effects] == [
        e["effect"] for e in result.document["effects"]
    ]
    shares = [effect["share"] for effect in result.document["effects"]]
    assert shares == sorted(shares, reverse=True) and 0.9 < sum(shares) <= 1.0 + 1e-9
    for effect in result.document["effects"]:
        only, without = (
            np.array(effect[k]["torque_nrmse"])
            for k in ("gap_with_only_this", "gap_without_this")
        )
        before, after = (
            np.array(result.document["gap"][k]["torque_nrmse"])
            for k in ("before", "after")
        )
        assert (only < before - 0.01).any() and (without > after + 0.01).any()


@mark.nightly
def test_encoder_offset_beside_a_payload() -> None:
    """The pair whose columns lean on each other: values have to be right as well."""
    truth = Truth(mass=1.5, com=(0.2, 0.0, 0.0), encoder=(0.0, 0.06, 0.0))
    result = diagnose(synthetic.case(truth, seed=2))
    assert named(result) == [("encoder_offset", (2,)), ("payload", ())]
    by_name = {e["effect"]: e["parameters"] for e in result.document["effects"]}
    assert by_name["payload"]["mass"]["value"] == pytest.approx(1.5, rel=0.05)
    assert by_name["encoder_offset"]["offset"]["value"] == pytest.approx(
        [0.06], rel=0.05
    )


@mark.parametrize("seed", daily(range(6), 0))
def test_healthy_arm_has_no_gap(seed: int) -> None:
    result = diagnose(synthetic.case(Truth(), seed))
    validate(result.document)
    assert result.document["verdict"] == "no_gap"
    assert result.effects == () and result.document["effects"] == []
    before, after = result.document["gap"]["before"], result.document["gap"]["after"]
    assert before["torque_nrmse"] == after["torque_nrmse"]
    assert not result.document["unexplained"]["above_floor"]


Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def ripple(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    return np.outer(np.sin(2 * np.pi * 5 * t), [0.0, 3.0, 0.0])


def one_sided_drag(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    return np.where(dq > 0, 3 * dq**2, 0.0) * [0.0, 1.0, 0.0]


@mark.parametrize("extra", daily((ripple, one_sided_drag), ripple))
def test_effect_outside_the_catalogue_is_unexplained_on_its_joint(
    extra: Torque,
) -> None:
    document = diagnose(synthetic.case(Truth(extra=extra), seed=3)).document
    validate(document)
    assert document["verdict"] == "unexplained"
    assert (
        document["unexplained"]["above_floor"]
        and document["unexplained"]["share"] > 0.3
    )
    after, floor = (
        np.array(x)
        for x in (
            document["gap"]["after"]["torque_nrmse"],
            document["gap"]["before"]["floor"],
        )
    )
    assert list(np.flatnonzero(after > 1.6 * floor) + 1) == [2]
    assert {region["joint"] for region in document["unexplained"]["where"]} <= {2}
    assert "joint 2" in document["next_recording"]
    for effect in document["effects"]:
        assert effect["share"] < 0.9
    if extra is ripple:
        regimes = [region["regime"] for region in document["unexplained"]["where"]]
        assert "4 to 8 Hz" in regimes


class TestVerdict:
    """Effects are found with most of the gap closed and no joint left alone, or nothing left above the floor."""

    @staticmethod
    def little(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        return 0.4 * ripple(t, q, dq)

    def test_large_effect_and_a_little_on_its_joint_that_nothing_explains(self) -> None:
        truth = Truth(coulomb=(0.0, 4.0, 2.0), extra=self.little)
        document = diagnose(synthetic.case(truth, seed=4)).document
        assert document["verdict"] == "effects_found"
        # joint 2 has an unknown cause, but friction explains more
        assert not document["unexplained"]["above_floor"]
        assert document["unexplained"]["joints"] == [2]
        assert 0.0 < document["unexplained"]["share"] < 0.3

    def test_large_effect_and_a_little_on_another_joint_that_nothing_explains(
        self,
    ) -> None:
        truth = Truth(coulomb=(4.0, 0.0, 2.0), extra=self.little)
        result = diagnose(synthetic.case(truth, seed=4))
        assert result.document["verdict"] == "unexplained"
        assert named(result) == [("coulomb_friction", (1, 3))]
        assert result.document["unexplained"]["above_floor"]

    @mark.nightly
    def test_small_effect_and_much_that_nothing_explains(self) -> None:
        truth = Truth(coulomb=(1.0, 0.0, 0.0), extra=ripple)
        result = diagnose(synthetic.case(truth, seed=4))
        document = result.document
        assert document["verdict"] == "unexplained"
        assert ("coulomb_friction", (1,)) in named(result)
        assert document["unexplained"]["above_floor"]

    @mark.parametrize(("torque", "there"), [(0.04, False), nightly(0.4, True)])
    def test_effect_below_a_hundredth_is_not_named(
        self, torque: float, there: bool
    ) -> None:
        result = diagnose(synthetic.case(Truth(coulomb=(0.0, torque, 0.0)), seed=5))
        assert bool(result.effects) == there
        assert result.document["verdict"] == ("effects_found" if there else "no_gap")

    @mark.nightly
    def test_every_effect_named_lowers_a_gap_by_a_hundredth(self) -> None:
        truth = Truth(
            coulomb=(0.3, 2.0, 0.1), viscous=(0.1, 0.0, 0.3), armature=(0.05, 0.0, 0.0)
        )
        document = diagnose(synthetic.case(truth, seed=6)).document
        after = np.array(document["gap"]["after"]["torque_nrmse"])
        for effect in document["effects"]:
            assert (
                np.array(effect["gap_without_this"]["torque_nrmse"]) - after
            ).max() > 0.008

    def test_shorter_than_a_sampling_skew_is_no_delay(self) -> None:
        """Half a millisecond on every joint is what a held torque leaves."""
        result = diagnose(synthetic.case(Truth(delay=(2e-4,) * 3), seed=5))
        assert result.document["verdict"] == "no_gap"


def test_probabilities_and_alternatives() -> None:
    """An effect, its rivals and what is not among them share one probability."""
    document = diagnose(synthetic.case(Truth(coulomb=(0.0, 0.6, 0.0)), seed=5)).document
    assert document["effects"]
    for effect in document["effects"]:
        rivals = effect["alternatives"]
        assert (
            0.8
            < effect["probability"] + sum(r["probability"] for r in rivals)
            <= 1.0 + 1e-9
        )
        assert effect["set"][0] == effect["effect"] and set(effect["set"][1:]) <= {
            "unknown",
            *(r["effect"] for r in rivals),
        }
        assert all(r["probability"] <= effect["probability"] for r in rivals)
        probabilities = [r["probability"] for r in rivals]
        assert probabilities == sorted(probabilities, reverse=True)
        assert all(
            r["effect"] != effect["effect"] and r["separated_by"] for r in rivals
        )


@mark.slow
@mark.nightly
def test_standard_deviations_cover_the_errors() -> None:
    """Over six seeds, for three effects at once; an arm without errors of its own does better than its intervals."""
    truth = Truth(
        viscous=(3.0, 0.0, 0.0), offset=(0.0, 2.0, 0.0), armature=(0.0, 0.0, 0.3)
    )
    true = {"viscous_friction": 3.0, "torque_offset": 2.0, "armature": 0.3}
    errors: dict[str, list[float]] = {name: [] for name in true}
    stds: dict[str, list[float]] = {name: [] for name in true}
    for seed in range(10, 16):
        document = diagnose(synthetic.case(truth, seed, duration=6.0)).document
        assert {e["effect"] for e in document["effects"]} == set(true)
        for effect in document["effects"]:
            ((_, parameter),) = effect["parameters"].items()
            errors[effect["effect"]].append(
                parameter["value"][0] - true[effect["effect"]]
            )
            stds[effect["effect"]].append(parameter["std"][0])
    for name in true:
        ratio = np.sqrt(np.mean(np.square(errors[name]))) / np.mean(stds[name])
        assert ratio < 2.0, f"{name}: errors are {ratio:.2f} standard deviations"
        assert np.mean(stds[name]) < 0.05 * true[name], f"{name}: says too little"


@mark.parametrize(
    "truth",
    [
        Truth(encoder=(0.0, 0.0, 0.06)),
        nightly(Truth(link=2, link_mass=1.0, ripple=(1.5, 0.0, 0.0))),
    ],
    ids=["encoder of the last joint", "a link beside a ripple"],
)
def test_nominal_errors_do_not_stand_for_an_effect(truth: Truth) -> None:
    """A gap of six to seventeen hundredths, where a healthy arm leaves half of one."""
    document = diagnose(synthetic.case(truth, seed=2)).document
    assert max(document["gap"]["before"]["floor"]) < 0.05
