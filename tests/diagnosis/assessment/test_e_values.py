"""One e-value by hand: quadratic losses of one and of two values, fitted on one half and tested on the other."""

from __future__ import annotations

import numpy as np
import pytest
from selections import TERMS, term

from gapscope.diagnosis.assessment.significance import log_e_value
from gapscope.model.terms import Term

TESTED, OTHER = term("coulomb_friction", 1), term("viscous_friction", 1)


def quadratic(values: dict[Term, tuple[float, float]], constant: float) -> np.ndarray:
    """L with the loss sum (a theta^2 / 2 - b theta) + constant / 2, from a and b of each term."""
    out = np.zeros((TERMS.size + 1, TERMS.size + 1))
    for chosen, (a, b) in values.items():
        (place,) = chosen.columns
        out[place, place] = a
        out[place, -1] = out[-1, place] = b
    out[-1, -1] = constant
    return out


def test_a_value_that_both_halves_agree_on() -> None:
    """Fitted 1 on A; on B the loss falls from 0 to 4 / 2 - 3 = -1."""
    fitted = quadratic({TESTED: (2.0, 2.0)}, 5.0)
    tested = quadratic({TESTED: (4.0, 3.0)}, 7.0)
    terms = frozenset({TESTED})
    assert log_e_value(terms, terms, fitted, tested) == pytest.approx(1.0)


def test_a_value_that_the_other_half_contradicts() -> None:
    """Fitted 1 on A; on B the loss rises from 0 to 4 / 2 + 3 = 5."""
    fitted = quadratic({TESTED: (2.0, 2.0)}, 5.0)
    tested = quadratic({TESTED: (4.0, -3.0)}, 7.0)
    terms = frozenset({TESTED})
    assert log_e_value(terms, terms, fitted, tested) == pytest.approx(-5.0)


def test_without_the_part_all_others_may_fit_the_tested_half() -> None:
    """The other value, 2 on A, costs 6 / 2 * 4 - 6 * 2 = 0 on B; fitted to B, 1, it gains 6^2 / 6 / 2 = 3."""
    fitted = quadratic({TESTED: (2.0, 2.0), OTHER: (1.0, 2.0)}, 5.0)
    tested = quadratic({TESTED: (4.0, 3.0), OTHER: (6.0, 6.0)}, 7.0)
    both = frozenset({TESTED, OTHER})
    part = frozenset({TESTED})
    assert log_e_value(both, part, fitted, tested) == pytest.approx(1.0 - 3.0)
