"""The search on a three-joint arm: what is there, by its name and with its value, and nothing more."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from sweeps import daily
from synthetic import Truth, arm, examined, recordings

from gapscope.diagnosis.selection.search import (
    EVERYONE,
    nameable,
    search_of,
)
from gapscope.model.design import about
from gapscope.model.difference import Difference
from gapscope.model.terms import Candidate, Terms


@cache
def difference(truth: Truth) -> Difference:
    """What the search finds in three recordings of 6 s."""
    return search_of(arm(), recordings(truth, duration=6.0)).run()


def named(found: Difference) -> dict[tuple[str, int], np.ndarray]:
    values = found.fit.values
    return {(one.effect, one.term.joint): x for one, x in values.items()}


def test_a_lighter_last_link_is_a_link():
    found = named(difference(Truth(mass=-1.0, com=(0.15, 0.03, 0.0))))
    assert set(found) == {("link_inertia", 3)}


@pytest.mark.parametrize(("mass", "possible"), [(1.0, True), (-1.0, False)])
def test_a_load_is_not_lighter_than_nothing(mass, possible):
    lighter = recordings(Truth(mass=mass, com=(0.15, 0.03, 0.02)), duration=6.0)
    searching = search_of(arm(), lighter)
    searching.unsearched()
    (load,) = (Candidate(t, EVERYONE) for t in Terms(3).of("payload"))
    assert (searching.with_some([load], {}).mine == [load]) == possible


def test_what_makes_an_arm_swing_beyond_all_numbers_is_no_hypothesis(monkeypatch):
    """As the values of a compliant joint did beside much else: they were not a number in the end."""
    searching = search_of(arm(), recordings(Truth(), duration=6.0))
    searching.unsearched()
    (bent, *_) = (Candidate(t, EVERYONE) for t in Terms(3).of("joint_elasticity"))

    def swinging(*given):
        gap, columns = about(*given)
        return 1e200 + gap, columns

    monkeypatch.setattr("gapscope.model.difference.about", swinging)
    fit = searching.with_some([bent], {})
    assert fit.total == -np.inf and all(
        np.isfinite(x).all() for x in fit.values.values()
    )


HANGING = ((np.pi, 0.0), (-1.4, 0.0), (3.0, 0.2), (0.1, 1.4), (-2.2, 0.7))


@pytest.mark.parametrize("turn", daily(HANGING, HANGING[0]))
def test_an_arm_that_hangs_or_is_on_a_wall_is_named_as_that(turn: tuple[float, float]):
    """No linearisation about the nominal arm reaches so far."""
    found = examined(Truth(tilt=turn), 0, duration=6.0)
    assert found.named == ("base_tilt",)
    angles = found.parameters("base_tilt")
    turned = np.array([angles[name]["value"] for name in angles]) - turn
    # half a turn to either side is the same
    assert np.abs(np.angle(np.exp(1j * turned))).max() < 0.02
    assert max(angles[name]["std"] for name in angles) < 0.02


def test_a_joint_that_rattles():
    assert set(named(difference(Truth(play=(0.008, 0.0, 0.0))))) == {("backlash", 1)}


# Sizes at which effects would be named: what is larger is found, what is smaller is not.


STIFF = Truth(coulomb=(0.0, 3.0, 0.0))


def shown() -> dict[tuple[str, int], dict[str, Any]]:
    every = nameable(difference(STIFF))
    return {(one["effect"], sum(one["joints"])): one for one in every}


@pytest.mark.parametrize("multiple", [0.5, 1.5])
@pytest.mark.parametrize(
    ("effect", "joint", "field"),
    [("viscous_friction", 1, "viscous"), ("torque_offset", 3, "offset")],
)
def test_an_effect_is_found_from_its_size_on(effect, joint, field, multiple):
    size = np.zeros(3)
    size[joint - 1] = multiple * shown()[effect, joint]["half"]
    found = difference(Truth(coulomb=STIFF.coulomb, **{field: tuple(size)}))
    assert ((effect, joint) in named(found)) == (multiple > 1)


def test_nine_of_ten_need_more_than_half_of_them():
    every = [one for one in shown().values() if one["nine_of_ten"] is not None]
    assert len(every) > 10
    assert all(0 < one["half"] < one["nine_of_ten"] for one in every)


def test_what_is_there_already_is_not_asked_again():
    assert ("coulomb_friction", 2) not in shown()
    assert ("coulomb_friction", 1) in shown()


# What form error, and the form of what was found, may hide or pass for.


@pytest.mark.parametrize("late", ["delay", "lag"])
def test_delays_and_lags_of_all_joints_are_told_apart(late: str):
    found = named(difference(Truth(**{late: (0.006, 0.008, 0.012)})))
    assert set(found) == {(f"actuator_{late}", joint) for joint in (1, 2, 3)}
    values = [found[f"actuator_{late}", joint][0] for joint in (1, 2, 3)]
    assert values == pytest.approx([0.006, 0.008, 0.012], rel=0.15)


def power_law(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """8 |dq|^1.3 sgn dq [N m] on joint 2: no law of the catalogue."""
    out = np.zeros_like(q)
    out[:, 1] = 8.0 * np.sign(dq[:, 1]) * np.abs(dq[:, 1]) ** 1.3
    return out


def test_what_the_form_of_a_law_leaves_is_no_second_effect():
    found = named(difference(Truth(extra=power_law)))
    assert set(found) == {("viscous_friction", 2)}
