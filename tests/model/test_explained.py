"""What terms explain of motions that are held out: values of all others, and where the gap falls."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.arm.recording import Recording
from gapscope.diagnosis.selection.search import EVERYONE, search_of
from gapscope.model.difference import Fit
from gapscope.model.explained import explained, held_out
from gapscope.model.terms import Candidate, Terms

RUBBING = Candidate(Terms(synthetic.N).of("coulomb_friction")[1], EVERYONE)


def rubbing(torque: float) -> list[Recording]:
    """More Coulomb friction on joint 2 [N m]."""
    truth = Truth(coulomb=(0.0, torque, 0.0))
    return list(synthetic.recordings(truth, duration=6.0))


def fitted(recordings: list[Recording]) -> tuple[Fit, Fit]:
    """The hypothesis, and as its values are fitted."""
    searching = search_of(synthetic.arm(), recordings)
    searching.unsearched()
    fit = searching.with_some([RUBBING], {})
    return fit, searching.least_squares(fit)


def test_the_gap_falls_on_the_joint_of_the_term_alone() -> None:
    fit, by_values = fitted(rubbing(2.0))
    known = explained(fit, 0, [RUBBING], by_values)
    before, after = known.nrmse(known.before), known.nrmse(known.after)
    assert after[1] < 0.1 * before[1]
    assert after[[0, 2]] == pytest.approx(before[[0, 2]], rel=0.2)
    np.testing.assert_allclose(known.with_only([RUBBING]), known.after)


def test_each_motion_is_predicted_by_all_others_once() -> None:
    """Of three recordings one has more friction: without its own motions less is expected of it."""
    fit, _ = fitted([*rubbing(1.0)[:2], rubbing(1.6)[2]])
    parts = list(held_out(fit, 0, [RUBBING]))
    rows = fit.contrast.design.rows
    assert (sum(part.rows.astype(int) for part in parts) == 1).all()
    value = {
        int(rows.recording[part.rows][0]): float(part.answer.values[RUBBING][0])
        for part in parts
    }
    whole = float(fit.answer.values[RUBBING][0])
    assert value[2] < whole < value[0]
