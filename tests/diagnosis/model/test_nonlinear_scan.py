"""Shapes: the parameters that are searched are found from nothing, and from a wrong value of a term in use."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.force_window import force_window
from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.model.conditioning import condition, thinned
from gapscope.model.terms import Terms

CUTOFF = 12.0
CASES = {
    "stribeck_friction": (
        Truth(stribeck=(0.0, 3.0, 0.0), stribeck_speed=0.2),
        [3.0],
        0.2,
        0.26,
        0.1,
    ),
    "saturating_friction": (
        Truth(saturation=(0.0, 6.0, 0.0), saturation_speed=0.4),
        [6.0],
        0.4,
        0.5,
        0.1,
    ),
    "friction_drift": (
        Truth(drift=(0.0, 0.8, 0.0), drift_time=3.0),
        [0.8],
        3.0,
        3.6,
        0.1,
    ),
    "torque_ripple": (
        Truth(ripple=(0.0, 1.5, 0.0), cycles=16.0),
        [1.5 * np.cos(0.7), 1.5 * np.sin(0.7)],
        16.0,
        16.2,
        0.01,
    ),
}
"""The arm, the term's linear coordinates, its shape, a wrong one, and how nearly it has to be found."""


def data(truth: Truth) -> FitData:
    segments = [
        s
        for r in synthetic.recordings(truth, 1, duration=6.0)
        for s in condition(r, 20.0)
    ]
    return FitData(
        synthetic.arm(),
        synthetic.body(),
        [[thinned(s, 100.0)] for s in segments],
        CUTOFF,
    )


@pytest.mark.parametrize("name", CASES)
def test_a_shape_is_proposed_before_its_term_is_in_use(name: str) -> None:
    truth, _, shape, _, _ = CASES[name]
    plain = Terms(synthetic.N)
    found = Linearisation(data(truth), np.zeros(plain.size), plain).terms.shapes[
        plain.of(name)[1]
    ]
    assert found == pytest.approx((shape,), rel=0.2)


@pytest.mark.parametrize("name", CASES)
def test_a_wrong_shape_in_use_is_put_right(name: str) -> None:
    """Though the whole torque, friction, rotors and bodies together stand for what the term does at its wrong shape."""
    truth, linear, shape, wrong, within = CASES[name]
    plain = Terms(synthetic.N)
    term, recorded = plain.of(name)[1], data(truth)
    theta = np.zeros(plain.size)
    theta[list(term.columns)] = linear
    refined = Linearisation(
        recorded, theta, Terms(synthetic.N, {term: (wrong,)})
    ).refined[term]
    assert refined.values == pytest.approx((shape,), rel=within)
    assert 0.0 < refined.std[0] < within * shape


def test_the_window_of_a_force_is_found() -> None:
    truth = Truth(force=(0.0, 15.0, 0.0), window=(2.0, 4.0))
    plain = Terms(synthetic.N)
    force = plain.of("external_force")[0]
    found = Linearisation(data(truth), np.zeros(plain.size), plain).terms.shapes[force]
    assert found == pytest.approx((2.0, 4.0), abs=0.15)


def test_a_window_is_measured_by_what_its_surroundings_leave_of_it() -> None:
    """A push from 3 to 6 s, seen after a constant was taken out of everything."""
    t = np.arange(0.0, 10.0, 0.02)
    force = np.zeros((len(t), 1, 3))
    force[:, 0, 0] = 1.0
    basis = np.full((len(t), 1), 1.0 / np.sqrt(len(t)))
    push = 5.0 * ((t >= 3.0) & (t < 6.0))[:, None]
    residual = push - basis @ (basis.T @ push)
    found = force_window(t, residual, force, np.ones(1), [basis])
    assert found is not None and found.values == pytest.approx((3.0, 6.0), abs=2e-3)
    for rounding in (-1e-9, 1e-9):
        # no edge lies on a stamp
        again = force_window(t * (1 + rounding), residual, force, np.ones(1), [basis])
        assert again is not None and again.values == pytest.approx(found.values)
        for edge in again.values:
            assert np.abs(t - edge).min() > 5e-4
    assert (
        force_window(t[:10], residual[:10], force[:10], np.ones(1), [basis[:10]])
        is None
    )


def test_a_spring_that_rests_where_no_joint_can_be_is_impossible() -> None:
    """It would stand for a constant torque."""
    plain = Terms(synthetic.N)
    term, theta = plain.of("parallel_spring")[1], np.zeros(plain.size)
    lowest = np.full(plain.size, -np.inf)
    for stiffness, rest, impossible in (
        (5.0, 0.4, False),
        (-5.0, -0.4, False),
        (0.1, 10.0, True),
        (0.0, 1.0, True),
    ):
        theta[list(term.columns)] = stiffness, stiffness * rest or rest
        assert (
            term in plain.impossible(theta, frozenset({term}), lowest)
        ) == impossible
