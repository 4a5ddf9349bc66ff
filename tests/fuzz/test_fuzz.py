"""A short run of the fuzzing of every reader; ``experiments/48_fuzz.py`` makes the long one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fuzz_run import Outcome, Watch, judge, kinds, run
from fuzz_targets import targets
from sweeps import nightly

SLOW = {"rosbag2_metadata", "agent_json", "agent_npz", "agent_zip"}
"""Readers that take some 10 ms an input, or load the learning libraries."""


@pytest.mark.parametrize("name", [name for name in targets() if name not in SLOW])
@pytest.mark.parametrize("inputs", [range(15), nightly(range(15, 120))])
def test_mutated_inputs_are_read_or_refused_with_a_reason(
    name: str, inputs: range, tmp_path: Path
) -> None:
    outcome = run(targets()[name], inputs, tmp_path / "work", bounded=False)
    assert kinds(outcome.faults) == {}
    assert outcome.read + outcome.refused == len(inputs)
    assert outcome.refused > 0 or name == "serve_address"


ONE_COLUMN = re.compile("^([^,]*,[^,]*).*$", re.MULTILINE)
RARE = {
    "inspect_csv": lambda text: ONE_COLUMN.sub(r"\1", text).replace("q1", "x"),
    "audit_urdf": lambda text: re.sub("(?s)<inertial>.*?</inertial>", "", text),
}
"""One column alone, which is no arm of two joints; links without mass, one of them the last."""


@pytest.mark.parametrize("name", RARE)
def test_so_is_what_chance_seldom_makes(name: str, tmp_path: Path) -> None:
    target, outcome = targets()[name], Outcome()
    target.fill(tmp_path)
    file = tmp_path / target.file
    file.write_text(RARE[name](file.read_text()))
    judge(target, 0, tmp_path, Watch(tmp_path), outcome)
    assert kinds(outcome.faults) == {}
