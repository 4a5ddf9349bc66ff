"""The mystery arm of the demo."""

import numpy as np
import pytest

from gapscope.effects.catalogue import CATALOGUE
from gapscope.envs import mystery_arm as mystery


@pytest.fixture(scope="module")
def short(request: pytest.FixtureRequest):
    """The mystery arm with recordings of 3 s, built twice from one seed."""
    patch = pytest.MonkeyPatch()
    patch.setattr(mystery, "DURATION", 3.0)
    request.addfinalizer(patch.undo)
    return [mystery.mystery_arm(np.random.default_rng(11)) for _ in range(2)]


def test_case_and_truth(short) -> None:
    case, truth = short[0]
    assert (
        len(case.recordings) == 4
        and case.controller is not None
        and case.controller.feedforward == "nominal"
    )
    assert 1 <= len(truth) <= 2 and all(effect.name in CATALOGUE for effect in truth)
    for recording in case.recordings:
        assert recording.rate == pytest.approx(
            250.0
        ) and recording.duration == pytest.approx(3.0)
        assert np.abs(recording.q - recording.q_ref).max() < 0.3
        assert recording.name[:-1] == "recording_" and recording.notes == ()
    assert case.name == "mystery" and case.warnings == ()


def test_same_seed_same_arm(short) -> None:
    (first, truth), (second, again) = short
    assert [effect.name for effect in truth] == [effect.name for effect in again]
    for a, b in zip(first.recordings, second.recordings, strict=True):
        np.testing.assert_array_equal(a.tau, b.tau)
        np.testing.assert_array_equal(a.q, b.q)
