"""Dry friction solved in one step: Coulomb's law holds exactly, for any coupling between joints."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gapscope.envs.drive.laws import DryFriction


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_solution_fulfils_coulombs_law(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    inertia, momentum = root @ root.T + 1e-3 * np.eye(n), rng.standard_normal(n)
    limit = rng.choice([0.0, 0.1, 1.0], n)
    friction = DryFriction(n)
    for _ in range(
        2
    ):  # the second solution starts from the first one's sticking joints
        velocity, impulse = friction.solve(inertia, momentum, limit)
        np.testing.assert_allclose(inertia @ velocity + impulse, momentum, atol=1e-9)
        assert (np.abs(impulse) <= limit + 1e-12).all()
        moving = velocity != 0
        np.testing.assert_allclose(impulse[moving], (limit * np.sign(velocity))[moving])
