"""The command audit: findings on the terminal, JSON, a page; exit code 0 whatever is found."""

from __future__ import annotations

import json
from pathlib import Path


def test_prints_the_worst_first_and_writes_nothing(gapscope, sick: Path) -> None:
    done = gapscope("audit", "kuka_iiwa")
    assert done.code == 0, done.err
    assert "7 moving joints" in done.out and "wrote" not in done.out
    assert done.out.index("missing: ") < done.out.index("note: ")


def test_takes_a_case_and_writes_page_and_document(
    gapscope, sick: Path, tmp_path: Path
) -> None:
    done = gapscope("audit", sick, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    content = json.loads((tmp_path / "out" / "audit.json").read_text())
    assert content["robot"] == "two" and content["total_mass"] == 8
    page = (tmp_path / "out" / "audit.html").read_text()
    assert "What is odd about two" in page and "https:" not in page


def test_prints_json_alone(gapscope, sick: Path) -> None:
    done = gapscope("audit", sick, "--json")
    assert json.loads(done.out)["schema"] == 1


def test_what_is_no_robot_ends_with_2(gapscope, tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text("<robot name='x'><link name='a'></robot>")
    done = gapscope("audit", path)
    assert done.code == 2 and "line 1" in done.err
    assert gapscope("audit", tmp_path / "nothing.urdf").code == 2
