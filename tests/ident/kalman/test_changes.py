"""A load picked up in the middle of a recording is told by ``identify``, and none is where there was none."""

import pytest
from cases import changed_during

from gapscope.arm.case import Case
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import identify
from gapscope.ident.output.identification_json import check, document, plain

LOAD = AppliedEffect("payload", (), {"mass": 1.5, "com": [0.0, 0.02, 0.08]})
MOMENT = 3.7


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    later = {"recording_1": (MOMENT, (LOAD,))}
    names = [f"recording_{i}" for i in range(3)]
    return changed_during("picked_up", tmp_path_factory.mktemp("case"), later, *names)


def test_a_load_that_is_picked_up_is_told_with_moment_and_mass(case: Case) -> None:
    result = identify(case)
    (found,) = result.changes
    assert (
        found.recording == "recording_1" and found.change.hypothesis.name == "payload"
    )
    assert abs(found.change.time - MOMENT) < 0.1
    assert abs(found.change.size[0] - 1.5) < 0.15
    assert any(
        "a load was picked up at 3.7" in warning and "recording_1" in warning
        for warning in result.warnings
    )
    content = plain(document(result))
    check(content)
    assert content["changes"][0]["parameters"] == ["m7", "mx7", "my7", "mz7"]
