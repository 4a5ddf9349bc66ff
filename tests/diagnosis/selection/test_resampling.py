"""Spread of fitted values: what nuisances of the size of their prior add, and what the data tell apart."""

from __future__ import annotations

import numpy as np
import pytest
from small_models import model
from synthetic import Truth

from gapscope.diagnosis.model.normal_equations import NormalEquations
from gapscope.diagnosis.selection.evidence import Evidence
from gapscope.diagnosis.selection.fitted_model import fit_terms
from gapscope.diagnosis.selection.resampling import bootstrap

FIRST = np.array([0])


def equations(angle: float, samples: float, deviation: float) -> NormalEquations:
    """One term and one nuisance, their columns at an angle, with so many samples of variance 1."""
    columns = np.array([[1.0, np.cos(angle), 2.0], [0.0, np.sin(angle), 0.0]])
    prior = np.array([[deviation**-2]])
    return NormalEquations(samples * columns.T @ columns, 1, prior)


def test_a_nuisance_of_the_same_form_spreads_the_value_by_its_own_deviation() -> None:
    for samples in (1.0, 1e6):
        root = equations(0.0, samples, 0.06).spread_by_nuisances(FIRST)
        assert np.hypot.reduce(root, axis=1) == pytest.approx([0.06], rel=1e-3)


def test_a_nuisance_that_the_data_tell_apart_spreads_nothing() -> None:
    root = equations(np.pi / 2, 1e6, 0.06).spread_by_nuisances(FIRST)
    assert np.abs(root).max() < 1e-6


def test_in_between_it_is_the_deviation_that_the_fit_really_has() -> None:
    """Errors of the prior's size put into the data move the fitted value by as much."""
    angle, samples, deviation = 0.5, 50.0, 0.3
    normal = equations(angle, samples, deviation)
    x = np.array([[1.0, np.cos(angle)], [0.0, np.sin(angle)]])
    y = x[:, 1]  # a nuisance of 1, and no term
    total = samples * np.column_stack([x, y]).T @ np.column_stack([x, y])
    pulled = NormalEquations(total, 1, np.array([[deviation**-2]])).solve(FIRST)
    root = normal.spread_by_nuisances(FIRST)
    assert abs(root[0, 0]) == pytest.approx(abs(pulled[0]) * deviation, rel=1e-6)


def test_intervals_grow_with_the_error_of_the_nominal_inertials() -> None:
    nominal = model(Truth(mass=1.5, com=(0.1, 0.0, 0.05)))
    (payload,) = nominal.terms.of("payload")
    loaded = fit_terms(nominal, frozenset({payload}))

    def deviation(evidence: Evidence) -> float:
        draws = bootstrap(evidence, loaded.fit.terms, np.random.default_rng(1))
        return float(draws[:, payload.columns[0]].std())

    by_error = sorted(loaded.evidences, key=lambda e: e.inertial_error)
    assert deviation(by_error[-1]) > 2.0 * deviation(by_error[0])
