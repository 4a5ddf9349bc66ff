"""Sizes at which effects would be named: what is larger is found, what is smaller is not."""

from __future__ import annotations

import numpy as np
import pytest
from small_models import selection
from synthetic import Truth

from gapscope.model.expected import Detectable

STIFF = Truth(coulomb=(0.0, 3.0, 0.0))


def shown() -> list[Detectable]:
    return list(selection(STIFF).further)


def size_of(effect: str, joint: int) -> Detectable:
    return next(
        one for one in shown() if (one.term.effect, one.term.joint) == (effect, joint)
    )


@pytest.mark.parametrize("multiple", [0.7, 1.5])
@pytest.mark.parametrize(
    ("effect", "joint", "field"),
    [("viscous_friction", 1, "viscous"), ("torque_offset", 3, "offset")],
)
def test_an_effect_is_found_from_its_size_on(
    effect: str, joint: int, field: str, multiple: float
) -> None:
    size = np.zeros(3)
    size[joint - 1] = multiple * size_of(effect, joint).half
    found = selection(Truth(coulomb=STIFF.coulomb, **{field: tuple(size)}))
    named = {(t.effect, t.joint) for t in found.fit.terms}
    assert ((effect, joint) in named) == (multiple > 1)


def test_nine_of_ten_need_more_than_half_of_them() -> None:
    every = [one for one in shown() if np.isfinite(one.half)]
    assert len(every) > 10
    assert all(0 < one.half < one.most for one in every)


def test_what_is_there_already_is_not_asked_again() -> None:
    asked = {(one.term.effect, one.term.joint) for one in shown()}
    assert ("coulomb_friction", 2) not in asked
    assert ("coulomb_friction", 1) in asked
