"""An arm that hangs, or is mounted on a wall, is named as that: no linearisation reaches so far."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from sweeps import nightly
from synthetic import Truth

from gapscope.diagnosis.selection.fitted_model import nominal_model
from gapscope.diagnosis.selection.turned_base import add_turned_base
from gapscope.model.conditioning import condition, thinned

CUTOFF = 12.0


@pytest.mark.parametrize(
    ("roll", "pitch"),
    [
        (np.pi, 0.0),
        (-1.4, 0.0),
        *(
            nightly(*angles)
            for angles in ((3.0, 0.2), (0.1, 1.4), (2.35, 0.0), (-2.2, 0.7))
        ),
    ],
)
def test_its_angles_are_found(roll: float, pitch: float) -> None:
    nominal = _nominal(Truth(tilt=(roll, pitch)))
    turned = add_turned_base(nominal)
    (term,) = turned.fit.terms
    assert term.effect == "base_tilt"
    np.testing.assert_allclose(
        turned.fit.theta[list(term.columns)], [roll, pitch], atol=0.02
    )


@pytest.mark.parametrize(
    "truth",
    [
        nightly(Truth()),
        nightly(Truth(mass=3.0, com=(0.2, 0.0, 0.0))),
        Truth(tilt=(0.1, 0.1)),
    ],
)
def test_an_upright_arm_is_left_alone(truth: Truth) -> None:
    nominal = _nominal(truth)
    assert add_turned_base(nominal) is nominal


def _nominal(truth: Truth):  # type: ignore[no-untyped-def]
    folds = [
        [thinned(segment, 100.0) for segment in condition(recording, CUTOFF)]
        for recording in synthetic.recordings(truth, duration=6.0)[1:]
    ]
    return nominal_model(synthetic.arm(), synthetic.body(), folds, CUTOFF)
