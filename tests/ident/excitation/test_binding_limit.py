"""Trajectories that determine no parameter: the limit that keeps them small, a warning, and a refusal."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.motions.trajectory import Limits
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation import binding_limit as module
from gapscope.ident.excitation.binding_limit import binding_limit, check_condition
from gapscope.ident.excitation.candidate_model import ExcitationModel
from gapscope.ident.excitation.criteria import CRITERIA, condition_number
from gapscope.ident.excitation.families import family
from gapscope.ident.excitation.limits import Allowed, Checker
from gapscope.ident.excitation.trajectory_parametrisation import Parametrisation
from gapscope.ident.excitation.trajectory_search import (
    SAMPLES,
    Budget,
    TrajectorySearch,
)

Candidate = Callable[..., tuple[TrajectorySearch, np.ndarray, float]]
TINY = {
    "acceleration": {"acceleration": np.full(3, 1e-3)},
    "velocity": {"velocity": np.full(3, 1e-3)},
    "position": {"lower": np.full(3, 0.500), "upper": np.full(3, 0.501)},
}
"""Limits that keep a motion of the arm small, each alone."""


@pytest.fixture
def candidate(arm: NominalArm, body: RigidBody, limits: Limits) -> Candidate:
    """A search within changed limits, a random candidate of it, and its condition number."""

    def made(**changed: np.ndarray) -> tuple[TrajectorySearch, np.ndarray, float]:
        within = limits._replace(**changed)
        space = Parametrisation(family("fourier", 3, 10.0, 3, 0.1), within)
        model = ExcitationModel(arm, body, ("rotor", "damping"))
        checker = Checker(arm, body, Allowed(within, np.full(3, 40.0), 0.0, 0.0), None)
        search = TrajectorySearch(
            space, model, CRITERIA["condition"], checker, Budget(10)
        )
        x, t = space.draw(np.random.default_rng(0)), np.linspace(0, 10.0, SAMPLES)
        return (
            search,
            x,
            condition_number(model.matrix(space.motion(x, t, space.family.basis(t)))),
        )

    return made


@pytest.mark.parametrize("name", TINY)
def test_the_limit_that_keeps_a_motion_small_is_named(
    name: str, candidate: Candidate
) -> None:
    search, x, condition = candidate(**TINY[name])
    found = binding_limit(search, x, condition)
    assert found is not None and found.limit == name and found.condition < condition / 5


def test_a_useless_trajectory_is_refused_with_the_option_that_helps(
    candidate: Candidate,
) -> None:
    search, x, condition = candidate(acceleration=np.full(3, 1e-5))
    assert condition > 1e8
    with pytest.raises(
        InputError,
        match="(?s)acceleration keeps it small.*remedy: raise --acceleration",
    ):
        check_condition(search, x, condition)


def test_a_poor_trajectory_is_warned_of(candidate: Candidate) -> None:
    search, x, condition = candidate(velocity=np.full(3, 0.01))
    assert 1e3 < condition < 1e8
    with pytest.warns(ModelWarning, match="velocity keeps it small; raise --velocity"):
        check_condition(search, x, condition)


def test_where_no_limit_is_to_blame_more_search_is_advised(
    candidate: Candidate, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, x, _ = candidate()
    monkeypatch.setattr(module, "condition_number", lambda matrix: 1999.0)
    with pytest.warns(ModelWarning, match="2e\\+03; allow more evaluations"):
        check_condition(search, x, 2000.0)


def test_a_good_trajectory_passes_without_a_word(candidate: Candidate) -> None:
    search, x, _ = candidate()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_condition(search, x, 999.0)
