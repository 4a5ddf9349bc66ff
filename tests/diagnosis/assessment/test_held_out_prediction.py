"""Held-out prediction: which values predict which half of which fold, and shares as Shapley's values by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import selections
import synthetic
from selections import TableEvidence, term

from gapscope.diagnosis.assessment.held_out_prediction import (
    HeldOutPredictor,
    Share,
    join_halves,
    shapley_value,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.torque_gap import TorqueGap

A, B = term("coulomb_friction", 1), term("armature", 2)


class TestShapley:
    def test_two_effects_that_help_each_other_share_what_they_gain_together(
        self,
    ) -> None:
        worth = {(): 0.0, ("a",): 1.0, ("b",): 2.0, ("a", "b"): 4.0}
        values = {k: np.array([v]) for k, v in worth.items()}
        assert shapley_value("a", ["a", "b"], values) == pytest.approx([1.5])
        assert shapley_value("b", ["a", "b"], values) == pytest.approx([2.5])

    def test_three_effects_of_which_any_two_close_the_gap_share_alike(self) -> None:
        names = ["a", "b", "c"]
        worth = {
            subset: np.array([float(len(subset) >= 2)])
            for subset in [(), *((n,) for n in names)]
        }
        worth |= {
            pair: np.ones(1)
            for pair in [("a", "b"), ("a", "c"), ("b", "c"), ("a", "b", "c")]
        }
        for name in names:
            assert shapley_value(name, names, worth) == pytest.approx([1 / 3])

    def test_an_effect_that_closes_nothing_gets_nothing(self) -> None:
        worth = {(): 0.0, ("a",): 3.0, ("b",): 0.0, ("a", "b"): 3.0}
        values = {k: np.array([v]) for k, v in worth.items()}
        assert shapley_value("b", ["a", "b"], values) == pytest.approx([0.0])


class TestShares:
    def predictor(self, floor: float) -> HeldOutPredictor:
        """RMS 3 without effects, 2 and 2.5 with one, 1 with both, on joint 1; joint 2 is at rest."""
        rms = {frozenset(): 3.0, frozenset({A}): 2.0, frozenset({B}): 2.5}

        def mse(terms: frozenset[Any]) -> np.ndarray:
            return np.tile([rms.get(terms, 1.0) ** 2, 0.0], (2, 1))

        evidence = TableEvidence(
            mse=mse, rows=np.ones((2, 2)), floor2=np.tile([floor**2, 0.0], (2, 1))
        )
        found = selections.selection(A, B, evidence=evidence, scale=2.0)
        return HeldOutPredictor(None, None, found, [], [])  # type: ignore[arg-type]

    def test_they_are_of_the_gap_above_the_floor(self) -> None:
        """Of 2.5 above the floor, A closes (1 + 1.5) / 2, B (0.5 + 1) / 2; the scale cancels."""
        shares = self.predictor(floor=0.5).shares()
        assert shares["coulomb_friction"].value == pytest.approx(1.25 / 2.5)
        assert shares["armature"].value == pytest.approx(0.75 / 2.5)

    def test_they_are_of_what_is_closed_if_that_is_more(self) -> None:
        shares = self.predictor(floor=2.0).shares()
        assert sum(share.value for share in shares.values()) == pytest.approx(1.0)

    def test_equal_folds_leave_no_interval(self) -> None:
        share = self.predictor(floor=0.5).shares()["armature"]
        assert share.low == pytest.approx(0.3) and share.high == pytest.approx(0.3)

    def test_the_interval_holds_nine_of_ten_draws(self) -> None:
        draws = np.concatenate([[0.5], np.linspace(-0.5, 1.5, 201)])
        assert Share.of(draws) == Share(0.5, 0.0, 1.0)
        inner = Share.of(np.concatenate([[0.4], np.linspace(0.0, 1.0, 201)]))
        assert (inner.low, inner.high) == pytest.approx((0.05, 0.95))


def constant(value: float, count: int) -> TorqueGap:
    column = np.zeros((count, 1))
    return TorqueGap(column, column + value, (0, count))


def test_halves_are_joined_in_the_middle() -> None:
    joined = join_halves(constant(1.0, 5), constant(2.0, 5))
    assert joined.predicted.ravel().tolist() == [1.0, 1.0, 2.0, 2.0, 2.0]
    assert joined.edges == (0, 5)


class TestFolds:
    """Values are offsets on joint 1, so that a prediction says which values made it."""

    def predictor(self, set_aside: list[Any]) -> HeldOutPredictor:
        evidence = SimpleNamespace(
            left_out=lambda terms: [(1.0, 2.0), (3.0, 4.0)],
            fit=lambda terms: SimpleNamespace(theta=9.0),
        )

        def corrected(theta: float, terms: Any) -> CorrectedArm:
            return CorrectedArm(synthetic.arm(), self.offset(theta))

        folds = [["short", "long"], ["long"]]
        found = SimpleNamespace(evidence=evidence, corrected=corrected)
        return HeldOutPredictor(synthetic.arm(), None, found, folds, set_aside)  # type: ignore[arg-type]

    def offset(self, theta: float) -> tuple[AppliedEffect, ...]:
        return (AppliedEffect("torque_offset", (1,), {"torque": [theta]}),)

    def gap(self, arm: CorrectedArm, segments: list[str]) -> TorqueGap:
        value = float(arm.value("torque_offset", "torque")[0])
        lengths = [{"short": 2, "long": 4}[s] for s in segments]
        whole = constant(value, sum(lengths))
        edges = tuple(int(x) for x in np.cumsum([0, *lengths]))
        return TorqueGap(whole.measured, whole.predicted, edges)

    def test_each_half_is_predicted_with_values_that_left_it_out(self) -> None:
        gap = self.predictor([]).measured(frozenset(), self.gap)
        assert gap.predicted.ravel().tolist() == [1, 1, 1, 2, 2, 2, 3, 3, 4, 4]
        assert gap.edges == (0, 2, 6, 10)

    def test_recordings_set_aside_are_predicted_alone_with_all_folds_fitted(
        self,
    ) -> None:
        predictor = self.predictor(["short"])
        gap = predictor.measured(frozenset(), self.gap)
        assert gap.predicted.ravel().tolist() == [9.0, 9.0]
        assert predictor.segments == ["short"]
        assert self.predictor([]).segments == ["short", "long", "long"]
