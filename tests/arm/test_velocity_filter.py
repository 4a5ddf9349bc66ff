"""The velocity filter of a controller: which rules can be, and which one a recording shows."""

import numpy as np
import pytest

from gapscope.arm.control import PD
from gapscope.arm.recording import Recording
from gapscope.arm.velocity_filter import VelocityFilter, rule_of


@pytest.mark.parametrize("rule", ["bilinear", "backward"])
def test_rule_is_recognised_where_another_would_be_unstable(rule: str) -> None:
    """At 500 Hz and 80 Hz the semi-implicit rule diverges."""
    rate = 500.0
    t = np.arange(0.0, 4.0, 1 / rate)
    q = 0.5 * np.sin(2 * np.pi * 1.5 * t)[:, None]
    filtered = VelocityFilter(rate, 80.0, 0.9, q[0], np.array([np.pi * 1.5]), rule=rule)
    dq = np.array([filtered(row) for row in q])
    controller = PD(
        rate=rate,
        kp=np.ones(1),
        kd=np.ones(1),
        velocity_cutoff=80.0,
        velocity_damping=0.9,
    )
    assert rule_of(Recording("log", t, q, dq=dq), controller) == rule
