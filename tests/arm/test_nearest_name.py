"""What is offered in place of an unknown name."""

import pytest

from gapscope.arm.nearest_name import nearest

ROBOTS = ("kuka_iiwa", "franka_panda", "xarm6")


@pytest.mark.parametrize(
    ("name", "offered"),
    [
        ("kuka_iwa", "kuka_iiwa"),
        ("KUKA_IIWA", "kuka_iiwa"),
        (" Franka Panda ", "franka_panda"),
        ("panda", "franka_panda"),
        ("iiwa", "kuka_iiwa"),
        ("my_xarm6_robot", "xarm6"),
    ],
)
def test_the_nearest_by_spelling_case_or_part(name: str, offered: str) -> None:
    assert nearest(name, ROBOTS) == f"did you mean {offered!r}? "


@pytest.mark.parametrize("name", ["", "a", "ur5", "None"])
def test_nothing_is_offered_where_none_is_near(name: str) -> None:
    assert nearest(name, ROBOTS) == ""
