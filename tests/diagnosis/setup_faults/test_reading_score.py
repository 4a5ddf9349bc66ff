"""Readings are compared by what they say of the raw columns, whatever the unit in which a column is read."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic

from gapscope.arm.case import Case
from gapscope.arm.reading import Reading
from gapscope.diagnosis.setup_faults.fault_samples import sample
from gapscope.diagnosis.setup_faults.fault_search import decisive
from gapscope.diagnosis.setup_faults.reading_score import ReadingScorer
from gapscope.effects.setup_faults.torque_faults import TorqueUnit
from gapscope.model.conditioning import TORQUE_CUTOFF, condition

AS_READ = Reading.identity(synthetic.N)
TRUTHS = {
    "healthy": synthetic.Truth(),
    "loaded and rubbing": synthetic.Truth(mass=10.0, coulomb=(4.0, 6.0, 2.0)),
    "beyond any arm": synthetic.Truth(
        extra=lambda t, q, dq: 30.0 * np.sin(40.0 * t)[:, None] * np.ones(3)
    ),
}


def scorer(case: Case) -> ReadingScorer:
    segments = [condition(r, TORQUE_CUTOFF) for r in case.recordings]
    return ReadingScorer(case.arm, synthetic.body(), sample(segments))


@pytest.mark.parametrize("label", TRUTHS)
@pytest.mark.parametrize("joints", [(1, 2, 3), (1,), (3,)])
def test_a_torque_divided_by_a_thousand_does_not_win(
    label: str, joints: tuple[int, ...]
) -> None:
    """Its residual in N m is a thousandth as well; not that of the column that was recorded."""
    scores = scorer(synthetic.case(TRUTHS[label], seed=3))
    before = scores.score(AS_READ)
    smaller = TorqueUnit("current", joints, 1e-3).reading(synthetic.N)
    after = scores.score(AS_READ.then(smaller))
    assert after.gain(before) < 0.0 and not decisive(before, after)


def test_a_column_in_another_unit_and_read_in_it_scores_as_one_in_newton_metres() -> (
    None
):
    case, factor = synthetic.case(seed=3), (1e3, 50.0, 200.0)
    unit = TorqueUnit("current", factor=factor)
    recorded = unit.in_case(case, np.random.default_rng(0), case.arm)
    right = scorer(case).score(AS_READ)
    read = scorer(recorded).score(unit.reading(synthetic.N))
    np.testing.assert_allclose(read.residual, right.residual, rtol=1e-6)
    assert read.penalty == pytest.approx(right.penalty)
