"""Priors of the nuisances, on numbers to check by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.model.nuisance_prior import data_sheet_prior
from gapscope.diagnosis.thresholds import INERTIAL_ERROR, INERTIAL_ERRORS


def test_a_level_widens_the_inertials_of_a_data_sheet_and_not_its_sensors() -> None:
    prior = data_sheet_prior(np.eye(2), 1)
    assert np.diag(prior.at(0.01)) == pytest.approx([1e4, 1e4, 1.0])


def test_sizes_scale_the_errors_of_the_inertials_together() -> None:
    errors = np.array([[1.0, 0.0], [0.5, 0.2]])
    sizes = data_sheet_prior(errors, 1).sizes
    for root, size in zip(sizes.roots, INERTIAL_ERRORS, strict=True):
        assert root[:2, :2] == pytest.approx(size * errors)
        assert root[2, 2] == 1.0
    # the usual size is the likeliest, and those that are not seen scatter about those that are
    likeliest = INERTIAL_ERRORS[np.argmax(sizes.log_prior)]
    assert likeliest == pytest.approx(INERTIAL_ERROR, rel=0.2)
    assert sizes.unseen.sum(axis=1) == pytest.approx(1.0)
    assert (np.diag(sizes.unseen) == sizes.unseen.max(axis=1)).all()
