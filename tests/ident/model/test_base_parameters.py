"""Base parameters: published counts, combinations worked out by hand, conversions both ways, and bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import Link, chain
from cases import panda_case, panda_motion
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.ident.identification_json import write_base
from gapscope.ident.model.base_parameters import (
    COMBINED,
    HIDDEN,
    RECOVERED,
    BaseParameters,
    base_parameters,
    random_states,
    recoveries,
    structural_base,
)
from gapscope.ident.model.physical_parameters import (
    check_links,
    consistent,
    from_log_cholesky,
    is_consistent,
    log_cholesky_jacobian,
    to_log_cholesky,
)
from gapscope.ident.model.regressor import Regressor

LENGTH = 0.5


def in_a_row(
    folder: Path,
    kinds: tuple[str, ...],
    axes: tuple[str, ...],
    gravity: tuple[float, ...] = (0.0, -9.81, 0.0),
) -> NominalArm:
    """Joints in a row along x, each ``LENGTH`` from the one before."""
    links = [
        Link(
            *(f"j{i}", f"l{i}", axis),
            origin=f"{LENGTH if i > 1 else 0.0} 0 0",
            mass=1,
            com="0.2 0.1 0",
            inertia="0.1 0.1 0.1",
            limit="-3 3 9 3",
            kind=kind,
        )
        for i, (kind, axis) in enumerate(zip(kinds, axes, strict=True), 1)
    ]
    return chain(folder, "chain", *links, gravity=gravity)


def measured(data_root: Path, name: str) -> NominalArm:
    """An arm of which there are recordings, without the fingers that its URDF may have."""
    urdf = next((data_root / name).glob("*.urdf"))
    arm = load_nominal_arm(urdf)
    return load_nominal_arm(
        urdf, joints=[joint for joint in arm.joints if "finger" not in joint]
    )


def random_base(arm: NominalArm, quantities=()):
    regressor = Regressor(arm, quantities=quantities)
    return regressor, structural_base(regressor, np.random.default_rng(0))


@pytest.fixture(scope="module")
def iiwa():
    regressor, base = random_base(load_nominal_arm("kuka_iiwa"), ("rotor",))
    Y = regressor.matrix(random_states(regressor, np.random.default_rng(1), 100))
    return regressor, base, Y


@pytest.mark.parametrize(
    ("robot", "count"), [("kuka_iiwa", 43), ("franka_panda", 43), ("xarm6", 36)]
)
def test_number_of_base_parameters_is_the_published_one(robot, count):
    _, base = random_base(load_nominal_arm(robot))
    assert base.count == count
    assert base.gap > 1e8


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("robot", "count"), [("ur10", 36), ("panda", 43), ("staubli_tx40", 36)]
)
def test_number_of_base_parameters_of_measured_arms(robot, count, data_root):
    _, base = random_base(measured(data_root, robot))
    assert base.count == count
    assert base.gap > 1e8


def test_rounded_angles_of_a_urdf_leave_the_rank_alone():
    # the parallel axes of the xArm6 are 4e-6 rad apart in its URDF; rotors add 4 base parameters, as for the UR10
    _, base = random_base(load_nominal_arm("xarm6"), ("rotor",))
    assert base.count == 36 + 4


def test_planar_arm_has_the_combinations_of_the_textbook(tmp_path):
    arm = in_a_row(tmp_path, ("revolute",) * 2, ("0 0 1",) * 2)
    _, base = random_base(arm)
    assert base.expressions() == (
        "mx1 + 0.5 m2",
        "my1",
        "Izz1 + 0.25 m2",
        "mx2",
        "my2",
        "Izz2",
    )


def test_slides_show_their_masses_alone(tmp_path):
    arm = in_a_row(tmp_path, ("prismatic",) * 3, ("1 0 0", "0 1 0", "0 0 1"))
    _, base = random_base(arm)
    assert base.expressions() == ("m1", "m2", "m3")


def test_base_columns_give_the_same_torque_on_other_states(iiwa):
    _, base, Y = iiwa
    pi = np.random.default_rng(2).standard_normal(77)
    assert np.allclose(Y[:, :, base.kept] @ base.of(pi), Y @ pi, rtol=0, atol=1e-8)
    assert np.array_equal(base.combination[:, base.kept], np.eye(base.count))


NAMES = ("m1", "mx1")
BAD = {
    "too short": (
        np.ones((1, 2)),
        "1 rows do not determine 2 parameters.*record more samples",
    ),
    "NaN": (np.array([[1.0, np.nan], [0, 1]]), "not finite"),
    "zero": (np.zeros((5, 2)), "nothing moves"),
}


@pytest.mark.parametrize(("Y", "message"), BAD.values(), ids=BAD)
def test_bad_regressor_is_refused(Y, message):
    with pytest.raises(InputError, match="(?s)" + message):
        base_parameters(Y, NAMES)


# Physical parameters from base parameters: what is recovered, what is only combined, and that bodies are possible.


ONE_LINK = (
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
        np.random.default_rng(0).standard_normal((200, len(ONE_LINK))),
        ONE_LINK,
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
            # 2 kg at 0.3 m need 0.18 kg m^2 about the axes across
            (1, 0.6, "consistent"),
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
            base,
            base.of(beta),
            information,
            nominal,
            np.full(len(ONE_LINK), pull),
            1,
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
        columns = np.zeros((50, len(ONE_LINK)))
        columns[:, [1, 10]] = np.random.default_rng(1).standard_normal((50, 2))
        base = base_parameters(columns, ONE_LINK)
        nominal, truth = np.append(BALL, 0.0), np.append(BALL, 0.5)
        truth[1] = 0.22
        penalty = np.full(len(ONE_LINK), 1e-6)
        found = consistent(
            base, base.of(truth), 1e6 * np.eye(base.count), nominal, penalty, 1
        )
        others = np.setdiff1d(np.arange(len(ONE_LINK)), [1, 10])
        np.testing.assert_allclose(found.value[[1, 10]], [0.22, 0.5], atol=1e-5)
        np.testing.assert_allclose(found.value[others], nominal[others], atol=1e-4)


class TestRecovery:
    def found(self) -> dict[str, tuple[str, float | None]]:
        """Torque m1 + 2 mx1, my1 alone, and nothing of the others."""
        rng = np.random.default_rng(2)
        columns = np.zeros((50, len(ONE_LINK)))
        columns[:, 0], columns[:, 2] = rng.standard_normal((2, 50))
        columns[:, 1] = 2 * columns[:, 0]
        base = base_parameters(columns, ONE_LINK)
        covariance = np.diag(np.linspace(0.01, 0.04, base.count))
        value = np.append(BALL, 0.0)
        got = recoveries(base, covariance, value, value, ["kg"] * len(ONE_LINK))
        return {r.name: (r.status, r.std) for r in got}

    def test_alone_in_combination_and_hidden(self) -> None:
        found = self.found()
        assert found["my1"][0] == RECOVERED and found["my1"][1] in (
            pytest.approx(0.1),
            pytest.approx(0.2),
        )
        assert found["m1"] == found["mx1"] == (COMBINED, None)
        assert {name for name, (status, _) in found.items() if status == HIDDEN} == set(
            ONE_LINK
        ) - {"m1", "mx1", "my1"}


# Pseudo-inertia: what a body of point masses has, and coordinates in which every body is physical.


THETA = arrays(float, 10, elements=st.floats(-1.5, 1.5))


@given(THETA)
def test_log_cholesky_there_and_back(theta: np.ndarray) -> None:
    parameters = from_log_cholesky(theta)
    assert is_consistent(parameters)
    assert np.allclose(to_log_cholesky(parameters), theta, atol=1e-6)


def test_jacobian_of_log_cholesky_by_differences() -> None:
    theta, h = np.random.default_rng(1).standard_normal((4, 10)), 1e-6
    steps = h * np.eye(10)
    by_differences = np.stack(
        [
            (from_log_cholesky(theta + s) - from_log_cholesky(theta - s)) / (2 * h)
            for s in steps
        ],
        axis=-1,
    )
    assert np.allclose(
        log_cholesky_jacobian(theta), by_differences, rtol=1e-6, atol=1e-6
    )


# The matrices of the base parameters, both ways.


def test_matrices_lead_both_ways(tmp_path: Path) -> None:
    result = identify(panda_case(), IdentificationSettings(cutoff=20.0))
    write_base(result, tmp_path / "base.npz")
    found = np.load(tmp_path / "base.npz", allow_pickle=False)
    p, b = len(found["names"]), len(found["kept_names"])
    assert (p, b) == (98, 69)
    rng = np.random.default_rng(0)
    pi, z = rng.standard_normal(p), rng.standard_normal(p - b)
    beta = found["combination"] @ pi
    np.testing.assert_allclose(
        found["combination"] @ (found["back"] @ beta + found["null_space"] @ z),
        beta,
        atol=1e-9,
    )
    gamma = found["orthonormal"].T @ pi
    np.testing.assert_allclose(
        found["orthonormal"].T @ found["orthonormal"], np.eye(b), atol=1e-12
    )
    np.testing.assert_allclose(found["from_orthonormal"] @ gamma, beta, atol=1e-8)
    np.testing.assert_allclose(found["to_orthonormal"] @ beta, gamma, atol=1e-8)
    matrix = result.columns.matrix(states(), result.choice.law)
    np.testing.assert_allclose(
        matrix @ pi, matrix[:, :, result.base.kept] @ beta, atol=1e-6
    )
    np.testing.assert_allclose(
        matrix @ (found["orthonormal"] @ gamma), matrix @ pi, atol=1e-6
    )


def states() -> Motion:
    reference = panda_motion(5)
    t = np.arange(100) / 20
    return Motion(
        t, reference.position(t), reference.velocity(t), reference.acceleration(t)
    )
