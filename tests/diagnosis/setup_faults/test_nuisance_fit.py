"""The bounded fit of an arm's ordinary values, on problems small enough to solve by hand."""

from __future__ import annotations

import numpy as np
import synthetic

from gapscope.arm.reading import Reading
from gapscope.diagnosis.setup_faults.fault_samples import sample
from gapscope.diagnosis.setup_faults.nuisance import fold_equations
from gapscope.diagnosis.setup_faults.nuisance_fit import (
    bounded_minimum,
    fitted_gap,
    held_out_gap,
)
from gapscope.diagnosis.thresholds import ORDINARY_PENALTY
from gapscope.model.conditioning import TORQUE_CUTOFF, condition

FREE = np.full(2, -np.inf)
IDENTITY = Reading.identity(synthetic.arm().n_joints)


def test_without_bounds_it_solves_the_normal_equations() -> None:
    a = np.array([[2.0, 1.0], [1.0, 3.0]])
    found = bounded_minimum(a[None], np.array([[4.0, 7.0]]), FREE)[0]
    np.testing.assert_allclose(found, [1.0, 2.0])


def test_a_value_below_its_bound_is_fixed_there_and_the_other_fitted_again() -> None:
    """With x = 0 fixed, the other equation is 3 y = 3."""
    a = np.array([[2.0, 1.0], [1.0, 3.0]])
    found = bounded_minimum(a[None], np.array([[-4.0, 3.0]]), np.array([0.0, -np.inf]))[
        0
    ]
    np.testing.assert_allclose(found, [0.0, 1.0])


def test_a_bound_that_is_kept_has_no_influence() -> None:
    a = np.eye(2)
    found = bounded_minimum(a[None], np.array([[1.0, 2.0]]), np.array([0.0, 1.5]))[0]
    np.testing.assert_allclose(found, [1.0, 2.0])


def test_what_was_fitted_leaves_less_than_what_was_held_out() -> None:
    """The screening of faults leaves out what would not gain even then."""
    segments = [condition(r, TORQUE_CUTOFF) for r in synthetic.case().recordings]
    arm, body = synthetic.arm(), synthetic.body()
    eq = fold_equations(arm, body, sample(segments), IDENTITY)
    held_out, penalty = held_out_gap(eq, IDENTITY)
    fitted, same_penalty = fitted_gap(eq, IDENTITY)
    assert same_penalty == penalty
    assert (np.sum(fitted**2, axis=0) < np.sum(held_out**2, axis=0)).all()


def test_a_rotor_that_takes_most_of_a_torque_is_ordinary() -> None:
    """Behind a high gear it may be 25 times as heavy as what it turns."""
    case = synthetic.case(synthetic.Truth(armature=(0.0, 0.0, 10.0)), seed=3)
    segments = [condition(r, TORQUE_CUTOFF) for r in case.recordings]
    eq = fold_equations(case.arm, synthetic.body(), sample(segments), IDENTITY)
    assert held_out_gap(eq, IDENTITY)[1] < ORDINARY_PENALTY
