"""Reference motions keep their limits, start and end at rest, and their derivatives are derivatives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arms import ROD, Link, written
from sweeps import daily

from gapscope.arm.dynamics.kinematics import Kinematics, inverse_kinematics
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.motions.named_motions import (
    MOTIONS,
    Workspace,
    draw_motion,
    motions_for,
    weld_seam,
    workspace,
)
from gapscope.arm.motions.trajectory import (
    Fourier,
    Limits,
    ReferenceMotion,
    fastest,
    point_to_point,
    read_sampled,
)
from gapscope.arm.robots import KNOWN_ROBOTS, load_nominal_arm

LIMITS = Limits(*map(np.array, ([-1.0, -2.0], [1.5, 0.5], [0.8, 2.0], [3.0, 40.0])))


def _motion(seed: int = 0, **options: Any) -> Fourier:
    how = {"duration": 12.0, "frequency": 0.1} | options
    return Fourier.random(np.random.default_rng(seed), LIMITS, **how)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("frequency", [0.1, 0.4])
def test_limits_hold_and_one_is_met(seed: int, frequency: float) -> None:
    motion, t = _motion(seed, frequency=frequency), np.linspace(0, 12, 12001)
    q, dq, ddq = (np.abs(part).max(0) for part in _series(motion, t, motion.centre))
    room = np.minimum(LIMITS.upper - motion.centre, motion.centre - LIMITS.lower)
    use = [q / room, dq / LIMITS.velocity, ddq / LIMITS.acceleration]
    np.testing.assert_allclose(np.max(use, axis=0), 1.0, atol=1e-9)


def _series(
    motion: ReferenceMotion, t: np.ndarray, centre: np.ndarray | float = 0.0
) -> tuple[np.ndarray, ...]:
    """Position from a centre, velocity and acceleration."""
    return motion.position(t) - centre, motion.velocity(t), motion.acceleration(t)


# A reference motion through samples of a file.


@pytest.fixture
def sampled(tmp_path: Path) -> tuple[Path, Fourier]:
    """A motion of two joints, and its file with a sample every 20 ms."""
    motion, t = _motion(duration=4.0, frequency=0.25), np.arange(201) / 50
    names = ("q_ref", "dq_ref", "ddq_ref")
    series = dict(zip(names, _series(motion, t), strict=True))
    write_columns(numbered({"t": t} | series), tmp_path / "a.csv")
    return tmp_path / "a.csv", motion


def test_motion_between_samples_is_the_source(sampled: tuple[Path, Fourier]) -> None:
    (path, source), t = sampled, np.linspace(0, 4, 777)
    found = read_sampled(path, 2)
    pairs = zip(_series(found, t), _series(source, t), strict=True)
    for (one, other), within in zip(pairs, (1e-7, 1e-5, 1e-2), strict=True):
        np.testing.assert_allclose(one, other, atol=within)
    assert found.duration == 4.0


def test_bad_files_are_refused(sampled: tuple[Path, Fourier]) -> None:
    path, _ = sampled
    with pytest.raises(InputError, match="no such file"):
        read_sampled(path.with_name("none.csv"), 2)
    with pytest.raises(InputError, match="q_ref3"):
        read_sampled(path, 3)
    text = path.read_text().splitlines()
    spoilt = text[5].replace(text[5].split(",")[1], "nan")
    path.write_text("\n".join([*text[:5], spoilt, *text[6:]]))
    with pytest.raises(InputError, match="line 6"):
        read_sampled(path, 2)
    path.write_text("\n".join([text[0], *text[3:]]))
    with pytest.raises(InputError, match="starts at 0"):
        read_sampled(path, 2)


# Named motions: limits hold, derivatives are derivatives, straight lines are straight.


DURATION = 8.0


@pytest.fixture(scope="module", params=daily(KNOWN_ROBOTS, "franka_panda"))
def space(request: pytest.FixtureRequest) -> Workspace:
    return workspace(RigidBody(load_nominal_arm(request.param)))


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("seed", daily(range(2), 0))
def test_named_motions_keep_limits_and_derivatives_are_derivatives(
    space: Workspace, name: str, seed: int
) -> None:
    motion, again = (
        draw_motion(name, np.random.default_rng(seed), space, DURATION) for _ in "ab"
    )
    limits, t = space.limits, np.linspace(0.0, DURATION, 8001)
    q, dq, ddq = _series(motion, t)
    np.testing.assert_array_equal(q, again.position(t))
    assert (q >= limits.lower).all() and (q <= limits.upper).all()
    assert (np.abs(dq) <= limits.velocity * (1 + 1e-9)).all()
    assert (np.abs(ddq) <= limits.acceleration * (1 + 1e-9)).all()
    assert np.abs(dq[0]).max() < 1e-12 and np.abs(ddq[0]).max() < 1e-9
    assert np.abs(dq).max() > 0.1
    t, h = t[11:-11:10], 1e-5
    ahead, at, behind = (_series(motion, t + x) for x in (h, 0.0, -h))
    for k in (0, 1):
        slope = (ahead[k] - behind[k]) / (2 * h)
        np.testing.assert_allclose(slope, at[k + 1], atol=5e-6)


def test_weld_seam_is_straight_at_constant_speed(space: Workspace) -> None:
    """The tool is on the line to 10 um, turns by less than 0.1 mrad and keeps its speed over 60 % of the time."""
    way = np.array([0.03, -0.06, 0.02])
    seam = weld_seam(space.kinematics, space.posture, way, space.limits, speed=0.05)
    t = np.linspace(-0.1, seam.duration + 0.1, 501)
    poses = [space.kinematics.tool(q) for q in seam.position(t)]
    start, length = space.kinematics.tool(space.posture), np.linalg.norm(way)
    tool = np.array([pose.translation for pose in poses]) - start.translation
    along = tool @ way / length
    aside = tool - np.outer(along, way / length)
    assert np.linalg.norm(aside, axis=1).max() < 1e-5
    np.testing.assert_allclose([along[0], along[-1]], [0.0, length], atol=1e-6)
    turned = np.array([pose.rotation for pose in poses]) - poses[0].rotation
    assert np.abs(turned).max() < 1e-4
    speed = np.diff(along) / np.diff(t)
    middle = (t[:-1] > 0.21 * seam.duration) & (t[1:] < 0.79 * seam.duration)
    np.testing.assert_allclose(speed[middle], speed.max(), rtol=1e-3)
    assert speed.max() <= 0.05 * 1.001


def test_inverse_kinematics_finds_the_posture_it_came_from_and_says_when_out_of_reach(
    space: Workspace,
) -> None:
    kinematics, posture = space.kinematics, space.posture
    target = kinematics.tool(posture + 0.1)
    found = kinematics.tool(inverse_kinematics(kinematics, target, posture))
    np.testing.assert_allclose(found.translation, target.translation, atol=1e-6)
    np.testing.assert_allclose(found.rotation, target.rotation, atol=1e-5)
    with pytest.raises(GapscopeError, match="cannot reach"):
        far = pin.SE3(target.rotation, np.full(3, 5.0))
        inverse_kinematics(kinematics, far, posture)


def test_fastest_point_to_point_meets_a_limit() -> None:
    motion = fastest(np.zeros(2), np.array([0.5, -1.5]), LIMITS)
    _, dq, ddq = _series(motion, np.linspace(0, motion.duration, 4001))
    use = np.abs([dq / LIMITS.velocity, ddq / LIMITS.acceleration])
    assert use.max() == pytest.approx(1.0, abs=1e-6)


def test_bad_requests_are_refused_with_what_to_do(space: Workspace) -> None:
    rng, posture = np.random.default_rng(0), space.posture
    refused = {
        "joint 2": lambda: _motion(centre=np.array([0.0, 1.0])),
        "cannot rise": lambda: _motion(duration=1.5),
        "did you mean 'weld_seam'": lambda: draw_motion("weldseam", rng, space, 8.0),
        "not a positive duration": lambda: point_to_point(posture, posture, 0.0),
        "joint 1": lambda: fastest(posture, space.limits.upper + 1.0, space.limits),
    }
    for message, request in refused.items():
        with pytest.raises(InputError, match=message):
            request()


def test_an_arm_of_one_joint_moves_but_holds_no_line(tmp_path) -> None:
    link = ROD._replace(axis="1 0 0", mass=1, com="0 0 0", inertia="1 1 1")
    urdf = written(tmp_path / "rod.urdf", "rod", link)
    body = RigidBody(load_nominal_arm(urdf))
    space = workspace(body)
    assert motions_for(1) == ("fourier", "point_to_point")
    assert isinstance(Kinematics(body).skeleton(np.zeros(1)), np.ndarray)
    draw_motion("random", np.random.default_rng(0), space, 2.0)
    with pytest.raises(InputError, match="three joints"):
        draw_motion("pick", np.random.default_rng(0), space, 2.0)
    with pytest.raises(InputError, match="expected 1 numbers"):
        workspace(body, posture=np.zeros(3))
    with pytest.raises(InputError, match="outside its limits"):
        workspace(body, posture=np.full(1, 9.0))


def test_of_a_narrow_range_the_margin_leaves_half(tmp_path: Path) -> None:
    """A range of +-0.06 rad, as of a file whose radians are read as degrees, within the margin of 0.1 rad."""
    wide = Link("wide", "a", origin="0 0 0.3", com="0 0 0.1", limit="-2 2 50 2")
    narrow = wide._replace(joint="narrow", name="b", limit="-0.06 0.06 50 2")
    file = written(tmp_path / "robot.urdf", "narrow", wide, narrow)
    limits = workspace(RigidBody(load_nominal_arm(file))).limits
    assert limits.lower == pytest.approx([-1.9, -0.03])
    assert limits.upper == pytest.approx([1.9, 0.03])


def test_tool_jacobian_agrees_with_finite_differences(space: Workspace) -> None:
    kinematics, posture, h = space.kinematics, space.posture, 1e-6
    points = kinematics.skeleton(posture)
    assert points.shape == (len(posture) + 2, 3) and not points[0].any()
    assert np.abs(points[-1] - kinematics.tool(posture).translation).max() < 0.05
    jacobian = kinematics.tool_jacobian(posture)
    for step, column in zip(h * np.eye(len(posture)), jacobian.T, strict=True):
        ahead, behind = (kinematics.tool(posture + s * step) for s in (1, -1))
        slope = (ahead.translation - behind.translation) / (2 * h)
        np.testing.assert_allclose(slope, column[:3], atol=1e-8)
        spin = (ahead.rotation @ behind.rotation.T - np.eye(3)) / (2 * h)
        about = [spin[2, 1], spin[0, 2], spin[1, 0]]
        np.testing.assert_allclose(about, column[3:], atol=1e-5)


def test_quintic_by_hand() -> None:
    """From 0 to 2 rad in 4 s: 1 rad at half time, there 15/8 * 2/4 rad/s; 16 s(1/4) = 53/32."""
    motion = point_to_point(np.zeros(1), np.full(1, 2.0), 4.0)
    t, speed = np.array([-1.0, 0.0, 1.0, 2.0, 4.0, 9.0]), 2 / 4 * 135 / 128
    q, dq, ddq = (part[:, 0] for part in _series(motion, t))
    np.testing.assert_allclose(q, [0, 0, 2 * 53 / 512, 1, 2, 2], atol=1e-14)
    np.testing.assert_allclose(dq, [0, 0, speed, 0.9375, 0, 0], atol=1e-14)
    np.testing.assert_allclose(ddq[[0, 1, 3, 4, 5]], 0, atol=1e-14)
