"""Files of a trajectory: read back they keep all limits; one that does not is not written; a slow version is beside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.errors import GapscopeError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.sampled import Sampled, read_sampled
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.design import SLOW, Excitation, design
from gapscope.ident.excitation.excitation_plan import ExcitationPlan, LimitPlan
from gapscope.ident.excitation.trajectory_files import (
    read_joint_trajectory,
    write_joint_trajectory,
)
from gapscope.ident.excitation.trajectory_search import Budget
from gapscope.ident.excitation.written_check import check_written
from gapscope.outputs.trajectory import write_trajectory

PLAN = ExcitationPlan(order=3, optimiser="random", budget=Budget(60))


@pytest.fixture(scope="module")
def found(arm: NominalArm) -> Excitation:
    limits = LimitPlan(singular=0.0)
    return design(arm, PLAN, limits, np.random.default_rng(1))


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


def _faster(motion: Motion) -> Motion:
    dq = motion.dq.copy()
    dq[1000, 1] = 2.0
    return replace(motion, dq=dq)


def _jerky(motion: Motion) -> Motion:
    """Within the limit of acceleration, but from one side to the other within 4 ms."""
    ddq = motion.ddq.copy()
    ddq[1000:1002, 2] = 4.0, -4.0
    return replace(motion, ddq=ddq)


def _moving_at_last(motion: Motion) -> Motion:
    return Motion(motion.t[:2000], motion.q[:2000], motion.dq[:2000], motion.ddq[:2000])


def _beyond(motion: Motion) -> Motion:
    return replace(motion, q=motion.q + np.array([0.0, 0.0, 3.0]))


def _into_the_floor(motion: Motion) -> Motion:
    """Lift rests at 2.2 rad, within its limits, with the rest of the arm stretched below the floor."""
    q = np.tile([0.0, 2.2, 0.0], (len(motion.t), 1))
    return replace(motion, q=q, dq=0 * q, ddq=0 * q)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (_faster, r"joint 2 breaks its limit of velocity by 0\.5\S* rad/s at 4\.000 s"),
        (_jerky, r"joint 3 breaks its limit of jerk by .* rad/s\^3 at 4\.0"),
        (_moving_at_last, r"joint \d does not rest at 7\.996 s"),
        (_beyond, "joint 3 breaks its limit of position by .* rad"),
        (_into_the_floor, "the arm breaks its limit of distance by .* m"),
    ],
)
def test_what_breaks_a_limit_is_not_written(
    changed: Callable[[Motion], Motion],
    words: str,
    found: Excitation,
    arm: NominalArm,
    tmp_path: Path,
) -> None:
    spoilt = replace(found, motion=changed(found.motion))
    with pytest.raises(GapscopeError, match=words) as refused:
        write_trajectory(spoilt, arm, PLAN, tmp_path / "x.csv")
    assert refused.value.remedy
    assert not list(tmp_path.iterdir())


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


def test_a_path_that_gravity_forbids_when_slow_is_seen(found: Excitation) -> None:
    """Inertia may hold up an arm in motion; the slow version then needs more torque than the full one."""
    t = np.linspace(0.0, 1.0, 5)
    q = np.tile([0.0, 1.2, 0.0], (5, 1))
    falling = Motion(t, q, 0 * q, np.tile([0.0, 4.0, 0.0], (5, 1)))
    full, slow = (
        np.abs(found.checker.torque(m))[:, 1].max()
        for m in (falling, Sampled(falling).slower(SLOW).motion)
    )
    margin = found.checker.margin_when_slow(falling, SLOW)
    assert margin.name == "torque when slow"
    assert margin.margin[1] == pytest.approx(margin.limit[1] - slow)
    assert slow > full
