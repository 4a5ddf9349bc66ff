"""Physical parameters from base parameters: what is recovered, what is only combined, and that bodies are possible."""

from __future__ import annotations

import numpy as np
import pytest

from gapscope.ident.model.base_parameters import BaseParameters, base_parameters
from gapscope.ident.model.physical_parameters import check_links, consistent
from gapscope.ident.model.recoverability import (
    COMBINED,
    HIDDEN,
    RECOVERED,
    recoveries,
    shortened,
)

NAMES = (
    "m1",
    "mx1",
    "my1",
    "mz1",
    "Ixx1",
    "Ixy1",
    "Iyy1",
    "Ixz1",
    "Iyz1",
    "Izz1",
    "b1",
)
BALL = np.array([2.0, 0.2, 0.0, 0.0, 0.01, 0.0, 0.03, 0.0, 0.0, 0.03])
"""2 kg at 0.1 m with 0.01 kg m^2 about every axis through its centre."""


def everything() -> BaseParameters:
    """Base parameters that are the parameters themselves."""
    return base_parameters(
        np.random.default_rng(0).standard_normal((200, len(NAMES))), NAMES
    )


class TestCheck:
    def test_a_ball_is_possible(self) -> None:
        (check,) = check_links(BALL)
        assert (
            check.positive_mass
            and check.positive_inertia
            and check.triangle
            and check.consistent
        )
        np.testing.assert_allclose(check.moments, 0.01, atol=1e-12)

    @pytest.mark.parametrize(
        ("place", "value", "failed"),
        [
            (0, -1.0, "positive_mass"),
            (4, -0.02, "positive_inertia"),
            (4, 0.05, "triangle"),
        ],
    )
    def test_each_test_fails_on_its_own_fault(
        self, place: int, value: float, failed: str
    ) -> None:
        """Ixx of 0.05 about the centre exceeds 0.01 + 0.01."""
        body = BALL.copy()
        body[place] = value
        (check,) = check_links(body)
        assert not getattr(check, failed) and not check.consistent

    def test_pseudo_inertia_needs_more_than_diagonal_inertia(self) -> None:
        """A centre of mass too far out for the moments: 2 kg at 0.3 m need 0.18 kg m^2 about the axes across."""
        body = BALL.copy()
        body[1] = 0.6
        (check,) = check_links(body)
        assert check.positive_mass and not check.consistent

    def test_mass_of_zero(self) -> None:
        (check,) = check_links(np.zeros(10))
        assert not check.positive_mass and not check.consistent


class TestConsistent:
    def solve(
        self,
        beta: np.ndarray,
        nominal: np.ndarray,
        pull: float = 1e-6,
        precision: float = 1e6,
    ) -> np.ndarray:
        base = everything()
        information = precision * np.eye(base.count)
        return consistent(
            base, base.of(beta), information, nominal, np.full(len(NAMES), pull), 1
        ).value

    def test_possible_values_are_kept(self) -> None:
        truth = np.append(BALL, 0.5)
        np.testing.assert_allclose(
            self.solve(truth, np.append(1.2 * BALL, 0.0)), truth, atol=1e-6
        )

    def test_impossible_values_end_at_the_edge(self) -> None:
        wrong = np.append(BALL, -0.5)
        wrong[4] = -0.02
        found = self.solve(wrong, np.append(BALL, 0.0))
        (check,) = check_links(found[:10])
        assert check.consistent and check.least < 1e-2
        assert 0.0 <= found[10] < 1e-6
        assert found[0] == pytest.approx(2.0, abs=0.2)

    def test_what_beta_leaves_open_stays_nominal(self) -> None:
        """Only mx and b show: all else is the nominal arm's."""
        columns = np.zeros((50, len(NAMES)))
        columns[:, [1, 10]] = np.random.default_rng(1).standard_normal((50, 2))
        base = base_parameters(columns, NAMES)
        nominal, truth = np.append(BALL, 0.0), np.append(BALL, 0.5)
        truth[1] = 0.22
        penalty = np.full(len(NAMES), 1e-6)
        found = consistent(
            base, base.of(truth), 1e6 * np.eye(base.count), nominal, penalty, 1
        )
        others = np.setdiff1d(np.arange(len(NAMES)), [1, 10])
        np.testing.assert_allclose(found.value[[1, 10]], [0.22, 0.5], atol=1e-5)
        np.testing.assert_allclose(found.value[others], nominal[others], atol=1e-4)

    def test_distance_counts_what_consistency_costs(self) -> None:
        base, nominal = everything(), np.append(BALL, 0.5)
        information = 4.0 * np.eye(base.count)
        possible = consistent(
            base, base.of(nominal), information, nominal, np.full(len(NAMES), 1e-9), 1
        )
        assert possible.distance < 1e-6
        moved = nominal.copy()
        moved[10] = -1.0
        found = consistent(
            base, base.of(moved), information, nominal, np.full(len(NAMES), 1e-9), 1
        )
        assert found.distance == pytest.approx(4.0 / base.count, rel=1e-3)


class TestRecovery:
    def found(self) -> dict[str, tuple[str, float | None]]:
        """Torque m1 + 2 mx1, my1 alone, and nothing of the others."""
        rng = np.random.default_rng(2)
        columns = np.zeros((50, len(NAMES)))
        columns[:, 0], columns[:, 2] = rng.standard_normal((2, 50))
        columns[:, 1] = 2 * columns[:, 0]
        base = base_parameters(columns, NAMES)
        covariance = np.diag(np.linspace(0.01, 0.04, base.count))
        value = np.append(BALL, 0.0)
        got = recoveries(base, covariance, value, value, ["kg"] * len(NAMES))
        return {r.name: (r.status, r.deviation) for r in got}

    def test_alone_in_combination_and_hidden(self) -> None:
        found = self.found()
        assert found["my1"][0] == RECOVERED and found["my1"][1] in (
            pytest.approx(0.1),
            pytest.approx(0.2),
        )
        assert found["m1"] == found["mx1"] == (COMBINED, None)
        assert {name for name, (status, _) in found.items() if status == HIDDEN} == set(
            NAMES
        ) - {"m1", "mx1", "my1"}

    def test_long_expressions_are_cut(self) -> None:
        assert (
            shortened("a + 2 b - c + d - e + f") == "a + 2 b - c + d and 2 more terms"
        )
        assert shortened("a - b") == "a - b"
