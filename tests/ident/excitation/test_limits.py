"""Collision, singular poses, torque and sampling: golden values by hand, and refusals that say why."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.dynamics.inertials import box_edges
from gapscope.arm.dynamics.link_shapes import CollisionModel
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Limits, read_sampled
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.excitation.design import (
    SLOW,
    Excitation,
    ExcitationPlan,
    LimitPlan,
    check_written,
    design,
    prepare,
    read_joint_trajectory,
    write_joint_trajectory,
)
from gapscope.ident.excitation.trajectory_search import Allowed, Budget, Checker
from gapscope.reports.trajectory import write_trajectory

Change = Callable[[Motion], object]
DOWN = np.array([0.3, np.pi / 2 + 0.2, 0.0])


def test_distance_to_the_surface_by_hand(arm: NominalArm, body: RigidBody) -> None:
    """Lift by a: the lowest corner of the third box lies 1.1 m along the arm, 0.04 m across it."""
    angle = DOWN[1]
    expected = 0.3 + 1.1 * np.cos(angle) - 0.04 * np.sin(angle)
    distance, pair = CollisionModel(arm, body).distance(DOWN[None])
    model = CollisionModel(arm, body)
    assert "surface" in model.pairs[pair[0]]
    assert distance[0] == pytest.approx(expected, abs=1e-6)


def test_neighbours_and_bodies_that_always_touch_are_left_out(
    arm: NominalArm, body: RigidBody
) -> None:
    model = CollisionModel(arm, body, height=0.16)
    assert not any({"first_0", "second_0"} == set(pair) for pair in model.pairs)
    assert any("first_0" in pair and "surface" in pair for pair in model.left_out)


BARE = (
    '<robot name="r"><link name="a"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
    '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint><link name="b">{}</link></robot>'
)


def test_arm_without_shapes_and_mass_is_refused_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "bare.urdf"
    path.write_text(BARE.format(""))
    arm = load_nominal_arm(path)
    with pytest.raises(InputError, match="collision shapes.*\n.*--no-collisions"):
        CollisionModel(arm, RigidBody(arm))


BOX = (
    '<inertial><origin xyz="0 0 1"/><mass value="12"/>'
    '<inertia ixx="0.52" iyy="0.40" izz="0.20" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<collision><origin xyz="0 0 1"/><geometry><{}/></geometry></collision>'
)


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ('capsule radius="0.1" length="0.4"', None),
        ('mesh filename="package://lost/b.stl"', "package://lost/b.stl: .*boxes"),
        ("cone", "<cone>, which is not read"),
    ],
)
def test_capsules_are_read_and_boxes_stand_in_for_other_forms(
    shape: str, said: str | None, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    """A box of 0.2 x 0.4 x 0.6 m and 12 kg has these moments; it ends 0.3 m below 1 m, as the capsule does."""
    assert box_edges(12.0, np.array([0.52, 0.40, 0.20])) == pytest.approx([0.2, 0.4, 0.6])  # fmt: skip
    path = tmp_path / "arm.urdf"
    path.write_text(BARE.format(BOX.format(shape)))
    arm = load_nominal_arm(path)
    model = CollisionModel(arm, RigidBody(arm))
    distance, pair = model.distance(np.array([[0.5]]))
    assert distance[0] == pytest.approx(0.7)
    assert ("box of j" in model.pairs[pair[0]]) == (said is not None)
    found = [str(warning.message) for warning in recwarn]
    assert len(found) == (said is not None)
    assert all(re.search(str(said), text) for text in found)


def test_boxes_stand_in_for_meshes_that_are_missing(tmp_path: Path) -> None:
    """A KUKA iiwa's URDF copied without its meshes is as far from the floor as the arm itself, to 5 cm."""
    pytest.importorskip("pybullet_data", reason="the iiwa's meshes are there")
    named = load_nominal_arm("kuka_iiwa")
    path = tmp_path / "arm.urdf"
    path.write_text(named.urdf.read_text())
    arm = load_nominal_arm(path)
    with pytest.warns(ModelWarning, match="meshes are not found"):
        boxes = CollisionModel(arm, RigidBody(arm))
    meshes = CollisionModel(named, RigidBody(named))
    q = np.zeros((5, 7))
    q[:, 1] = np.linspace(1.2, 2.0, 5)
    assert boxes.distance(q)[0] == pytest.approx(meshes.distance(q)[0], abs=0.05)


def test_another_format_gets_boxes_as_well(
    arm: NominalArm, body: RigidBody, tmp_path: Path
) -> None:
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    with pytest.warns(ModelWarning, match="URDF files alone"):
        model = CollisionModel(replace(arm, urdf=tmp_path / "arm.xml"), body)
    assert model.pairs


def checker(
    arm: NominalArm, body: RigidBody, limits: Limits, **changed: object
) -> Checker:
    allowed = Allowed(limits, np.full(3, 40.0), 0.01, 0.01)
    return Checker(arm, body, replace(allowed, **changed), CollisionModel(arm, body))


def test_margins_say_how_far_when_and_which(
    arm: NominalArm, body: RigidBody, limits: Limits
) -> None:
    t = np.array([0.0, 0.5, 1.0])
    q = np.array([[0.1, 0.5, 0.4], [0.3, 1.4, 0.4], [0.1, 0.5, 0.4]])
    motion = Motion(t, q, 0 * q, 0 * q)
    torque = body.inverse_dynamics(q, 0 * q, 0 * q)
    found = checker(arm, body, limits).margins(motion, torque)
    margins = {margin.name: margin.margin for margin in found}
    expected = {
        "position": [1.7, 0.1, 1.6],
        "velocity": limits.velocity,
        "jerk": limits.acceleration / 0.02,
        "torque": 40.0 - np.abs(torque).max(axis=0),
    }
    for name, margin in expected.items():
        np.testing.assert_allclose(margins[name], margin)
    assert next(m for m in found if m.name == "position").at == 0.5
    others = {"acceleration", "singular value", "distance"}
    assert set(margins) == expected.keys() | others


def test_torque_limits_come_from_the_data_sheet_first(
    arm: NominalArm, body: RigidBody
) -> None:
    sheet = replace(arm, torque_limit=np.array([10.0, 20.0, 30.0]))
    for known, torque in ((arm, [30.0] * 3), (sheet, [5.0, 10.0, 15.0])):
        allowed = LimitPlan(torque=0.5).allowed(known, body)
        np.testing.assert_allclose(allowed.torque, torque)


# Files of a trajectory: read back they keep all limits; one that does not is not written; a slow version is beside.


PLAN = ExcitationPlan(order=3, optimiser="random", budget=Budget(60))


@pytest.fixture(scope="module")
def found(arm: NominalArm) -> Excitation:
    limits = LimitPlan(singular=0.0)
    return design(prepare(arm, PLAN, limits), np.random.default_rng(1))


def test_the_slow_version_is_the_same_path_at_a_fifth_of_the_speed(
    found: Excitation, arm: NominalArm, tmp_path: Path
) -> None:
    paths = write_trajectory(found, arm, PLAN, tmp_path / "x.csv")
    assert sorted(paths) == sorted(tmp_path.iterdir())
    full = read_sampled(tmp_path / "x.csv", 3)
    slow = read_sampled(tmp_path / "x_slow.csv", 3)
    # a player of rows goes through both at the same rate
    assert slow.motion.rate == pytest.approx(full.motion.rate)
    t = np.linspace(0.0, full.duration, 777)
    for version in (slow, read_joint_trajectory(tmp_path / "x_slow.yaml")):
        assert version.duration == pytest.approx(full.duration / SLOW)
        np.testing.assert_allclose(
            version.position(t / SLOW), full.position(t), atol=1e-6
        )
        np.testing.assert_allclose(
            version.velocity(t / SLOW), SLOW * full.velocity(t), atol=1e-5
        )


def faster(m: Motion) -> None:
    m.dq[1000, 1] = 2.0


def jerky(m: Motion) -> None:
    """Within the limit of acceleration, but from one side to the other within 4 ms."""
    m.ddq[1000:1002, 2] = 4.0, -4.0


def beyond(m: Motion) -> None:
    m.q[:, 2] += 3.0


def into_the_floor(m: Motion) -> None:
    """Lift rests at 2.2 rad, within its limits, with the rest of the arm stretched below the floor."""
    m.q[:] = [0.0, 2.2, 0.0]
    m.dq[:] = m.ddq[:] = 0.0


@pytest.mark.parametrize(
    ("change", "rows", "words"),
    [
        (faster, 2501, r"joint 2 breaks its limit of velocity by 0\.5\S* rad/s at 4\.000 s"),
        (jerky, 2501, r"joint 3 breaks its limit of jerk by .* rad/s\^3 at 4\.0"),
        (str, 2000, r"joint \d does not rest at 7\.996 s"),
        (beyond, 2501, "joint 3 breaks its limit of position by .* rad"),
        (into_the_floor, 2501, "the arm breaks its limit of distance by .* m"),
    ],
)  # fmt: skip
def test_what_breaks_a_limit_is_not_written(
    change: Change,
    rows: int,
    words: str,
    found: Excitation,
    arm: NominalArm,
    tmp_path: Path,
) -> None:
    m = found.motion
    motion = Motion(*(x[:rows].copy() for x in (m.t, m.q, m.dq, m.ddq)))
    change(motion)
    spoilt = replace(found, motion=motion)
    with pytest.raises(GapscopeError, match=words) as refused:
        write_trajectory(spoilt, arm, PLAN, tmp_path / "x.csv")
    assert refused.value.remedy and not list(tmp_path.iterdir())


def test_a_breach_between_the_samples_is_found(
    found: Excitation, arm: NominalArm, tmp_path: Path
) -> None:
    """Every point rests within the limits; the spline between two of them is too fast."""
    q = found.motion.q[[0, 0]] + np.array([[0.0] * 3, [0.2, 0.0, 0.0]])
    points = Motion(np.array([0.0, 0.2]), q, 0 * q, 0 * q)
    path = tmp_path / "x.yaml"
    write_joint_trajectory(points, arm.joints, path)
    written = read_joint_trajectory(path)
    # the largest speed of a quintic from rest to rest is 15/8 of the mean
    excess = 15 / 8 * 0.2 / 0.2 - 1.5
    with pytest.raises(
        GapscopeError, match=f"joint 1 .* velocity by {excess:.3g} rad/s at 0.100 s"
    ):
        check_written(written, found.checker, path)
