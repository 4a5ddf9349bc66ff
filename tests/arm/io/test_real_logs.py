"""The logs of five real arms load through their case files, without code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody

CASES = Path(__file__).resolve().parents[3] / "experiments" / "cases"

# case, joints, rate [Hz], samples to fit, samples to judge
EXPECTED = [
    ("staubli_tx40", 6, 5000, [24750], [15750]),
    ("ur10", 6, 125, [3441], []),
    # 727 rows at 30 Hz, of which 14 were stored twice
    ("panda", 7, 29.4, [713], []),
    ("kinova_gen3_sensor", 7, 1000, [4718], []),
    ("kinova_gen3_current", 7, 1000, [4718, 1942], []),
    ("so101", 6, 49.9, [6000, 6000, 5999, 6000], []),
]


@pytest.mark.parametrize(
    ("name", "n_joints", "rate", "fit", "judge"),
    EXPECTED,
    ids=[case[0] for case in EXPECTED],
)
def test_loads(
    name: str,
    n_joints: int,
    rate: float,
    fit: list[int],
    judge: list[int],
    data_root: Path,
) -> None:
    case = load_case(CASES / f"{name}.yaml", data_root=data_root)
    assert case.arm.n_joints == n_joints
    assert [len(recording.t) for recording in case.recordings] == fit
    assert [len(recording.t) for recording in case.judged] == judge
    for recording in case.recordings:
        assert recording.rate == pytest.approx(rate, rel=2e-3)
        assert (recording.tau is None) == (name == "so101")
        assert not any("limited" in note for note in recording.notes)


def test_so101_warns_that_its_torque_is_unsigned(data_root: Path) -> None:
    (warning,) = load_case(CASES / "so101.yaml", data_root=data_root).warnings
    assert warning.endswith(
        "torque is unsigned: only commands and positions can be trusted"
    )


def test_repeated_rows_of_the_kinova_are_reported(data_root: Path) -> None:
    recording, silent = load_case(
        CASES / "kinova_gen3_current.yaml", data_root=data_root
    ).recordings
    assert (
        recording.notes[0]
        == "rows dropped that repeat the measurement before them: 23 (0.49%)"
    )
    left_out, spikes = silent.notes
    assert silent.tau_sensor is None
    assert left_out == "tau_sensor is zero throughout and was left out"
    assert spikes.startswith("spikes replaced by the curve through their neighbours")


def test_sign_and_scale_of_the_staubli_transmission(data_root: Path) -> None:
    """Torque and rigid-body torque with the published friction go together on the joints before the wrist."""
    case = load_case(CASES / "staubli_tx40.yaml", data_root=data_root)
    recording = case.judged[0]
    assert recording.tau is not None
    step = slice(None, None, 50)
    q = recording.q[step]
    dq = np.gradient(q, 50 / recording.rate, axis=0)
    ddq = np.gradient(dq, 50 / recording.rate, axis=0)
    needed = RigidBody(case.arm).inverse_dynamics(q, dq, ddq)
    needed += dq * [8.05, 5.53, 1.97, 1.11, 1.86, 0.65] + ddq * [
        0.362,
        0.362,
        0.0988,
        0.0313,
        0.0468,
        0.0105,
    ]
    needed += np.tanh(dq / 0.005) * [7.14, 8.26, 6.34, 2.48, 3.03, 0.282]
    for j in range(4):
        slope, _ = np.polyfit(needed[:, j], recording.tau[step, j], 1)
        assert slope == pytest.approx(1, abs=0.1), f"joint {j + 1}"
