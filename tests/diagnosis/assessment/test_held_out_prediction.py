"""Held-out prediction: which values predict which half of which fold, and shares as Shapley's values by hand."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import documents
import numpy as np
import pytest
import selections
import synthetic
from selections import TableEvidence, term

from gapscope.diagnosis.assessment.curves import Variable, curve_of
from gapscope.diagnosis.assessment.held_out_prediction import (
    ExcessResidual,
    HeldOutPredictor,
    Share,
    elementwise_max,
    excess_residual,
    excess_residual_set_aside,
    join_halves,
    ratio_by_chance,
    shapley_value,
)
from gapscope.diagnosis.assessment.predictable_share import (
    Folds,
    Predictable,
    amplitudes,
    predict_held_out,
    predict_oscillation,
    predictable,
)
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.locate import MotionRows
from gapscope.diagnosis.selection.fitted_model import Selection
from gapscope.diagnosis.thresholds import FALSE_ALARM_RATE
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import low_pass
from gapscope.model.torque_gap import TorqueGap
from gapscope.reports.diagnosis import render

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


# What a flexible model predicts of what is left: noise not at all, a curve by its variable, a hum by its frequency.


RATE, SECONDS, N = 250.0, 20.0, 6
FLOOR = np.full(N, 0.1)


def rows(recordings: int = 3, seconds: float = SECONDS) -> MotionRows:
    """Sums of sines, other ones in each recording."""
    count, parts = int(seconds * RATE), []
    for seed in range(recordings):
        rng = np.random.default_rng(seed)
        t = np.arange(count) / RATE
        w, a, p = (
            rng.uniform(0.5, 3.0, (4, N)),
            rng.uniform(0.2, 0.5, (4, N)),
            rng.uniform(0.0, 6.0, (4, N)),
        )
        angle = w * t[:, None, None] + p
        parts.append(
            [
                (a * f * g(angle)).sum(axis=1)
                for f, g in ((1, np.sin), (w, np.cos), (-(w**2), np.sin))
            ]
        )
    q, dq, ddq = (np.vstack(x) for x in zip(*parts, strict=True))
    segment = np.repeat(np.arange(recordings), count)
    return MotionRows(
        np.tile(np.arange(count) / RATE, recordings),
        q,
        dq,
        ddq,
        segment,
        (RATE,) * recordings,
    )


def found(
    left: np.ndarray, at: MotionRows, joint: int = 1, floor: np.ndarray = FLOOR
) -> Predictable:
    """What is predicted of a torque that is left on joint 1, with noise at the floor on top."""
    noise = np.random.default_rng(9).standard_normal((len(at.t), N))
    error = low_pass(np.sqrt(RATE / 24.0) * floor[0] * noise, RATE, 12.0)
    error[:, 0] += left
    load = 20.0 * np.cos(at.q)
    gap = TorqueGap(load + error, load, (0, len(at.t)))
    return predictable(gap, at, floor, [joint])[0]


def test_noise_is_white_and_cannot_be_predicted() -> None:
    at = rows()
    said = found(np.zeros(len(at.t)), at, floor=0.6 * FLOOR)
    loud = found(np.zeros(len(at.t)), at)
    assert loud.share == 0.0 and said.share < 0.05 and max(said.by.values()) < 0.05
    noise = found(np.zeros(len(at.t)), at, joint=2)
    assert noise.whiteness_p > 1e-3


CAUSES = {
    "position": lambda at: 0.6 * np.sin(6.0 * at.q[:, 0]),
    "velocity": lambda at: 0.5 * np.tanh(at.dq[:, 0] / 0.7) - 0.5 * at.dq[:, 0] ** 2,
    "direction": lambda at: 0.5 * np.sign(at.dq[:, 0]),
    "acceleration": lambda at: 0.1 * at.ddq[:, 0] * np.abs(at.ddq[:, 0]),
    "load": lambda at: 0.5 * np.cos(at.q[:, 0]) ** 3,
    "time": lambda at: np.exp(-at.t / 3.0),
    "frequency": lambda at: 0.5 * np.sin(2 * np.pi * 6.385 * at.t + at.segment),
}


@pytest.mark.parametrize("name", CAUSES)
def test_each_variable_is_told_by_its_gap(name: str) -> None:
    at = rows()
    left = CAUSES[name](at)
    said = found(left, at)
    assert said.share > 0.75, said
    assert said.by[name] > 0.75
    assert said.by[name] >= max(said.by.values()) - 0.05
    assert said.whiteness_p < 1e-6
    if name in ("position", "velocity"):
        x = {"position": at.q, "velocity": at.dq}[name][:, 0]
        assert said.curve.variable == name
        error = left - np.interp(x, said.curve.x, said.curve.y)
        assert np.std(error) < 0.4 * np.std(left)
    if name == "frequency":
        assert abs(said.curve.x[np.argmax(said.curve.y)] - 6.385) < 0.1
        assert said.curve.y.max() == pytest.approx(0.5, rel=0.2)


def test_several_variables_together_predict_what_none_does_alone() -> None:
    at = rows()
    said = found(np.sin(3.0 * at.q[:, 0]) * np.tanh(at.dq[:, 0] / 0.5), at)
    assert said.share > 0.6 > max(said.by.values()) + 0.2


def test_one_recording_is_judged_on_its_halves() -> None:
    at = rows(1, 40.0)
    assert found(0.6 * np.sin(3.0 * at.q[:, 0]), at).by["position"] > 0.7


def test_it_is_quick_and_the_same_every_time() -> None:
    at = rows()
    gap = TorqueGap(
        np.random.default_rng(0).standard_normal((len(at.t), N)),
        20.0 * np.cos(at.q),
        (0, len(at.t)),
    )
    start = time.process_time()
    first = predictable(gap, at, FLOOR, [1, 2, 3])
    assert time.process_time() - start < 4.0  # 60 s of recordings, three open joints
    assert [p.document() for p in first] == [
        p.document() for p in predictable(gap, at, FLOOR, [1, 2, 3])
    ]
    assert predictable(gap, at, FLOOR, []) == []


def test_it_is_in_the_document_and_in_the_report(tmp_path) -> None:
    at, document = rows(), documents.unexplained()
    entry = found(CAUSES["position"](at), at).document()
    document["unexplained"]["predictable"] = [{**entry, "joint": 4}]
    validate(document)
    render(documents.diagnosis(document), tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (
        "J4: " in html
        and "can be predicted" in html
        and 'data-guess="0"' in html
        and "Its position alone" in html
    )


# The excess residual over small numbers worked out by hand.


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


def selected(
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
        selection = selected([25.0, 1.0], [4.0, 1.0], [1.0, 1.0], scale=2.0)
        out = excess_residual(selection, gap=np.array([9.0, 9.0]))
        assert out.before == pytest.approx([np.sqrt(24.0) / 2, 0.0])
        assert out.after == pytest.approx([np.sqrt(3.0) / 2, 0.0])
        assert out.ratio == pytest.approx([2.0, 1.0]) and not out.compliant

    def test_the_smaller_of_both_measurements_counts(self) -> None:
        selection = selected([25.0, 1.0], [4.0, 1.0], [1.0, 1.0])
        out = excess_residual(selection, gap=np.array([1.5, 9.0]))
        assert out.ratio == pytest.approx([1.5, 1.0])

    def test_floors_rise_to_the_quietest_joint_but_not_beyond_twice(self) -> None:
        """Gaps of 3 and 1.5 floors: the floors rise by 1.5; of 9 and 3: by 2."""
        far = np.array([99.0, 99.0])
        loud = excess_residual(selected([9.0, 9.0], [9.0, 2.25], [1.0, 1.0]), far)
        assert loud.ratio == pytest.approx([2.0, 1.0])
        louder = excess_residual(selected([81.0, 81.0], [81.0, 9.0], [1.0, 1.0]), far)
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


# Ridge regression over folds: what holds on all folds is predicted, what holds on one alone is not.


X = np.tile(np.linspace(-1.0, 1.0, 50), 3)[:, None]
FOLD = np.repeat([0, 1, 2], 50)
ALL = np.ones(150, dtype=bool)


def test_a_line_is_predicted_from_the_other_folds() -> None:
    y = 2.0 * X[:, 0]
    predicted = predict_held_out(X, y, Folds(FOLD, ALL))
    np.testing.assert_allclose(predicted, y, atol=2e-3)


def test_a_slope_that_differs_on_every_fold_is_not() -> None:
    """Slopes 1, -1 and 0: whatever two folds say, the third knows nothing of it."""
    y = X[:, 0] * np.array([1.0, -1.0, 0.0])[FOLD]
    assert not predict_held_out(X, y, Folds(FOLD, ALL)).any()


def test_rows_that_may_not_be_fitted_are_predicted_but_teach_nothing() -> None:
    wrong = np.arange(150) % 2 == 0
    y = np.where(wrong, 2.0 * X[:, 0] + 0.1, 2.0 * X[:, 0])
    fitted = predict_held_out(X, y, Folds(FOLD, ~wrong))
    np.testing.assert_allclose(fitted, 2.0 * X[:, 0], atol=2e-3)


# Curves of a gap over one variable: hat functions, knots and smoothness.


SPREAD = Variable("velocity", "rad/s", np.linspace(-1.0, 1.0, 400) ** 3)


def test_hats_interpolate_and_add_up_to_one() -> None:
    hats = SPREAD.hats()
    np.testing.assert_allclose(hats.sum(axis=1), 1.0)
    np.testing.assert_allclose(hats @ SPREAD.knots, SPREAD.values, atol=1e-12)


def test_a_straight_gap_gives_a_straight_curve() -> None:
    """Second differences are held small, and those of a line over even knots are zero."""
    even = Variable("load", "N m", np.linspace(0.0, 8.0, 400))
    curve = curve_of(even, 3.0 * even.values + 1.0)
    np.testing.assert_allclose(curve.y, 3.0 * curve.x + 1.0, rtol=1e-4)
    assert (curve.variable, curve.unit) == ("load", "N m")


def test_a_direction_has_three_knots() -> None:
    direction = Variable("direction", "1", np.repeat([-1.0, 1.0], 50))
    curve = curve_of(direction, 0.5 * direction.values)
    assert curve.x.tolist() == [-1.0, 0.0, 1.0]
    assert curve.y == pytest.approx([-0.5, 0.0, 0.5], abs=0.02)


def test_a_variable_that_stands_still_has_a_curve() -> None:
    still = Variable("position", "rad", np.full(30, 2.0))
    assert still.knots.tolist() == [1.0, 3.0]
    assert np.isfinite(curve_of(still, np.ones(30)).y).all()


# An oscillation at one frequency: predicted on the other half of its recording, with its amplitude.


T = np.arange(0.0, 20.0, 0.02)
SEGMENT = np.zeros(len(T), dtype=int)
HALF = (T >= 10.0).astype(int)


def test_each_half_is_predicted_from_the_other() -> None:
    gap = 0.5 * np.sin(2 * np.pi * 3.0 * T + 0.7)
    predicted = predict_oscillation(T, gap, SEGMENT, HALF)
    assert np.std(gap - predicted) < 0.2 * np.std(gap)  # frequencies are tried in steps


def test_a_phase_that_jumps_between_the_halves_is_not() -> None:
    gap = np.sin(2 * np.pi * 3.0 * T + np.pi * HALF)
    predicted = predict_oscillation(T, gap, SEGMENT, HALF)
    assert np.std(gap - predicted) > np.std(gap)


def test_a_recording_without_a_rest_is_predicted_as_zero() -> None:
    gap = np.sin(2 * np.pi * 3.0 * T)
    assert not predict_oscillation(T, gap, SEGMENT, SEGMENT).any()


def test_amplitudes_are_root_mean_squares_over_recordings() -> None:
    """3 and 1 on two recordings alike in length: sqrt((9 + 1) / 2)."""
    segment = HALF
    gap = np.where(segment == 0, 3.0, 1.0) * np.sin(2 * np.pi * 3.0 * T)
    (on, off) = amplitudes(T, gap, segment, np.array([3.0, 6.0]))
    assert on == pytest.approx(np.sqrt(5.0), rel=1e-3) and off < 1e-3
