"""Torque in another unit is refused or said with its factor; healthy arms and arms full of friction are let pass."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cases import each, panda_case
from sweeps import daily

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import InputError
from gapscope.ident.checks.fit_evidence import NominalSimilarity, nominal_similarity
from gapscope.ident.checks.torque_gain import torque_gain
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals.samples import Band, Samples
from gapscope.ident.signals.split import split
from gapscope.model.conditioning import position_cutoff

CUTOFF = IdentificationSettings(cutoff=20.0)
ROOT = Path(__file__).resolve().parents[3]


def scaled(factor: float) -> Case:
    return each(panda_case(), lambda r: replace(r, tau=factor * np.asarray(r.tau)))


@cache
def identified(factor: float) -> Identification:
    return identify(scaled(factor), replace(CUTOFF, any_torque=True))


def compared(case: Case) -> NominalSimilarity:
    fit, _ = split(case)
    band, columns = (
        Band(position_cutoff(tuple(fit))),
        ModelColumns(case.arm),
    )
    return nominal_similarity(Samples(columns, band.segments(fit), band))


@pytest.mark.parametrize("factor", [1 / 5, 9.81, 0.738])
def test_a_wrong_factor_is_quoted(factor: float) -> None:
    result = identified(factor)
    (warning,) = (w for w in result.warnings if "times the nominal arm's" in w)
    assert f"is {factor:.3g} times" in warning and "alike" in warning
    assert any(
        row.entry.key == "torque_gain" and row.verdict == "found"
        for row in result.table
    )


def test_the_unit_is_guessed() -> None:
    assert any("as if it were in lbf ft" in w for w in identified(0.738).warnings)


def test_large_factors_are_refused() -> None:
    with pytest.raises(InputError, match="9.81 times larger"):
        identify(scaled(9.81), CUTOFF)


def test_a_nominal_arm_that_is_off_by_more_than_the_torque_is_said_plainly() -> None:
    assert any("off by 400% of the recorded" in w for w in identified(1 / 5).warnings)


def test_silent_on_a_healthy_arm() -> None:
    assert not torque_gain(compared(panda_case())).found


@pytest.mark.shared_data
@pytest.mark.parametrize("number", daily(range(9), 0))
def test_silent_on_sample_cases(number: int, sample_cases: Path) -> None:
    """None of them has torque in another unit; one has scaled torque on some joints, one a payload."""
    case = load_case(sample_cases / f"case{number:03d}")
    assert not torque_gain(compared(case)).found


@pytest.mark.shared_data
def test_silent_on_an_arm_full_of_friction(data_root: Path) -> None:
    path = ROOT / "experiments" / "cases" / "staubli_tx40.yaml"
    assert not torque_gain(compared(load_case(path, data_root=data_root))).found
