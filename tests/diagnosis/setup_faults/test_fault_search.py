"""When a fault is decisive, by scores made by hand."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.setup_faults.fault_search import decisive
from gapscope.diagnosis.setup_faults.reading_score import ReadingScore


def score(*residual: float) -> ReadingScore:
    """The same residual on four folds."""
    return ReadingScore(np.tile(residual, (4, 1)), penalty=3.0)


def test_an_exchange_that_explains_both_joints_is_decisive() -> None:
    assert decisive(score(0.1, 1.2, 1.4), score(0.1, 0.2, 0.3), exchanged=[1, 2])


def test_one_that_leaves_a_joint_of_its_own_worse_is_not() -> None:
    """As two joints of one motor whose torques are exchanged: the second is explained, the first is less so."""
    before, after = score(0.1, 1.4, 1.9), score(0.1, 2.1, 0.3)
    assert decisive(before, after)
    assert not decisive(before, after, exchanged=[1, 2])
    assert decisive(before, after, exchanged=[2])
