"""The logs of five real arms load through their case files, without code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody

CASES = Path(__file__).resolve().parents[3] / "experiments" / "cases"

# case, joints, rate [Hz], samples to fit, samples to judge


EXPECTED = {
    "staubli_tx40": (6, 5000, [24750], [15750]),
    "ur10": (6, 125, [3441], []),
    # 727 rows at 30 Hz, of which 14 were stored twice
    "panda": (7, 29.4, [713], []),
    "kinova_gen3_sensor": (7, 1000, [4718], []),
    "kinova_gen3_current": (7, 1000, [4718, 1942], []),
    "so101": (6, 49.9, [6000, 6000, 5999, 6000], []),
}
"""Joints, rate [Hz], samples to fit, samples to judge."""
SAID = {
    "kinova_gen3_current": (
        "rows dropped that repeat the measurement before them: 23 (0.49%)",
        "tau_sensor is zero throughout and was left out",
        "spikes replaced by the curve through their neighbours",
    ),
    "so101": ("torque is unsigned: only commands and positions can be trusted",),
}
"""Notes and warnings of the logs of some."""


@pytest.mark.parametrize("name", EXPECTED)
def test_loads(name: str, data_root: Path) -> None:
    n_joints, rate, fit, judge = EXPECTED[name]
    case = load_case(CASES / f"{name}.yaml", data_root=data_root)
    assert case.arm.n_joints == n_joints
    assert [len(recording.t) for recording in case.recordings] == fit
    assert [len(recording.t) for recording in case.judged] == judge
    notes = "\n".join([*(x for r in case.recordings for x in r.notes), *case.warnings])
    assert "limited" not in notes and all(x in notes for x in SAID.get(name, ()))
    for recording in case.recordings:
        assert recording.rate == pytest.approx(rate, rel=2e-3)
        assert (recording.tau is None) == (name == "so101")


def test_sign_and_scale_of_the_staubli_transmission(data_root: Path) -> None:
    """Torque and rigid-body torque with the published friction go together on the joints before the wrist."""
    case = load_case(CASES / "staubli_tx40.yaml", data_root=data_root)
    recording, step = case.judged[0], slice(None, None, 50)
    q, h = recording.q[step], 50 / recording.rate
    dq = np.gradient(q, h, axis=0)
    ddq = np.gradient(dq, h, axis=0)
    needed = RigidBody(case.arm).inverse_dynamics(q, dq, ddq)
    needed += dq * [8.05, 5.53, 1.97, 1.11, 1.86, 0.65]
    needed += ddq * [0.362, 0.362, 0.0988, 0.0313, 0.0468, 0.0105]
    needed += np.tanh(dq / 0.005) * [7.14, 8.26, 6.34, 2.48, 3.03, 0.282]
    for j in range(4):
        slope, _ = np.polyfit(needed[:, j], recording.tau[step, j], 1)
        assert slope == pytest.approx(1, abs=0.1), f"joint {j + 1}"
