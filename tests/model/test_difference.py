"""What one group of recordings has that another has not, on a three-joint arm that is believed with a poor URDF."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from diagnosis.synthetic import COULOMB, URDF, VISCOUS, Truth, arm, recordings

from gapscope.arm.nominal import NominalArm
from gapscope.model.design import fitted_arm
from gapscope.model.difference import Difference, Search
from gapscope.model.rows import Rows

HEALTHY = Truth(offset=(0.6, -0.5, 0.2))
"""Torque offsets that the arm has on both days [N m]."""
DAYS = 0.15
"""Share by which friction differs from day to day at most [1]."""


@cache
def vendor() -> NominalArm:
    """The arm as a poor URDF has it: masses 15 to 25 % off, a centre of mass 2 cm off, no friction known."""
    text = URDF
    for wrong in (
        ('mass value="6"', 'mass value="7"'),
        ('mass value="5"', 'mass value="4"'),
        ('mass value="3"', 'mass value="3.6"'),
        ('xyz="0.15 0.03 0.02"', 'xyz="0.13 0.03 0.02"'),
    ):
        assert text.count(wrong[0]) == 1
        text = text.replace(*wrong)
    urdf = Path(mkdtemp(prefix="gapscope-tests-")) / "robot.urdf"
    urdf.write_text(text)
    return NominalArm("vendor", urdf, arm().joints, armature=arm().armature)


@cache
def day(truth: Truth, seed: int):
    return recordings(truth, seed, duration=6.0)


def changed(truth: Truth, healthy: Truth = HEALTHY, times: int = 1) -> Difference:
    """What a day has that the day before has not; each recording listed so many times."""
    groups = [times * list(day(healthy, 1)), times * list(day(truth, 2))]
    rows = Rows(groups)
    return Search(rows, fitted_arm(rows, vendor(), {0}), 1, {0}, DAYS).run()


def named(found: Difference) -> dict[tuple[str, int], np.ndarray]:
    return {(t.effect, t.joint): found.value(t) for t in found.terms}


def test_another_day_and_motion_is_no_difference():
    warm = {"coulomb": tuple(-0.1 * COULOMB), "viscous": tuple(-0.1 * VISCOUS)}
    assert not named(changed(replace(HEALTHY, **warm)))


@pytest.mark.parametrize(
    ("truth", "name", "joint", "value"),
    [
        ({"coulomb": (0.0, 0.8 * COULOMB[1], 0.0)}, "coulomb_friction", 2, 0.8 * COULOMB[1]),
        ({"scale": (0.0, 0.15, 0.0)}, "torque_scale", 2, 0.15),
        ({"offset": (0.6, 1.0, 0.2)}, "torque_offset", 2, 1.5),
        ({"mass": 1.0, "com": (0.05, 0.0, 0.1)}, "payload", 0, 1.0),
        ({"tilt": (0.05, 0.0)}, "base_tilt", 0, 0.05),
        ({"delay": (0.0, 0.0, 0.015)}, "actuator_delay", 3, 0.015),
    ],
)  # fmt: skip
def test_one_effect_that_came(truth, name, joint, value):
    found = named(changed(replace(HEALTHY, **truth)))
    assert list(found) == [(name, joint)]
    assert found[name, joint][0] == pytest.approx(value, rel=0.15)


def test_two_effects_that_came():
    truth = replace(HEALTHY, mass=1.0, com=(0.05, 0.0, 0.1), scale=(0.15, 0.0, 0.0))
    found = named(changed(truth))
    assert set(found) == {("payload", 0), ("torque_scale", 1)}


def test_what_both_days_have_is_no_difference():
    both = replace(
        HEALTHY,
        load=(0.0, 0.1, 0.0),
        ripple=(0.0, 0.5, 0.0),
        scale=(0.0, 0.0, 0.2),
    )
    assert not named(changed(both, both))


def test_recordings_listed_ten_times_add_nothing():
    truth = replace(HEALTHY, coulomb=(0.0, 0.8 * COULOMB[1], 0.0))
    once, often = changed(truth), changed(truth, times=10)
    assert named(often).keys() == named(once).keys()
    assert often.sets.keys() == once.sets.keys()
    assert max(abs(often.sets[k] - once.sets[k]) for k in once.sets) < 1e-6


def test_a_torque_that_no_effect_makes_is_unknown():
    def extra(t, q, dq):
        wave = np.sin(9 * q[:, 0]) * np.cos(7 * q[:, 1]) * np.sin(3 * t)
        return 2.0 * wave[:, None] * np.array([0.0, 1.0, 0.0])

    found = changed(replace(HEALTHY, extra=extra))
    assert 1 in {joint for joint, _ in found.fit.grown}
