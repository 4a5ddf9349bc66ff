"""Base parameters: published counts, combinations worked out by hand, conversions both ways, and bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import Link, chain
from cases import panda_case, panda_motion
from scipy.linalg import qr

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS
from gapscope.arm.errors import InputError
from gapscope.arm.motions.trajectory import motion_of
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import KNOWN_ROBOTS, load_nominal_arm
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.ident.identification_json import write_base
from gapscope.ident.model.base_parameters import (
    COMBINED,
    HIDDEN,
    RECOVERED,
    STATES,
    BaseParameters,
    base_parameters,
    random_states,
    recoveries,
    structural_base,
    unit_triangle,
)
from gapscope.ident.model.physical_parameters import (
    check_links,
    consistent,
)
from gapscope.ident.model.regressor import Regressor

LENGTH = 0.5


def in_a_row(folder: Path, kinds: tuple[str, ...], axes: tuple[str, ...]) -> NominalArm:
    """Joints in a row along x, each ``LENGTH`` from the one before."""
    first = Link("j", "l", mass=1, com="0.2 0.1 0", inertia="0.1 0.1 0.1")
    links = []
    for i, (kind, axis) in enumerate(zip(kinds, axes, strict=True), 1):
        origin = f"{LENGTH if i > 1 else 0.0} 0 0"
        own = {"joint": f"j{i}", "name": f"l{i}", "kind": kind, "axis": axis}
        links.append(first._replace(**own, origin=origin))
    return chain(folder, "chain", *links, gravity=(0.0, -9.81, 0.0))


def gap(regressor: Regressor, count: int) -> float:
    """Smallest kept over largest dropped pivot of the columns, in states of their own."""
    states = random_states(regressor, np.random.default_rng(1), STATES)
    scaled, _ = unit_triangle(regressor.matrix(states), regressor.names)
    pivots = np.abs(np.diag(qr(scaled, mode="r", pivoting=True)[0]))
    return pivots[count - 1] / pivots[count]


def random_base(arm: NominalArm, quantities=()):
    regressor = Regressor(arm, quantities=quantities)
    return regressor, structural_base(regressor, np.random.default_rng(0))


COUNTS = [
    ("kuka_iiwa", (), 43),
    ("franka_panda", (), 43),
    # its parallel axes are 4e-6 rad apart in its URDF; rotors add 4 base parameters, as for the UR10
    ("xarm6", (), 36),
    ("xarm6", ("rotor",), 36 + 4),
]
MEASURED = [("ur10", (), 36), ("panda", (), 43), ("staubli_tx40", (), 36)]
"""Arms of which there are recordings."""


@pytest.mark.parametrize(
    ("robot", "rotors", "count"),
    [*COUNTS, *(pytest.param(*row, marks=pytest.mark.shared_data) for row in MEASURED)],
)
def test_number_of_base_parameters_is_the_published_one(robot, rotors, count, request):
    if robot not in KNOWN_ROBOTS:
        folder = request.getfixturevalue("data_root") / robot
        robot = next(folder.glob("*.urdf"))
    joints = [x for x in load_nominal_arm(robot).joints if "finger" not in x]
    regressor, base = random_base(load_nominal_arm(robot, joints=joints), rotors)
    assert base.count == count and (rotors or gap(regressor, count) > 1e8)


PLANAR = ("mx1 + 0.5 m2", "my1", "Izz1 + 0.25 m2", "mx2", "my2", "Izz2")
TEXTBOOK = {
    "planar": (("revolute",) * 2, ("0 0 1",) * 2, PLANAR),
    "slides": (("prismatic",) * 3, ("1 0 0", "0 1 0", "0 0 1"), ("m1", "m2", "m3")),
}


@pytest.mark.parametrize("name", TEXTBOOK)
def test_an_arm_has_the_combinations_of_the_textbook(name, tmp_path):
    kinds, axes, expected = TEXTBOOK[name]
    _, base = random_base(in_a_row(tmp_path, kinds, axes))
    assert base.expressions() == expected


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


ONE_LINK = (*(f"{name}1" for name in INERTIAL_PARAMETERS), "b1")
BALL = np.array([2.0, 0.2, 0.0, 0.0, 0.01, 0.0, 0.03, 0.0, 0.0, 0.03])
"""2 kg at 0.1 m with 0.01 kg m^2 about every axis through its centre."""


def everything() -> BaseParameters:
    """Base parameters that are the parameters themselves."""
    return base_parameters(
        np.random.default_rng(0).standard_normal((200, len(ONE_LINK))),
        ONE_LINK,
    )


FAULTS = {
    "positive_mass": (0, -1.0),
    "positive_inertia": (4, -0.02),
    # about the centre it exceeds 0.01 + 0.01
    "triangle": (4, 0.05),
    # 2 kg at 0.3 m need 0.18 kg m^2 about the axes across
    "consistent": (1, 0.6),
}
"""Parameter of the ball that fails a check, and its value."""


def test_a_ball_is_possible() -> None:
    (check,) = check_links(BALL)
    assert all(getattr(check, name) for name in FAULTS)
    np.testing.assert_allclose(check.moments, 0.01, atol=1e-12)


@pytest.mark.parametrize("failed", FAULTS)
def test_each_check_fails_on_its_own_fault(failed: str) -> None:
    place, value = FAULTS[failed]
    body = BALL.copy()
    body[place] = value
    (check,) = check_links(body)
    assert not getattr(check, failed) and not check.consistent


def possible(base: BaseParameters, beta: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """The possible body nearest to base parameters that are well known, with a little pull to the nominal one."""
    penalty, known = np.full(len(ONE_LINK), 1e-6), 1e6 * np.eye(base.count)
    return consistent(base, base.of(beta), known, nominal, penalty).value


def test_possible_values_are_kept() -> None:
    truth, nominal = np.append(BALL, 0.5), np.append(1.2 * BALL, 0.0)
    found = possible(everything(), truth, nominal)
    np.testing.assert_allclose(found, truth, atol=1e-6)


def test_impossible_values_end_at_the_edge() -> None:
    wrong = np.append(BALL, -0.5)
    wrong[4] = -0.02
    found = possible(everything(), wrong, np.append(BALL, 0.0))
    (check,) = check_links(found[:10])
    assert check.consistent and check.least < 1e-2
    assert 0.0 <= found[10] < 1e-6
    assert found[0] == pytest.approx(2.0, abs=0.2)


def test_what_beta_leaves_open_stays_nominal() -> None:
    """Only mx and b show: all else is the nominal arm's."""
    columns, shown = np.zeros((50, len(ONE_LINK))), [1, 10]
    columns[:, shown] = np.random.default_rng(1).standard_normal((50, 2))
    nominal, truth = np.append(BALL, 0.0), np.append(BALL, 0.5)
    truth[1] = 0.22
    found = possible(base_parameters(columns, ONE_LINK), truth, nominal)
    np.testing.assert_allclose(found[shown], [0.22, 0.5], atol=1e-5)
    others = np.setdiff1d(np.arange(len(ONE_LINK)), shown)
    np.testing.assert_allclose(found[others], nominal[others], atol=1e-4)


def test_what_is_recovered_alone_in_combination_and_hidden() -> None:
    """Torque m1 + 2 mx1, my1 alone, and nothing of the others."""
    columns = np.zeros((50, len(ONE_LINK)))
    columns[:, [0, 2]] = np.random.default_rng(2).standard_normal((2, 50)).T
    columns[:, 1] = 2 * columns[:, 0]
    base, value = base_parameters(columns, ONE_LINK), np.append(BALL, 0.0)
    covariance = np.diag(np.linspace(0.01, 0.04, base.count))
    units = ["kg"] * len(ONE_LINK)
    got = recoveries(base, covariance, value, value, units)
    found = {r.name: (r.status, r.std) for r in got}
    status, std = found.pop("my1")
    assert status == RECOVERED and min(abs(std - 0.1), abs(std - 0.2)) < 1e-9
    assert found.pop("m1") == found.pop("mx1") == (COMBINED, None)
    assert {status for status, _ in found.values()} == {HIDDEN}


# The matrices of the base parameters, both ways.


def test_matrices_lead_both_ways(tmp_path: Path) -> None:
    result = identify(panda_case(duration=5.0), IdentificationSettings(cutoff=20.0))
    write_base(result, tmp_path / "base.npz")
    found = np.load(tmp_path / "base.npz", allow_pickle=False)
    p, b = len(found["names"]), len(found["kept_names"])
    assert (p, b) == (98, 69)
    rng = np.random.default_rng(0)
    pi, z = rng.standard_normal(p), rng.standard_normal(p - b)
    beta = found["combination"] @ pi
    gamma = found["orthonormal"].T @ pi
    t = np.arange(100) / 20
    matrix = result.columns.matrix(motion_of(panda_motion(5), t), result.choice.law)
    hidden = found["back"] @ beta + found["null_space"] @ z
    for value, expected in (
        (found["combination"] @ hidden, beta),
        (found["orthonormal"].T @ found["orthonormal"], np.eye(b)),
        (found["from_orthonormal"] @ gamma, beta),
        (found["to_orthonormal"] @ beta, gamma),
        (matrix[:, :, result.base.kept] @ beta, matrix @ pi),
        (matrix @ (found["orthonormal"] @ gamma), matrix @ pi),
    ):
        np.testing.assert_allclose(value, expected, atol=1e-6)
