"""The excess residual over small numbers worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import selections
from selections import TableEvidence, term

from gapscope.diagnosis.assessment.excess_residual import (
    ExcessResidual,
    elementwise_max,
    excess_residual,
    excess_residual_set_aside,
    ratio_by_chance,
)
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import FALSE_ALARM_RATE
from gapscope.model.torque_gap import TorqueGap

FRICTION = term("coulomb_friction", 1)


def residual(
    before: Any, after: Any, ratio: Any, compliant: bool = False
) -> ExcessResidual:
    chance = np.zeros(len(before))
    ratio = np.array(ratio)
    return ExcessResidual(
        np.array(before), np.array(after), ratio, ratio, chance, compliant
    )


class TestAbove:
    def test_a_joint_that_effects_improved_needs_less_ratio_than_one_that_none_did(
        self,
    ) -> None:
        assert residual([0.5, 0.1], [0.1, 0.1], [1.4, 1.4]).above.tolist() == [
            True,
            False,
        ]

    def test_a_small_excess_is_none_whatever_its_ratio(self) -> None:
        assert residual([0.5, 0.5], [0.011, 0.013], [9.0, 9.0]).above.tolist() == [
            False,
            True,
        ]

    def test_a_ratio_that_chance_reaches_is_none(self) -> None:
        """Of few independent samples."""
        one = residual([0.5, 0.5], [0.4, 0.4], [1.7, 2.1])
        few = replace(one, by_chance=np.array([1.9, 1.9]))
        assert few.above.tolist() == [False, True]


class TestOpen:
    """Of squares 0.12 may be left, 0.45 by a compliant joint; on one joint half of its own gap."""

    def test_a_share_of_the_squares_may_be_left(self) -> None:
        assert not residual([1.0], [0.34], [3.0]).open
        assert residual([1.0], [0.35], [3.0]).open

    def test_a_compliant_joint_may_leave_more(self) -> None:
        assert not residual([1.0], [0.49], [3.0], compliant=True).open

    def test_a_joint_with_most_of_its_own_gap_is_open_however_small_beside_others(
        self,
    ) -> None:
        assert residual([1.0, 0.1], [0.0, 0.06], [1.0, 3.0]).open
        assert not residual([1.0, 0.1], [0.0, 0.045], [1.0, 3.0]).open

    def test_joints_at_the_floor_do_not_count(self) -> None:
        assert not residual([1.0], [0.9], [1.2]).open

    def test_a_wider_gap_before_explains_more(self) -> None:
        left = residual([1.0], [0.4], [3.0])
        assert left.open
        assert not left.exceeds_explained_share_of(np.array([2.0]))


def found(
    nominal: list[float], after: list[float], floor2: list[float], **more: Any
) -> Selection:
    evidence = TableEvidence(
        mse=lambda terms: np.array([after]), floor2=np.array([floor2])
    )
    return selections.selection(
        FRICTION, evidence=evidence, nominal_mse=np.array([nominal]), **more
    )


class TestOnFolds:
    def test_squares_above_the_floor_over_the_scale(self) -> None:
        selection = found([25.0, 1.0], [4.0, 1.0], [1.0, 1.0], scale=2.0)
        out = excess_residual(selection, gap=np.array([9.0, 9.0]))
        assert out.before == pytest.approx([np.sqrt(24.0) / 2, 0.0])
        assert out.after == pytest.approx([np.sqrt(3.0) / 2, 0.0])
        assert out.ratio == pytest.approx([2.0, 1.0]) and not out.compliant

    def test_the_smaller_of_both_measurements_counts(self) -> None:
        selection = found([25.0, 1.0], [4.0, 1.0], [1.0, 1.0])
        out = excess_residual(selection, gap=np.array([1.5, 9.0]))
        assert out.ratio == pytest.approx([1.5, 1.0])

    def test_floors_rise_to_the_quietest_joint_but_not_beyond_twice(self) -> None:
        """Gaps of 3 and 1.5 floors: the floors rise by 1.5; of 9 and 3: by 2."""
        far = np.array([99.0, 99.0])
        loud = excess_residual(found([9.0, 9.0], [9.0, 2.25], [1.0, 1.0]), far)
        assert loud.ratio == pytest.approx([2.0, 1.0])
        louder = excess_residual(found([81.0, 81.0], [81.0, 9.0], [1.0, 1.0]), far)
        assert louder.ratio == pytest.approx([4.5, 1.5])

    def test_folds_count_by_their_rows(self) -> None:
        evidence = TableEvidence(
            mse=lambda terms: np.array([[4.0, 1.0], [1.0, 1.0]]),
            rows=np.array([[1.0, 1.0], [3.0, 1.0]]),
            floor2=np.ones((2, 2)),
        )
        selection = selections.selection(
            FRICTION, evidence=evidence, nominal_mse=np.ones((2, 2))
        )
        out = excess_residual(selection, np.array([9.0, 9.0]))
        assert out.ratio == pytest.approx([np.sqrt(7 / 4), 1.0])

    def test_a_compliant_joint_is_noted(self) -> None:
        selection = selections.selection(term("backlash", 1))
        assert excess_residual(selection, np.ones(2)).compliant


def test_recordings_set_aside_are_measured_at_the_full_rate() -> None:
    """A torque of +-2 has the scale 2; gaps of 5 and 1.25 over a floor of 1."""
    torque = np.array([[2.0, 2.0], [-2.0, -2.0]])
    before = TorqueGap(torque, torque - 5.0, (0, 2))
    after = TorqueGap(torque, torque - 1.25, (0, 2))
    out = excess_residual_set_aside(
        selections.selection(FRICTION), before, after, np.ones(2)
    )
    assert out.before == pytest.approx(np.full(2, np.sqrt(24.0) / 2))
    assert out.after == pytest.approx(np.full(2, 0.75 / 2))
    assert out.ratio == pytest.approx([1.25, 1.25])


def test_of_two_the_larger_counts_on_each_joint() -> None:
    one, other = (
        residual([1.0, 0.0], [0.3, 0.1], [2.0, 1.0]),
        residual([0.5, 2.0], [0.4, 0.0], [1.0, 3.0]),
    )
    both = elementwise_max(one, other)
    assert both.before.tolist() == [1.0, 2.0]
    assert both.after.tolist() == [0.4, 0.1]
    assert both.ratio.tolist() == [2.0, 3.0]


def test_chance_exceeds_the_floor_by_more_the_fewer_samples_there_are() -> None:
    """chi2 of 40 degrees of freedom exceeds 66.77 in half a percent: sqrt(66.77 / 40) = 1.292."""
    assert pytest.approx(0.005) == FALSE_ALARM_RATE / selections.JOINTS
    few, many = (
        ratio_by_chance(selections.selection(evidence=TableEvidence(samples=samples)))
        for samples in (40.0, 4000.0)
    )
    assert few == pytest.approx(1.292, abs=1e-3)
    assert (few > many).all() and (many > 1.0).all()
