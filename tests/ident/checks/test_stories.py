"""Stories that a practitioner tells: a wrong zero shows as impossible masses, and faults name themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cases import each, panda_case
from sweeps import daily, nightly

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.checks.symptoms import (
    NominalSimilarity,
    nominal_similarity,
    torque_gain,
)
from gapscope.ident.checks.troubleshooting import FOUND
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)
from gapscope.ident.model.linear_problem import ModelColumns
from gapscope.ident.samples import Band, Samples, split
from gapscope.model.conditioning import position_cutoff

CUTOFF = IdentificationSettings(cutoff=20.0)
FIVE = np.deg2rad(5.0)


def zero_off(joint: int, angle: float = FIVE) -> Case:
    return panda_case(
        (AppliedEffect("encoder_offset", (joint,), {"offset": np.array([angle])}),)
    )


@cache
def healthy() -> Identification:
    return identify(panda_case(), CUTOFF)


@cache
def off(joint: int) -> Identification:
    return identify(zero_off(joint), CUTOFF)


def found(result: Identification) -> dict[str, tuple[int, ...]]:
    """Rows of the table that fire, with their joints."""
    return {row.key: row.joints for row in result.table if row.verdict == FOUND}


class TestWrongZero:
    def test_healthy_arm_has_possible_bodies_and_no_question(self) -> None:
        result = healthy()
        assert all(check.positive_mass for check in result.physical.before)
        assert result.questions == ()
        assert not [w for w in result.warnings if "no body" in w]

    def test_a_wrong_zero_gives_a_negative_mass(self) -> None:
        """The parameters nearest to the nominal arm that fit best give the upper arm a mass below zero."""
        result = identify(zero_off(2, 2 * FIVE), CUTOFF)
        before = result.physical.before
        assert [check.link for check in before if not check.positive_mass] == [3]
        assert any("link 3 even of negative mass" in text for text in result.warnings)

    @pytest.mark.parametrize("joint", daily((2, 3, 4), 2))
    def test_tool_asks_for_the_zero_and_recovers_it(self, joint: int) -> None:
        result = off(joint)
        assert result.zeros.asked.tolist() == [joint - 1]
        assert abs(np.rad2deg(result.zeros.offset[joint - 1] - FIVE)) < 0.2
        (question,) = result.questions
        assert f"zero of joint {joint}" in question and "offsets" in question

    def test_the_correction_that_it_offers_mends_the_arm(self) -> None:
        delta = off(2).zeros.offset * (np.arange(7) == 1)
        mended = identify(
            each(zero_off(2), lambda r: replace(r, q=r.q - delta)), CUTOFF
        )
        assert mended.questions == ()
        assert all(check.positive_mass for check in mended.physical.before)
        assert (
            mended.validation[1].every.overall
            < 0.2 * off(2).validation[1].nominal.overall
        )

    def test_first_zero_about_the_vertical_is_left_open(self) -> None:
        """No torque depends on it."""
        assert not healthy().zeros.known[0]
        assert np.rad2deg(healthy().zeros.deviation[0]) > 5.0

    def test_identified_arm_is_possible_all_the_same(self) -> None:
        assert all(
            check.consistent and check.triangle for check in off(2).physical.after
        )


def swapped(r: Recording) -> Recording:
    return replace(r, tau=np.asarray(r.tau)[:, [0, 1, 3, 2, 4, 5, 6]])


def turned(r: Recording) -> Recording:
    return replace(r, tau=np.asarray(r.tau) * [1, 1, 1, -1, 1, 1, 1])


def late(r: Recording) -> Recording:
    return replace(r, t=r.t[5:], q=r.q[5:], tau=np.asarray(r.tau)[:-5])


def noisy(r: Recording) -> Recording:
    return replace(
        r, q=r.q + 1e-3 * np.random.default_rng(7).standard_normal(r.q.shape)
    )


def saturated(r: Recording) -> Recording:
    limit = np.quantile(np.abs(np.asarray(r.tau)), 0.95, axis=0)
    return replace(r, tau=np.clip(np.asarray(r.tau), -limit, limit))


def resting(r: Recording) -> Recording:
    return replace(r, q=np.where(np.arange(7) == 6, 0.3, r.q))


Fault = Callable[[Recording], Recording]
ROWS: dict[Fault, tuple[str, tuple[int, ...] | None]] = {
    swapped: ("swapped_joints", (3, 4)),
    turned: ("torque_sign", (4,)),
    late: ("time_offset", None),
    noisy: ("derivative_noise", None),
    saturated: ("saturated_torque", (1, 2, 3, 4, 5, 6, 7)),
    resting: ("resting_joint", (7,)),
}
"""Row of the table that a fault fires, and its joints."""


class TestTroubleshooting:
    def test_healthy_arm_fires_no_row(self) -> None:
        assert found(healthy()) == {}
        assert len(healthy().table) == 13

    @pytest.mark.parametrize(
        "planted",
        [
            (late, swapped),
            (noisy, saturated),
            *(nightly((fault,)) for fault in ROWS),
        ],
        ids=lambda planted: " and ".join(fault.__name__ for fault in planted),
    )
    def test_planted_faults_fire_their_rows(self, planted: tuple[Fault, ...]) -> None:
        case = panda_case()
        for fault in planted:
            case = each(case, fault)
        fired = found(identify(case, CUTOFF))
        for row, joints in map(ROWS.__getitem__, planted):
            assert row in fired
            assert joints is None or fired[row] == joints

    def test_zero_fires_its_row(self) -> None:
        assert found(off(2))["joint_zero"] == (2,)

    @pytest.mark.nightly
    def test_torque_in_another_unit_fires_its_row_where_it_is_let_pass(self) -> None:
        case = each(panda_case(), lambda r: replace(r, tau=1e3 * np.asarray(r.tau)))
        assert "torque_unit" in found(identify(case, replace(CUTOFF, any_torque=True)))

    def test_a_base_that_is_mounted_turned_is_refused_with_its_gravity(self) -> None:
        case = panda_case()
        sideways = replace(case.arm, gravity=np.array([0.0, 9.81, 0.0]))
        with pytest.raises(
            InputError, match=r"mounted turned(.|\n)*gravity: \["
        ) as got:
            identify(replace(case, arm=sideways), CUTOFF)
        shown = got.value.remedy.split("[")[1].split("]")[0]
        near = [float(x) for x in shown.split(",")]
        assert np.allclose(near, case.arm.gravity, atol=0.7)

    def test_stribeck_friction_fires_its_row_and_is_recovered(self) -> None:
        planted = AppliedEffect(
            "stribeck_friction", (1, 2), {"torque": [4.0, 4.0], "velocity": [0.2, 0.2]}
        )
        result = identify(panda_case((planted,)), CUTOFF)
        assert "low_speed_friction" in found(result)
        assert result.choice.law.stribeck_speed == 0.2
        values = dict(
            zip(
                result.columns.names(result.choice.law),
                result.physical.value,
                strict=True,
            )
        )
        assert [values["d1"], values["d2"]] == pytest.approx([4.0, 4.0], rel=0.1)

    def test_motion_too_small_fires_the_condition(self) -> None:
        assert "condition" in found(identify(panda_case(size=0.06, speed=0.3), CUTOFF))

    def test_rows_say_what_to_do(self) -> None:
        for row in healthy().table:
            assert all((row.symptom, row.cause, row.check, row.remedy))
            assert np.isfinite(row.measured)


# Torque in another unit is refused or said with its factor; healthy arms and arms full of friction are let pass.


ROOT = Path(__file__).resolve().parents[3]


def scaled(factor: float) -> Case:
    return each(panda_case(), lambda r: replace(r, tau=factor * np.asarray(r.tau)))


@cache
def identified(factor: float) -> Identification:
    return identify(scaled(factor), replace(CUTOFF, any_torque=True))


def compared(case: Case) -> NominalSimilarity:
    fit, _ = split(case)
    band, columns = (
        Band(position_cutoff(tuple(fit))),
        ModelColumns(case.arm),
    )
    return nominal_similarity(Samples(columns, band.segments(fit), band))


@pytest.mark.parametrize("factor", daily((1 / 5, 9.81, 0.738), 1 / 5, 0.738))
def test_a_wrong_factor_is_quoted(factor: float) -> None:
    result = identified(factor)
    (warning,) = (w for w in result.warnings if "times the nominal arm's" in w)
    assert f"is {factor:.3g} times" in warning and "alike" in warning
    assert any(
        row.key == "torque_gain" and row.verdict == "found" for row in result.table
    )


def test_the_unit_is_guessed() -> None:
    assert any("as if it were in lbf ft" in w for w in identified(0.738).warnings)


def test_large_factors_are_refused() -> None:
    with pytest.raises(InputError, match="9.81 times larger"):
        identify(scaled(9.81), CUTOFF)


def test_a_nominal_arm_that_is_off_by_more_than_the_torque_is_said_plainly() -> None:
    assert any("off by 400% of the recorded" in w for w in identified(1 / 5).warnings)


def test_silent_on_a_healthy_arm() -> None:
    assert not torque_gain(compared(panda_case())).found


@pytest.mark.shared_data
@pytest.mark.parametrize("number", daily(range(9), 0))
def test_silent_on_sample_cases(number: int, sample_cases: Path) -> None:
    """None of them has torque in another unit; one has scaled torque on some joints, one a payload."""
    case = load_case(sample_cases / f"case{number:03d}")
    assert not torque_gain(compared(case)).found


@pytest.mark.shared_data
def test_silent_on_an_arm_full_of_friction(data_root: Path) -> None:
    path = ROOT / "experiments" / "cases" / "staubli_tx40.yaml"
    assert not torque_gain(compared(load_case(path, data_root=data_root))).found
