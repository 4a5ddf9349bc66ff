"""The pull to the nominal arm: stronger ones are tried as long as they predict better."""

from __future__ import annotations

import pytest
from cases import panda_case

from gapscope.arm.case import Case
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.model.law_choice import PULLS, STRONGEST, Choice, choose
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals.samples import Band, Samples
from gapscope.ident.signals.split import split


def chosen(case: Case) -> tuple[Choice, list[float]]:
    fit, _ = split(case)
    band = Band(20.0)
    choice = choose(
        Samples(ModelColumns(case.arm), band.segments(fit), band),
        nonlinear=False,
        presliding=False,
    )
    return choice, [float(what.split("pull ")[1]) for what, _ in choice.tried[1:]]


def test_right_bodies_are_pulled_to_as_strongly_as_can_be() -> None:
    choice, tried = chosen(panda_case())
    assert max(tried) > max(PULLS)
    assert choice.pull in (max(tried), max(tried) / 10) and max(tried) <= STRONGEST


def test_wrong_bodies_are_not() -> None:
    choice, tried = chosen(
        panda_case(
            (AppliedEffect("payload", (), {"mass": 3.0, "com": [0.0, 0.0, 0.1]}),)
        )
    )
    assert tried == pytest.approx(PULLS)
    assert choice.pull < max(PULLS)
