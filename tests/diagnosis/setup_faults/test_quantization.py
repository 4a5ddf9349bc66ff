"""Encoder steps read from positions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic

from gapscope.arm.case import Case, load_case
from gapscope.diagnosis.setup_faults.quantization import (
    encoder_step,
    find_quantization,
    lattice,
)


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


@pytest.mark.parametrize("digits", [6, 7])
@pytest.mark.parametrize("offset", [0.0, 0.01234])
@pytest.mark.parametrize("step", [2 * np.pi / 2**k for k in (9, 12, 16)])
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


def test_noise_after_rounding_is_no_lattice() -> None:
    rng = np.random.default_rng(0)
    q = np.round(np.sin(np.linspace(0, 9, 3000)) / 1e-3) * 1e-3
    assert lattice(q) is not None
    assert lattice(q + 1e-3 * rng.standard_normal(q.shape)) is None
    assert lattice(rng.standard_normal(3000)) is None
    assert lattice(np.zeros(3000)) is None


@pytest.mark.shared_data
def test_a_12_bit_servo_is_known_by_its_positions(data_root: Path) -> None:
    case = load_case(
        Path(__file__).parents[3] / "experiments" / "cases" / "so101.yaml",
        data_root=data_root,
    )
    (found,) = find_quantization(case)
    np.testing.assert_allclose(
        found.fault.values()["step"][:5], 2 * np.pi / 4096, rtol=1e-4
    )


@pytest.mark.shared_data
def test_sample_cases_keep_to_their_data_sheets(sample_cases: Path) -> None:
    for folder in sorted(sample_cases.glob("case*")):
        assert find_quantization(load_case(folder)) == ()
