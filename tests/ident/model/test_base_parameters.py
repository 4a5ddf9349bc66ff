"""Base parameters: published counts, combinations worked out by hand, conversions both ways, and bad input."""

from pathlib import Path

import numpy as np
import pytest
from arms import Link, chain

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.model.base_parameters import (
    base_parameters,
    random_states,
    structural_base,
)
from gapscope.ident.model.orthonormal_base import OrthonormalBase, orthonormal_base
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


def random_base(arm: NominalArm, quantities=(), preference="link"):
    regressor = Regressor(arm, quantities=quantities)
    return regressor, structural_base(
        regressor, np.random.default_rng(0), preference=preference
    )


@pytest.fixture(scope="module")
def iiwa():
    regressor, base = random_base(load_nominal_arm("kuka_iiwa"), ("rotor",))
    Y = regressor.matrix(random_states(regressor, np.random.default_rng(1), 100))
    return regressor, base, Y


@pytest.mark.parametrize("preference", ["link", "kind"])
@pytest.mark.parametrize(
    ("robot", "count"), [("kuka_iiwa", 43), ("franka_panda", 43), ("xarm6", 36)]
)
def test_number_of_base_parameters_is_the_published_one(robot, count, preference):
    _, base = random_base(load_nominal_arm(robot), preference=preference)
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


def test_preference_by_kind_lets_the_mass_stand_for_what_it_can(tmp_path):
    arm = in_a_row(tmp_path, ("revolute",) * 2, ("0 0 1",) * 2)
    _, base = random_base(arm, preference="kind")
    assert base.expressions()[:4] == ("mx1 - 2 Izz1", "my1", "m2 + 4 Izz1", "mx2")


def test_slides_show_their_masses_alone(tmp_path):
    arm = in_a_row(tmp_path, ("prismatic",) * 3, ("1 0 0", "0 1 0", "0 0 1"))
    _, base = random_base(arm)
    assert base.expressions() == ("m1", "m2", "m3")


def test_rotor_folds_into_the_inertia_of_the_first_link(iiwa):
    _, base, _ = iiwa
    assert base.expressions()[0] == "Izz1 + Iyy2 + I1"


@pytest.mark.parametrize("preference", ["link", "kind"])
def test_base_columns_give_the_same_torque_on_other_states(iiwa, preference):
    regressor, _, Y = iiwa
    _, base = random_base(regressor.arm, ("rotor",), preference)
    pi = np.random.default_rng(2).standard_normal(77)
    assert np.allclose(Y[:, :, base.kept] @ base.of(pi), Y @ pi, rtol=0, atol=1e-8)
    assert np.array_equal(base.combination[:, base.kept], np.eye(base.count))


def test_null_space_and_spread_make_up_every_parameter_vector(iiwa):
    _, base, Y = iiwa
    pi = np.random.default_rng(3).standard_normal(77)
    assert np.allclose(
        base.spread(base.of(pi)) + base.null_space @ pi[base.dropped],
        pi,
        rtol=0,
        atol=1e-12,
    )
    assert np.abs(Y @ base.null_space).max() < 1e-8 * np.abs(Y).max()


def test_nearest_keeps_the_torque_and_moves_least(iiwa):
    _, base, _ = iiwa
    rng = np.random.default_rng(4)
    prior, beta = rng.standard_normal(77), rng.standard_normal(base.count)
    near = base.nearest(beta, prior)
    assert np.allclose(base.of(near), beta, rtol=0, atol=1e-10)
    assert np.abs(base.null_space.T @ (near - prior)).max() < 1e-10


def test_orthonormal_base_has_the_rank_and_torque_of_the_other(iiwa):
    regressor, base, Y = iiwa
    other = orthonormal_base(Y, regressor.names)
    pi = np.random.default_rng(5).standard_normal(77)
    assert other.count == base.count
    assert other.gap > 1e8
    assert np.allclose(
        other.basis.T @ other.basis, np.eye(base.count), rtol=0, atol=1e-12
    )
    assert np.allclose(other.matrix(Y) @ other.of(pi), Y @ pi, rtol=0, atol=1e-8)
    short = other.spread(other.of(pi))
    assert np.allclose(
        short,
        np.linalg.lstsq(Y.reshape(-1, 77), (Y @ pi).ravel(), rcond=1e-9)[0],
        atol=1e-6,
    )


def test_orthonormal_and_qr_form_convert_both_ways(iiwa):
    regressor, base, Y = iiwa
    other: OrthonormalBase = orthonormal_base(Y, regressor.names)
    pi = np.random.default_rng(6).standard_normal(77)
    assert np.allclose(
        other.to_base(base) @ other.of(pi), base.of(pi), rtol=0, atol=1e-8
    )
    assert np.allclose(
        other.from_base(base) @ base.of(pi), other.of(pi), rtol=0, atol=1e-8
    )


def test_triangular_factor_gives_the_same_base(iiwa):
    regressor, base, Y = iiwa
    R = np.linalg.qr(Y.reshape(-1, 77), mode="r")
    found = base_parameters(R, regressor.names)
    assert np.array_equal(found.kept, base.kept)
    assert np.allclose(found.combination, base.combination, rtol=0, atol=1e-8)


def test_scale_of_columns_does_not_change_the_choice(iiwa):
    regressor, base, Y = iiwa
    scale = 10 ** np.random.default_rng(7).uniform(-4, 4, 77)
    found = base_parameters(Y * scale, regressor.names)
    assert np.array_equal(found.kept, base.kept)


def test_arm_at_rest_shows_gravity_alone(tmp_path):
    arm = in_a_row(tmp_path, ("revolute",) * 2, ("0 0 1",) * 2)
    regressor = Regressor(arm, quantities=())
    states = random_states(regressor, np.random.default_rng(0), 50)
    still = type(states)(states.t, states.q, 0 * states.q, 0 * states.q)
    assert base_parameters(regressor.matrix(still), regressor.names).expressions() == (
        "mx1 + 0.5 m2",
        "my1",
        "mx2",
        "my2",
    )


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
    for find in (base_parameters, orthonormal_base):
        with pytest.raises(InputError, match="(?s)" + message):
            find(Y, NAMES)


def test_unknown_preference_is_refused():
    with pytest.raises(InputError, match="choose link or kind"):
        base_parameters(np.eye(2), NAMES, preference="mass")
