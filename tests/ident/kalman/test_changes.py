"""A load picked up in the middle of a recording is told by ``identify``, and none is where there was none."""

import numpy as np
import pytest
from cases import changed_during

from gapscope.arm.case import Case
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import Identification, identify
from gapscope.ident.output.identification_json import check, document, plain

LOAD = AppliedEffect("payload", (), {"mass": 1.5, "com": [0.0, 0.02, 0.08]})
MOMENT = 3.7


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    later = {"recording_1": (MOMENT, (LOAD,))}
    names = [f"recording_{i}" for i in range(3)]
    return changed_during("picked_up", tmp_path_factory.mktemp("case"), later, *names)


@pytest.mark.nightly
def test_a_load_that_is_picked_up_is_told_with_moment_and_mass(case: Case) -> None:
    result = identify(case)
    (found,) = result.changes
    assert found.recording == "recording_1" and found.term.is_load
    assert abs(found.time - MOMENT) < 0.1
    assert abs(found.value[0] - 1.5) < 0.15
    assert any("picked up at 3.7" in warning for warning in result.warnings)
    content = plain(document(result))
    check(content)
    (change,) = content["changes"]
    assert change["what"] == "payload" and change["parameters"][0] == "mass"
    assert abs(change["size"][0] - 1.5) < 0.15
    # the filter is told, and follows the arm from one load to the other
    (moved,) = result.filtered.moved
    track, (before, after) = result.filtered.followed.track, _sides(result, MOMENT)
    plainest = int(np.abs(moved / track.deviation[before]).argmax())
    change = track.value[after, plainest] - track.value[before, plainest]
    assert change == pytest.approx(moved[plainest], rel=0.3)


def _sides(result: Identification, moment: float) -> tuple[int, int]:
    """The last stretch before a moment of the recording with the change, and the last of that recording."""
    review = result.filtered
    own = np.array(review.recordings) == "recording_1"
    return int(np.flatnonzero(own & (review.times < moment))[-1]), int(
        np.flatnonzero(own)[-1]
    )
