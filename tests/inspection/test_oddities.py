"""What looks wrong in a log, put in one by one; and nothing in a good one."""

from __future__ import annotations

import numpy as np
import pytest
from foreign_logs import case_format, columns, inspected

from gapscope.inspection.inspection import check_draft, judge_torques


def oddities(motion, tmp_path, **changed) -> str:
    table = case_format(motion) | changed
    found = judge_torques(inspected(tmp_path, None, log=table))
    remarks = (*found.misread, *check_draft(found))
    return "; ".join(one.text for one in remarks if one.level != "ok")


def test_a_good_log_has_none(motion, tmp_path):
    assert oddities(motion, tmp_path) == ""


def spiked(motion):
    q = motion.q[:, 1].copy()
    q[300] += 1.0
    return {"q2": q}


def clipped(motion):
    return {"tau2": np.clip(motion.tau[:, 1], -20, 20)}


def gap(motion):
    return {"t": motion.t + 0.4 * (motion.t > 3)}


def jitter(motion):
    rng = np.random.default_rng(1)
    return {"t": motion.t + 0.001 * rng.standard_normal(len(motion.t))}


def still(motion):
    rng = np.random.default_rng(1)
    return columns("q{j}", 0.3 + 1e-5 * rng.standard_normal(motion.q.shape))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (spiked, "spikes replaced by the curve through their neighbours: q2 1"),
        (clipped, "largest or least value: tau2"),
        (gap, "gaps in time: 1"),
        (jitter, "Time stamps (jitter)"),
        (lambda m: {"q3": 0 * m.t + 0.4}, "joint 3: at rest"),
        (still, "joints 1, 2, 3, 4, 5, 6, 7: at rest"),
        (
            lambda m: {"tau1": np.where(np.arange(len(m.t)) % 3, 1.0, np.nan)},
            "400 cells",
        ),
        (lambda m: columns("q_ref{j}", m.q), "the same numbers"),
        (lambda m: columns("dq{j}", 0 * m.q), "dq{j} left out: it is 0 throughout"),
        (lambda m: columns("q_ref{j}", m.q[(np.arange(len(m.t)) // 8) * 8]), "1/8"),
    ],
)
def test_what_looks_wrong_is_said(change, expected, motion, tmp_path):
    assert expected in oddities(motion, tmp_path, **change(motion))
