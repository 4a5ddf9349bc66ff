"""What exceeds the noise floor once the effects found are added, over small numbers worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapscope.diagnosis.assessment.excess_residual import (
    ExcessResidual,
    excess_residual,
)
from gapscope.diagnosis.thresholds import FALSE_ALARM_RATE


def residual(
    before: list[float],
    after: list[float],
    ratio: list[float],
    compliant: bool = False,
) -> ExcessResidual:
    each = (np.array(x) for x in (before, after, ratio, np.zeros(len(before))))
    return ExcessResidual(*each, compliant)


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


class TestOfGaps:
    """Gaps of two joints over floors of 1 N m."""

    @staticmethod
    def left(
        before: list[float],
        after: list[float],
        scale: float = 1.0,
        samples: float = 1e9,
    ) -> ExcessResidual:
        each = (before, after, [1.0, 1.0], [scale, scale], [samples, samples])
        return excess_residual(*map(np.array, each), compliant=False)

    def test_squares_above_the_floor_over_the_scale(self) -> None:
        out = self.left([5.0, 1.0], [2.0, 1.0], scale=2.0)
        assert out.before == pytest.approx([np.sqrt(24.0) / 2, 0.0])
        assert out.after == pytest.approx([np.sqrt(3.0) / 2, 0.0])
        assert out.ratio == pytest.approx([2.0, 1.0])

    def test_floors_rise_to_the_quietest_joint_but_not_beyond_twice(self) -> None:
        """Gaps of 3 and 1.5 floors: the floors rise by 1.5; of 9 and 3: by 2."""
        loud, louder = (self.left(x, x) for x in ([3.0, 1.5], [9.0, 3.0]))
        assert loud.ratio == pytest.approx([2.0, 1.0])
        assert louder.ratio == pytest.approx([4.5, 1.5])

    def test_chance_exceeds_the_floor_by_more_the_fewer_samples_there_are(
        self,
    ) -> None:
        """chi2 of 40 degrees of freedom exceeds 66.77 in half a percent: sqrt(66.77 / 40) = 1.292."""
        assert pytest.approx(0.005) == FALSE_ALARM_RATE / 2
        few, many = (
            self.left([1.0, 1.0], [1.0, 1.0], samples=n).by_chance for n in (40.0, 4e3)
        )
        assert few == pytest.approx(1.292, abs=1e-3)
        assert (few > many).all() and (many > 1.0).all()
