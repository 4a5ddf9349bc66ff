"""A real arm: the TX40's published log, fitted and judged as in the comparison with FIGAROH."""

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import load_case
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.ident.samples import Band

ROOT = Path(__file__).resolve().parents[2]
CUTOFF = 10.0
"""Cut-off of both sides [Hz]."""
MOST = 0.11
"""RMS residual over RMS torque, stacked over joints, all judged rows [1]; FIGAROH has 0.21, a plain fit 0.13."""


@pytest.mark.shared_data
@pytest.mark.slow
@pytest.mark.nightly
def test_rows_that_were_not_fitted_are_predicted_by_bodies_that_can_exist(data_root):
    case = load_case(
        ROOT / "experiments" / "cases" / "staubli_tx40.yaml", data_root=data_root
    )
    found = identify(case, IdentificationSettings(cutoff=CUTOFF, trim=False))
    band = Band(CUTOFF, trim=False)
    (judged,) = band.segments(case.judged)
    torque = band.filtered(np.asarray(judged.torque), judged)
    left = torque - band.filtered(found.predict(judged.motion), judged)
    assert np.sqrt((left**2).sum() / (torque**2).sum()) <= MOST
    assert all(check.consistent for check in found.physical.after)
