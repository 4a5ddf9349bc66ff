"""Criteria by hand, and effects that can and cannot be separated."""

from __future__ import annotations

import numpy as np
import pytest
from cases import sines

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.candidate_model import ExcitationModel
from gapscope.ident.excitation.criteria import CRITERIA, condition_number, criterion
from gapscope.ident.excitation.separation import Signatures

MATRIX = np.array([[[3.0, 0.0]], [[0.0, 0.5]], [[4.0, 0.5]]])
"""Columns (3, 0, 4) and (0, 0.5, 0.5): norms 5 and sqrt(0.5), cosine 2 / (5 sqrt(0.5)) = 0.4 sqrt(2)."""


def test_condition_number_of_unit_columns_by_hand() -> None:
    cosine = 0.4 * np.sqrt(2)
    expected = np.sqrt((1 + cosine) / (1 - cosine))
    assert condition_number(MATRIX) == pytest.approx(expected)
    assert np.exp(CRITERIA["condition"].evaluate(MATRIX, np.ones(2))) == pytest.approx(
        expected
    )


def test_condition_number_does_not_depend_on_units() -> None:
    assert condition_number(MATRIX * np.array([1e-3, 1e4])) == pytest.approx(
        condition_number(MATRIX)
    )


def test_a_column_of_zeros_has_no_condition_number() -> None:
    assert condition_number(MATRIX * np.array([1.0, 0.0])) == np.inf


def test_d_and_e_by_hand() -> None:
    """W^T W / 3 with columns over (5, 1): [[25, 2], [2, 0.5]] / 3 scaled: determinant (0.5 - 0.16) / 9."""
    reference = np.array([5.0, 1.0])
    gram = np.array([[1.0, 0.4], [0.4, 0.5]]) / 3
    values = np.linalg.eigvalsh(gram)
    assert CRITERIA["d"].evaluate(MATRIX, reference) == pytest.approx(
        -0.25 * np.log((0.5 - 0.16) / 9)
    )
    assert CRITERIA["e"].evaluate(MATRIX, reference) == pytest.approx(
        -0.5 * np.log(values[0])
    )


@pytest.mark.parametrize("name", ["d", "e"])
def test_larger_motions_score_better_and_longer_ones_alike(name: str) -> None:
    reference, rate = np.ones(2), CRITERIA[name]
    assert rate.evaluate(2 * MATRIX, reference) == pytest.approx(
        rate.evaluate(MATRIX, reference) - np.log(2)
    )
    twice = np.concatenate([MATRIX, MATRIX])
    assert rate.evaluate(twice, reference) == pytest.approx(
        rate.evaluate(MATRIX, reference)
    )


def test_unknown_criterion_is_refused() -> None:
    with pytest.raises(InputError, match="condition"):
        criterion("conditon")


def to_and_fro(amplitude: float, n: int = 400) -> Motion:
    t = np.linspace(0.0, 10.0, n)
    w = 2 * np.pi * np.array([0.3, 0.4, 0.5])
    return sines(t, amplitude, w, np.arange(3))


def test_an_effect_is_as_far_from_its_likeness_as_the_load_varies(
    arm: NominalArm, body: RigidBody
) -> None:
    """Load friction is Coulomb friction under constant load: telling them apart takes a load that changes."""
    signatures = Signatures(arm, body, ("coulomb_friction", "load_friction"))
    model = ExcitationModel(arm, body)
    small, large = (
        signatures.separate(m, model.matrix(m))
        for m in (to_and_fro(0.01), to_and_fro(1.0))
    )
    assert 0 <= small.least < large.least <= 1
    pair = ("coulomb_friction", "load_friction")
    assert small.angle[pair] < large.angle[pair] <= np.pi / 2


def test_an_effect_that_base_parameters_explain_shows_nothing_of_its_own(
    arm: NominalArm, body: RigidBody
) -> None:
    motion, model = to_and_fro(1.0), ExcitationModel(arm, body)
    found = Signatures(arm, body, ("payload", "coulomb_friction")).separate(
        motion, model.matrix(motion)
    )
    assert found.least < 1e-6
    assert found.angle[("payload", "coulomb_friction")] == 0.0


@pytest.mark.parametrize(
    "names", [(), ("payload",), ("payload", "payload"), ("payload", "stiction")]
)
def test_effects_that_cannot_be_compared_are_refused(
    names: tuple[str, ...], arm: NominalArm, body: RigidBody
) -> None:
    with pytest.raises(InputError):
        Signatures(arm, body, names)
