"""Priors of the nuisances, on numbers to check by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.diagnosis.model.nuisance_prior import (
    ReferenceErrors,
    data_sheet_prior,
    reference_prior,
)
from gapscope.diagnosis.thresholds import (
    INERTIAL_ERROR,
    INERTIAL_ERRORS,
    REFERENCE_GAIN,
)


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


def errors(
    covariance: np.ndarray, day_to_day: tuple[float, ...] = (0.0, 0.0)
) -> ReferenceErrors:
    return ReferenceErrors(
        covariance,
        np.array(day_to_day),
        lambda motion: motion.q[:, :, None],
        np.ones(1),
        np.ones(1),
    )


def test_a_reference_gives_precision_in_the_units_of_the_columns() -> None:
    """One inertial with unit 2 and variance 4, one joint parameter of variance 9: 4 / 4 = 1 and 9."""
    prior = reference_prior(errors(np.diag([4.0, 9.0])), np.array([2.0]), 1)
    expected = [1.0, 1 / 9, REFERENCE_GAIN**-2]
    assert np.diag(prior.at(1.0)) == pytest.approx(expected)
    assert np.diag(prior.at(2.0)) == pytest.approx([0.25, 1 / 36, REFERENCE_GAIN**-2])
    for root, level in zip(prior.sizes.roots, (1.0, 2.0), strict=False):
        covariance = np.diag(1.0 / np.diag(prior.at(level)))
        assert root @ root.T == pytest.approx(covariance)


def test_what_differs_from_day_to_day_keeps_its_size() -> None:
    """Friction known to 3, which differs by 4 from day to day: 5 together, and at twice the error sqrt(36 + 16)."""
    prior = reference_prior(
        errors(np.diag([1.0, 9.0]), (0.0, 16.0)), np.array([1.0]), 1
    )
    assert prior.at(1.0)[1, 1] == pytest.approx(1 / 25)
    assert prior.at(2.0)[1, 1] == pytest.approx(1 / 52)


def test_what_two_errors_have_in_common_stays() -> None:
    covariance = np.array([[2.0, 1.0], [1.0, 2.0]])
    prior = reference_prior(errors(covariance), np.array([1.0]), 1)
    assert prior.at(1.0)[:2, :2] == pytest.approx(np.linalg.inv(covariance))


def test_a_link_without_mass_has_no_error() -> None:
    prior = reference_prior(errors(np.diag([4.0, 9.0])), np.array([0.0]), 1)
    assert prior.at(1.0)[0, 0] > 1e6
    assert prior.at(1.0)[1, 1] == pytest.approx(1 / 9)
