"""What is offered in place of an unknown name."""

import pytest

from gapscope.arm.nearest_name import nearest

ROBOTS = ("kuka_iiwa", "franka_panda", "xarm6")


OFFERED = {
    "kuka_iwa": "kuka_iiwa",
    "KUKA_IIWA": "kuka_iiwa",
    " Franka Panda ": "franka_panda",
    "panda": "franka_panda",
    "iiwa": "kuka_iiwa",
    "my_xarm6_robot": "xarm6",
    **dict.fromkeys(["", "a", "ur5", "None"]),
}


@pytest.mark.parametrize("name", OFFERED)
def test_the_nearest_by_spelling_case_or_part_is_offered(name: str) -> None:
    offered = OFFERED[name]
    assert nearest(name, ROBOTS) == (f"did you mean {offered!r}? " if offered else "")
