"""The closed form of the regressor: by hand for a pendulum, against pinocchio for one, two and three joints."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from arms import Link, written

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "experiments"))
symbolic_regressor = importlib.import_module("21_base_parameters").symbolic_regressor

ARMS = {
    "one oblique axis": ["revolute"],
    "two oblique axes": ["revolute", "revolute"],
    "a slide between": ["revolute", "prismatic"],
    "three oblique axes": ["revolute"] * 3,
}


def write_arm(folder, joints, gravity=(0.3, -0.2, -9.81), wanted=None) -> NominalArm:
    """A chain of (kind, xyz, rpy, axis)."""
    links = [
        Link(*(f"j{i}", f"l{i}", axis, xyz, 1, "0 0 0", "1 1 1", "-3 3 9 3", kind, rpy))
        for i, (kind, xyz, rpy, axis) in enumerate(joints, 1)
    ]
    urdf = written(folder / "chain.urdf", "chain", *links)
    names = tuple(f"j{i}" for i, joint in enumerate(joints, 1) if joint[0] != "fixed")
    return NominalArm("chain", urdf, wanted or names, gravity=np.array(gravity))


def assert_agree(arm, samples=40):
    q, dq, ddq = np.random.default_rng(1).standard_normal((3, samples, arm.n_joints))
    numeric = RigidBody(arm).regressor(q, dq, ddq)
    closed = symbolic_regressor(arm).evaluate(q, dq, ddq)
    assert np.abs(numeric).max() > 1
    assert np.abs(closed - numeric).max() < 1e-10 * np.abs(numeric).max()


def text(values) -> str:
    return " ".join(repr(float(x)) for x in values)


@pytest.mark.parametrize(
    "kinds",
    [
        pytest.param(k, marks=pytest.mark.nightly if len(k) > 2 else (), id=name)
        for name, k in ARMS.items()
    ],
)
def test_closed_form_is_pinocchios_regressor(tmp_path, kinds):
    rng = np.random.default_rng(len(kinds))
    joints = [
        (kind, *(text(rng.uniform(-1, 1, 3)) for _ in range(3))) for kind in kinds
    ]
    assert_agree(write_arm(tmp_path, joints))


@pytest.mark.parametrize(
    "joints",
    [
        ("lbr_iiwa_joint_2", "lbr_iiwa_joint_4"),
        ("lbr_iiwa_joint_6", "lbr_iiwa_joint_3"),
    ],
)
def test_joints_that_are_not_named_are_held_at_zero(joints):
    assert_agree(load_nominal_arm("kuka_iiwa", joints=joints))


def test_fixed_joints_belong_to_the_link_before(tmp_path):
    fixed = ("fixed", "0.1 0.2 0.3", "0.4 0.5 0.6", "0 0 1")
    turn = ("revolute", "0.3 0 0.1", "0.1 0 0.2", "0 1 0")
    assert_agree(write_arm(tmp_path, [fixed, turn, fixed, turn, fixed]))


def test_two_planar_links_have_the_textbooks_columns(tmp_path):
    # a point mass at the second joint, 0.5 m out: m l^2 ddq1 + m g l cos q1
    turn = ("revolute", "0 0 0", "0 0 0", "0 0 1")
    out = ("revolute", "0.5 0 0", "0 0 0", "0 0 1")
    closed = symbolic_regressor(write_arm(tmp_path, [turn, out], gravity=(0, -10, 0)))
    column = {name: closed.matrix[:, j] for j, name in enumerate(closed.names)}
    q1, (a1, a2) = closed.q[0], closed.ddq
    assert sp.simplify(column["m2"][0] - 0.25 * a1 - 5.0 * sp.cos(q1)) == 0
    assert sp.simplify(column["m2"][1]) == 0
    assert sp.simplify(column["Izz2"][1] - a1 - a2) == 0


def test_more_than_three_joints_are_refused():
    with pytest.raises(InputError, match="up to 3 joints, the arm has 7"):
        symbolic_regressor(load_nominal_arm("kuka_iiwa"))


def test_joint_of_another_type_is_refused(tmp_path):
    arm = write_arm(tmp_path, [("floating", "0 0 0", "0 0 0", "0 0 1")])
    with pytest.raises(InputError, match="j1 is floating"):
        symbolic_regressor(arm)
