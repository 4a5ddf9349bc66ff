"""What a torque column can be: silent, unsigned, computed, a multiple, gravity in or out, amperes, turned."""

from __future__ import annotations

import numpy as np
import pytest
from foreign_logs import case_format, columns, inspected

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.inspection.inspection import judge_torques


def said_of_torque(found) -> str:
    """All sentences on the columns that were taken for the torque."""
    return "; ".join(found.chosen["tau"][1].facts)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda tau, g: tau, "in N m of the joint, gravity included"),
        (lambda tau, g: tau - g, "Gravity compensated torque"),
        (lambda tau, g: -tau, "Sign flip (torque)"),
        (lambda tau, g: tau / 11, "Torque unit (current)"),
        (lambda tau, g: np.abs(tau), "magnitude"),
        (lambda tau, g: 0 * tau, "nothing was measured"),
        (lambda tau, g: tau[:, [2, 1, 0, 3, 4, 5, 6]], "Joint swap (torque)"),
    ],
)
def test_what_the_torque_is(change, expected, arm, motion, tmp_path):
    table = case_format(motion)
    changed = change(motion.tau, RigidBody(arm).gravity_torque(motion.q))
    table |= columns("tau{j}", changed)
    found = judge_torques(inspected(tmp_path, arm, log=table))
    assert expected in said_of_torque(found)


def test_a_computed_torque_is_told_with_its_gains(motion, tmp_path):
    rng = np.random.default_rng(0)
    reference = motion.q + 0.01 * rng.standard_normal(motion.q.shape)
    table = {
        "t": motion.t,
        **columns("q{j}", motion.q),
        **columns("dq{j}", motion.dq),
        **columns("q_ref{j}", reference),
        **columns("tau{j}", 80 * (reference - motion.q) - 2.5 * motion.dq),
    }
    said = said_of_torque(judge_torques(inspected(tmp_path, None, log=table)))
    assert "computed" in said and "kp 80, 80" in said and "kd 2.5, 2.5" in said


def test_a_multiple_of_another_column_is_told(motion, tmp_path):
    table = case_format(motion) | columns("current{j}", motion.tau / 9)
    assert "times 9" in said_of_torque(inspected(tmp_path, None, log=table))
