"""Stories that a practitioner tells: a wrong zero shows as impossible masses, and faults name themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from cases import each
from cases import panda_case as longer_case
from sweeps import daily, nightly

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.set_up import look_at_set_up
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import (
    FOUND,
    Identification,
    IdentificationSettings,
    identify,
)

panda_case = partial(longer_case, duration=5.0)
ROOT = Path(__file__).resolve().parents[3]
CUTOFF = IdentificationSettings(cutoff=20.0)
FIVE = np.deg2rad(5.0)


def zero_off(joint: int, angle: float = FIVE) -> Case:
    wrong = AppliedEffect("encoder_offset", (joint,), {"offset": np.array([angle])})
    return panda_case((wrong,))


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
    def test_healthy_arm_has_possible_bodies_no_question_and_no_row(self) -> None:
        """No torque depends on the first zero, about the vertical."""
        result = healthy()
        assert all(check.positive_mass for check in result.physical.before)
        assert result.questions == ()
        assert not [w for w in result.warnings if "no body" in w]
        assert found(result) == {} and len(result.table) == 9
        assert not result.zeros.known[0]
        assert np.rad2deg(result.zeros.deviation[0]) > 5.0

    @pytest.mark.nightly
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
        assert found(result)["joint_zero"] == (joint,)
        (question,) = result.questions
        assert f"zero of joint {joint}" in question and "offsets" in question

    def test_the_correction_that_it_offers_mends_the_arm(self) -> None:
        delta = off(2).zeros.offset * (np.arange(7) == 1)
        case = each(zero_off(2), lambda r: replace(r, q=r.q - delta))
        mended, judged = identify(case, CUTOFF), off(2).validation[1]
        assert mended.questions == ()
        assert all(check.positive_mass for check in mended.physical.before)
        assert mended.validation[1].every.overall < 0.2 * judged.nominal.overall


def late(r: Recording) -> Recording:
    return replace(r, t=r.t[5:], q=r.q[5:], tau=np.asarray(r.tau)[:-5])


def noisy(r: Recording) -> Recording:
    noise = np.random.default_rng(7).standard_normal(r.q.shape)
    return replace(r, q=r.q + 1e-3 * noise)


def saturated(r: Recording) -> Recording:
    limit = np.quantile(np.abs(np.asarray(r.tau)), 0.95, axis=0)
    return replace(r, tau=np.clip(np.asarray(r.tau), -limit, limit))


def resting(r: Recording) -> Recording:
    return replace(r, q=np.where(np.arange(7) == 6, 0.3, r.q))


Fault = Callable[[Recording], Recording]
ROWS: dict[Fault, tuple[str, tuple[int, ...] | None]] = {
    late: ("time_offset", None),
    noisy: ("derivative_noise", None),
    saturated: ("saturated_torque", (1, 2, 3, 4, 5, 6, 7)),
    resting: ("resting_joint", (7,)),
}
"""Row of the table that a fault fires, and its joints."""


EACH = [nightly((fault,)) for fault in ROWS]


class TestTroubleshooting:
    @pytest.mark.parametrize(
        "planted",
        [(late,), (noisy, saturated), *EACH],
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

    def test_stribeck_friction_fires_its_row_and_is_recovered(self) -> None:
        values = {"torque": [4.0, 4.0], "velocity": [0.2, 0.2]}
        planted = AppliedEffect("stribeck_friction", (1, 2), values)
        result = identify(panda_case((planted,)), CUTOFF)
        law = result.choice.law
        assert "low_speed_friction" in found(result)
        assert law.stribeck_speed == pytest.approx(0.2, rel=0.05)
        names = result.columns.names(law)
        drops = [result.physical.value[names.index(x)] for x in ("d1", "d2")]
        assert drops == pytest.approx([4.0, 4.0], rel=0.1)

    def test_what_a_stronger_pull_gains_is_no_stribeck_friction(self) -> None:
        """In 3 s the pull to the nominal arm is worth more than the law: 24 % of the error, the law 4.9 %."""
        values = {"torque": [0.5, 0.5], "velocity": [0.2, 0.2]}
        planted = AppliedEffect("stribeck_friction", (1, 2), values)
        short = panda_case((planted,), noise=0.05, duration=3.0)
        result = identify(short, CUTOFF)
        assert result.choice.law.stribeck_speed == pytest.approx(0.2, rel=0.05)
        assert "low_speed_friction" not in found(result)

    def test_motion_too_small_fires_the_condition(self) -> None:
        assert "condition" in found(identify(panda_case(size=0.06, speed=0.3), CUTOFF))


# What the torque shows of the set-up is refused, with the line that puts it right, or said where it is let pass.


def swapped(r: Recording) -> Recording:
    return replace(r, tau=np.asarray(r.tau)[:, [0, 1, 3, 2, 4, 5, 6]])


def turned(r: Recording) -> Recording:
    return replace(r, tau=np.asarray(r.tau) * [1, 1, 1, -1, 1, 1, 1])


@pytest.mark.parametrize(
    ("fault", "line"),
    [
        (swapped, "columns: [1, 2, 4, 3, 5, 6, 7]"),
        (turned, "scale: [1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0]"),
    ],
)
def test_what_the_case_reads_wrongly_is_refused(fault: Fault, line: str) -> None:
    with pytest.raises(InputError, match="does not say what its log shows") as got:
        gapscope.identify(each(panda_case(), fault), CUTOFF)
    assert line in got.value.remedy


def test_a_base_that_is_mounted_turned_is_refused_with_its_gravity() -> None:
    case = panda_case()
    sideways = replace(case.arm, gravity=np.array([0.0, 9.81, 0.0]))
    with pytest.raises(InputError, match="mounted turned") as got:
        gapscope.identify(replace(case, arm=sideways), CUTOFF)
    shown = got.value.remedy.split("gravity: [")[1].split("]")[0]
    near = [float(x) for x in shown.split(",")]
    assert np.allclose(near, case.arm.gravity, atol=0.7)


@pytest.mark.shared_data
def test_silent_on_an_arm_full_of_friction(data_root: Path) -> None:
    path = ROOT / "experiments" / "cases" / "staubli_tx40.yaml"
    assert not look_at_set_up(load_case(path, data_root=data_root)).misreads
