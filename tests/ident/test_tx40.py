"""A real arm: the TX40's published log, fitted and judged as its page states, in the comparison with FIGAROH."""

import re
from pathlib import Path

import pytest

from gapscope.arm.case import load_case
from gapscope.ident.identification import (
    IdentificationSettings,
    fit_parameters,
    validated,
)

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "identification.md"


@pytest.mark.shared_data
@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("cutoff", [10, 100])
def test_page_states_what_is_found(data_root: Path, cutoff: int) -> None:
    """Shares of the torque left on rows fitted, held out while moving, and held out, to the digit that is stated."""
    case = load_case(
        ROOT / "experiments" / "cases" / "staubli_tx40.yaml", data_root=data_root
    )
    settings = IdentificationSettings(cutoff=float(cutoff), trim=False)
    found = fit_parameters(case, settings)
    held_out = found.samples.of(found.held_out)
    fit, judged = (
        validated(found, found.physical.value, role, samples)
        for role, samples in (("fit", found.samples), ("judge", held_out))
    )
    page = PAGE.read_text(encoding="utf-8")
    row = re.search(rf"^\| {cutoff} Hz.*?^\| \| `gapscope identify` .*?$", page, re.M | re.S)  # fmt: skip
    stated = [float(x) for x in re.findall(r"\*\*([\d.]+) %\*\*", row[0])]
    shares = (fit.every.overall, judged.moving.overall, judged.every.overall)
    assert [100 * x for x in shares] == pytest.approx(stated, abs=0.051)
    if cutoff == 10:
        joint = re.search(r"against ([\d.]+) %; all rows [\d.]+ against ([\d.]+) %", page)  # fmt: skip
        five = [100 * own.relative[4] for own in (judged.moving, judged.every)]
        assert five == pytest.approx([float(x) for x in joint.groups()], abs=0.051)
    assert all(check.consistent for check in found.physical.after)
