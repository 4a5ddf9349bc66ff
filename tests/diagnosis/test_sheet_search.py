"""What recordings show beside the data sheet, by one contrast, on a three-joint arm whose sheet is right but for it."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis.synthetic import COULOMB, Truth, arm, recordings
from sweeps import nightly

from gapscope.diagnosis.selection.sheet_search import ERRORS, sheet_search
from gapscope.model.difference import Difference


def found(truth: Truth) -> Difference:
    """What the search finds in three recordings of 6 s."""
    return sheet_search(arm(), recordings(truth, duration=6.0)).run()


def named(difference: Difference) -> dict[tuple[str, int], np.ndarray]:
    values = difference.fit.values
    return {(one.effect, one.term.joint): x for one, x in values.items()}


def test_an_arm_as_its_data_sheet_says_has_nothing():
    assert not named(found(Truth()))


@pytest.mark.parametrize(
    ("truth", "name", "joint", "value"),
    [
        ({"coulomb": (0.0, 0.8 * COULOMB[1], 0.0)}, "coulomb_friction", 2, 0.8 * COULOMB[1]),
        ({"mass": 1.0, "com": (0.05, 0.0, 0.1)}, "payload", 0, 1.0),
        nightly({"scale": (0.0, 0.15, 0.0)}, "torque_scale", 2, 0.15),
        nightly({"offset": (0.0, 1.0, 0.0)}, "torque_offset", 2, 1.0),
        nightly({"tilt": (0.05, 0.0)}, "base_tilt", 0, 0.05),
        nightly({"delay": (0.0, 0.0, 0.015)}, "actuator_delay", 3, 0.015),
    ],
)  # fmt: skip
def test_one_effect(truth, name, joint, value):
    one = named(found(Truth(**truth)))
    assert list(one) == [(name, joint)]
    assert one[name, joint][0] == pytest.approx(value, rel=0.15)


def test_every_hypothesis_counts_with_the_errors_that_suit_it():
    levels = found(Truth()).fit.levels
    assert set(levels) == set(ERRORS)
    totals = [levels[error].total for error in ERRORS]
    # a data sheet that is right has small errors
    assert int(np.argmax(totals)) < len(ERRORS) // 2
