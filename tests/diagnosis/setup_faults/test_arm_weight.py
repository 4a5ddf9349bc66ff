"""The share of the arm's weight that a torque carries, on an arm whose share is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic

from gapscope.arm.case import Case
from gapscope.arm.reading import Reading
from gapscope.diagnosis.setup_faults.arm_weight import weight_penalty, weight_share
from gapscope.diagnosis.setup_faults.fault_samples import sample
from gapscope.diagnosis.setup_faults.nuisance import FoldEquations, fold_equations
from gapscope.effects.setup_faults.torque_faults import GravityCompensatedTorque
from gapscope.model.conditioning import condition

AS_READ = Reading.identity(synthetic.N)


@pytest.fixture(scope="module")
def case() -> Case:
    return synthetic.case(seed=3)


def _equations(case: Case) -> FoldEquations:
    samples = sample([condition(r, 12.0) for r in case.recordings])
    return fold_equations(case.arm, synthetic.body(), samples, AS_READ)


def _scaled(case: Case, factor: float) -> Case:
    recordings = tuple(
        replace(r, tau=factor * np.asarray(r.tau)) for r in case.recordings
    )
    return replace(case, recordings=recordings)


@pytest.mark.parametrize("factor", [1.0, 0.1, 3.0])
def test_a_torque_times_a_factor_carries_that_share(case: Case, factor: float) -> None:
    equations = _equations(_scaled(case, factor))
    share, std = weight_share(equations, equations.read(AS_READ))
    assert share == pytest.approx(factor, rel=0.02) and 0.0 < std < 0.1
    penalty = weight_penalty(equations, equations.read(AS_READ), 1.0)
    # ln 0.1 in deviations of 0.35: half the square is 21.6; heavier arms pay nothing
    assert penalty == pytest.approx(21.6 if factor < 1 else 0.0, abs=1.5)


def test_a_torque_without_gravity_carries_none_until_it_is_read_as_such(
    case: Case,
) -> None:
    fault = GravityCompensatedTorque()
    equations = _equations(fault.in_case(case, np.random.default_rng(0), case.arm))
    share, _ = weight_share(equations, equations.read(AS_READ))
    assert share == pytest.approx(0.0, abs=0.03)
    right = equations.read(fault.reading(synthetic.N))
    assert weight_share(equations, right)[0] == pytest.approx(1.0, abs=0.03)
