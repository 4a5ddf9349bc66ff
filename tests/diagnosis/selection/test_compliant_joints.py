"""Elasticity and backlash told apart by what is simulated of them."""

from __future__ import annotations

import numpy as np
import pytest
from small_models import model, selection, term
from sweeps import nightly
from synthetic import Truth

from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.selection.fitted_model import fit_terms
from gapscope.diagnosis.selection.questions import (
    best_compliant_joint,
    settle_compliance,
    starts,
)

HEALTHY = Truth()
LOOSE = Truth(play=(0.008, 0.0, 0.0))
SOFT = Truth(stiffness=(1500.0, 0.0, 0.0), damping=(3.0, 0.0, 0.0))
RIVAL = {"backlash": "joint_elasticity", "joint_elasticity": "backlash"}


def test_no_joint_of_a_healthy_arm_is_looked_at() -> None:
    assert starts(model(HEALTHY)) == []
    assert best_compliant_joint(model(HEALTHY)) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "effect"), [(LOOSE, "backlash"), nightly(SOFT, "joint_elasticity")]
)
def test_each_is_named_on_its_joint_and_beats_the_other(
    truth: Truth, effect: str
) -> None:
    found = selection(truth)
    assert {(t.effect, t.joint) for t in found.fit.terms} == {(effect, 1)}
    rival = found.contested.get((effect, RIVAL[effect]))
    assert rival is None or rival < 0


@pytest.mark.slow
def test_the_width_of_free_play_comes_out_right() -> None:
    found = selection(LOOSE)
    (loose,) = found.fit.terms
    assert found.fit.theta[loose.columns[0]] == pytest.approx(0.008, rel=0.12)


@pytest.mark.slow
def test_free_play_in_the_place_of_elasticity_is_replaced() -> None:
    nominal = model(SOFT)
    loose = term(nominal, "backlash", 1)
    rattling = fit_terms(nominal, frozenset({loose}), {loose: np.array([0.004])})
    assert {t.effect for t in rattling.fit.terms} == {"backlash"}
    settled = settle_compliance(rattling)
    assert {(t.effect, t.joint) for t in settled.model.fit.terms} == {
        ("joint_elasticity", 1)
    }
    assert settled.contested["joint_elasticity", "backlash"] < 0


@pytest.mark.nightly
def test_the_column_of_free_play_predicts_another_width() -> None:
    """A tenth more or less of the width: of what that changes the column leaves no more than a part."""
    nominal = model(LOOSE)
    loose = term(nominal, "backlash", 1)
    gaps = {}
    for width in (0.008, 0.0088):
        theta = np.zeros(nominal.terms.size)
        theta[loose.columns[0]] = width
        gaps[width] = Linearisation(nominal.data, theta, nominal.terms)
    places = np.array(loose.columns)
    near, far = (
        np.vstack([part.gap for part in gaps[width]._rows]) for width in (0.008, 0.0088)
    )
    column = np.vstack([part.columns[:, :, places[0]] for part in gaps[0.008]._rows])
    changed = far - near
    left = changed + 0.0008 * column
    assert np.square(left[:, 0]).sum() < 0.5 * np.square(changed[:, 0]).sum()


@pytest.mark.parametrize(("lag", "possible"), [(0.005, True), (0.3, False)])
def test_what_creeps_is_no_spring(lag: float, possible: bool) -> None:
    nominal = model(HEALTHY)
    soft = term(nominal, "joint_elasticity", 2)
    theta = np.zeros(nominal.terms.size)
    theta[list(soft.columns)] = 1e-3, lag * 1e-3
    impossible = nominal.terms.impossible(
        theta, frozenset({soft}), np.full(nominal.terms.size, -np.inf)
    )
    assert (soft not in impossible) == possible
