"""Readings compared by the evidence of their torque; faults of the stamps."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import synthetic
from sweeps import nightly

from gapscope.arm.case import Case, load_case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.clocks import (
    encoder_step,
    find_quantization,
    find_stamps,
    lost,
)
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, merged
from gapscope.effects.setup_faults import JointSwap, SignFlip, UnitMismatch

# Findings of one fault on several joints become one finding.


def flip(joint: int, probability: float = 0.9) -> FoundFault:
    return FoundFault(SignFlip((joint,)), probability)


def test_values_are_sorted_with_their_joints() -> None:
    one, other = (
        UnitMismatch("motor_side", (2,), 50.0),
        UnitMismatch("motor_side", (1,), 100.0),
    )
    first = FoundFault(one, 0.9, {"ratio": (5.0,)})
    (found,) = merged((first, FoundFault(other, 0.9, {"ratio": (10.0,)})))
    assert found.fault == UnitMismatch("motor_side", (1, 2), (100.0, 50.0))
    assert found.std == {"ratio": (10.0, 5.0)}
    torque = found.reading(3).torque(np.ones((1, 3)))
    np.testing.assert_array_equal(torque, [[100.0, 50.0, 1.0]])


def test_a_swap_keeps_all_faults_apart() -> None:
    swap = FoundFault(JointSwap((1, 2)), 0.9)
    assert merged((flip(1), swap, flip(2))) == (flip(1), swap, flip(2))


# Encoder steps read from positions.


def rounded(
    case: Case, steps: dict[int, float], digits: int = 7, offset: float = 0.0
) -> Case:
    """The case with joints, from 1, rounded to steps after noise, and written with so many significant digits."""
    rng = np.random.default_rng(0)
    recordings = []
    for recording in case.recordings:
        q = recording.q + 2e-5 * rng.standard_normal(recording.q.shape)
        for joint, step in steps.items():
            q[:, joint - 1] = np.round(q[:, joint - 1] / step) * step + offset
        text = np.vectorize(lambda x: float(f"{x:.{digits}g}"))
        recordings.append(replace(recording, q=text(q)))
    return replace(case, recordings=tuple(recordings))


STEPS = [2 * np.pi / 2**k for k in (9, 12, 16)]
WRITTEN = list(product(STEPS, (0.0, 0.01234), (6, 7)))
"""Steps of encoders [rad], offsets of positions [rad], significant digits of the log."""


@pytest.mark.parametrize(
    ("step", "offset", "digits"),
    [form if k in (0, 7, 9) else nightly(*form) for k, form in enumerate(WRITTEN)],
)
def test_step_is_found(step: float, offset: float, digits: int) -> None:
    (found,) = find_quantization(rounded(synthetic.case(), {2: step}, digits, offset))
    assert found.name == "encoder_quantization" and found.joints == (2,)
    quantity = found.document()["parameters"]["step"]
    assert quantity["unit"] == "rad"
    assert abs(quantity["value"][0] / step - 1) < 1e-3
    assert quantity["std"][0] < 1e-3 * step


def test_step_of_the_data_sheet_is_found_and_not_named() -> None:
    case = synthetic.case()
    assert find_quantization(case) == ()
    step = encoder_step(case.recordings, 0)
    assert step is not None and abs(step[0] / synthetic.ENCODER_STEP - 1) < 1e-3


def test_without_a_data_sheet_only_what_matters_is_named() -> None:
    silent = replace(synthetic.case(), arm=replace(synthetic.arm(), encoder_step=None))
    assert find_quantization(silent) == ()
    assert find_quantization(rounded(silent, {1: 2 * np.pi / 2**16})) == ()
    assert find_quantization(rounded(silent, {1: 2 * np.pi / 2**12}))[0].joints == (1,)


@pytest.mark.shared_data
def test_a_12_bit_servo_is_known_by_its_positions(data_root: Path) -> None:
    file = Path(__file__).parents[3] / "experiments" / "cases" / "so101.yaml"
    (found,) = find_quantization(load_case(file, data_root=data_root))
    step = found.fault.values()["step"]
    np.testing.assert_allclose(step[:5], 2 * np.pi / 4096, rtol=1e-4)


@pytest.mark.shared_data
def test_sample_cases_keep_to_their_data_sheets(sample_cases: Path) -> None:
    for folder in sorted(sample_cases.glob("case*")):
        assert find_quantization(load_case(folder)) == ()


# Faults of the stamps that small recordings show, made by hand.


T = np.arange(3000) / 250


def moving(name: str, clock: float, stamps: np.ndarray = T) -> Recording:
    """Recorded positions and velocities, stamped by a clock that runs at a rate of its own [1]."""
    q = np.column_stack([np.sin(2 * T), np.cos(3 * T)])
    dq = np.column_stack([2 * np.cos(2 * T), -3 * np.sin(3 * T)])
    return Recording(name, clock * stamps, q, dq=dq)


def test_a_rate_off_by_one_per_cent_in_all_recordings_is_named() -> None:
    (found,) = find_stamps([moving("a", 0.99), moving("b", 0.99)])
    assert found.variant == "wrong_rate"
    np.testing.assert_allclose(found.fault.values()["amount"], 0.99, rtol=1e-3)
    for recording in (moving("a", 0.99), moving("b", 0.99)):
        np.testing.assert_allclose(found.repair(recording).t, T, atol=0.01)


def test_one_recording_or_two_that_disagree_show_a_velocity_filter() -> None:
    assert find_stamps([moving("a", 0.99)]) == ()
    assert find_stamps([moving("a", 0.99), moving("b", 1.0)]) == ()


def test_stamps_that_jitter_by_half_a_period_are_those_of_an_even_clock() -> None:
    noise = 0.5 * np.random.default_rng(0).standard_normal(len(T)) / 250
    least = 4e-5 * np.arange(len(T))  # stamps keep their order
    stamps = np.maximum.accumulate(T + noise - least) + least
    recording = moving("a", 1.0, stamps)
    (found,) = find_stamps([recording])
    assert found.variant == "jitter"
    np.testing.assert_allclose(found.repair(recording).t, T, atol=1e-3)


@pytest.mark.parametrize(
    "note",
    [
        "rows left out in which a position stands still and then leaps: 249 (8.30%), q1",
        "rows without values left out as pauses: 249 of 3000 in 1 block: line 1001",
        "rows left out that cannot be read: 249 of 3000 (8.30%): line 1001",
    ],
)
def test_rows_that_were_left_out_on_reading_are_not_lost(note: str) -> None:
    kept = (T < 4.0) | (T >= 4.9)
    left_out = moving("a", 1.0).part(kept)
    assert lost(left_out) > 0.07
    assert lost(left_out.part(slice(None), notes=(note,))) < 0.001
