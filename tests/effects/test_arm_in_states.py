"""Effects that an arm has in some recordings, or spans of them: the file says where, and torque follows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import iiwa_of_three

import gapscope
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import (
    read_corrected,
    read_corrected_arm,
    write_corrected,
)

COMMON = "{effect: coulomb_friction, joints: [2], parameters: {torque: [4.0]}}"
LOAD = "{effect: payload, parameters: {mass: %s, com: [0, 0, 0.1]}, %s}"
FILE = f"""schema: 1
case: tools
effects:
  - {COMMON}
  - {LOAD % (2.0, "recordings: [a.csv]")}
  - {LOAD % (1.0, "recordings: [b.csv], from: 3.0")}
recordings: [a.csv, b.csv]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "corrected.yaml"
    path.write_text(FILE, encoding="utf-8")
    return path


def moving(name: str) -> Recording:
    t = np.arange(0.0, 6.0, 0.01)
    return Recording(name, t, 0.5 * np.sin(np.outer(t, [1.0, 0.8, 1.3])))


def masses(corrected: CorrectedArm, name: str) -> list[tuple[float, float]]:
    """Mass of the load in each span of a recording of 6 s, and since when."""
    t = np.arange(0.0, 6.0, 0.01)
    out = []
    for inside, arm in corrected.spans(name, t):
        loads = [e.parameters["mass"] for e in arm.effects if e.name == "payload"]
        out.append((float(t[inside][0]), float(sum(loads))))
    return out


def test_each_recording_has_its_state_and_an_unknown_one_the_last(file: Path) -> None:
    corrected = read_corrected_arm(iiwa_of_three(), file)
    assert masses(corrected, "a.csv") == [(0.0, 2.0)]
    assert masses(corrected, "b.csv") == [(0.0, 0.0), (3.0, 1.0)]
    assert masses(corrected, "c.csv") == [(0.0, 1.0)]
    # what takes no recording, a simulator, has the last state
    assert [e.name for e in read_corrected(file)] == ["coulomb_friction", "payload"]


def test_what_is_written_is_read_again(file: Path) -> None:
    corrected = read_corrected_arm(iiwa_of_three(), file)
    other = file.with_name("other.yaml")
    write_corrected("tools", corrected.effects, other, states=corrected.states)
    again = read_corrected_arm(iiwa_of_three(), other)
    for name in ("a.csv", "b.csv", "c.csv"):
        assert masses(again, name) == masses(corrected, name)
    assert other.read_text(encoding="utf-8").count("coulomb_friction") == 1


def test_predicted_torque_has_the_load_where_it_is(file: Path) -> None:
    arm = iiwa_of_three()
    with pytest.warns(ModelWarning, match=r"c\.csv: its state is not known"):
        last = gapscope.predict(arm, moving("c.csv"), file).tau
    without = gapscope.predict(
        arm, moving("b.csv"), read_corrected_arm(arm, file).effects[:1]
    ).tau
    b = gapscope.predict(arm, moving("b.csv"), file).tau
    before = moving("b.csv").t < 3.0
    assert b[before] == pytest.approx(without[before])
    assert b[~before] == pytest.approx(last[~before])
    assert np.abs(last - without).max() > 0.5


@pytest.mark.parametrize(
    ("place", "problem"),
    [
        ("recordings: b.csv", "say where an effect holds"),
        ("from: 3", "say where an effect holds"),
        ("recordings: [b.csv], to: soon", "say where an effect holds"),
        ("recordings: [b.csv], from: 3, to: 2", "which is no time"),
    ],
)
def test_a_wrong_place_is_told_with_its_entry(
    file: Path, place: str, problem: str
) -> None:
    file.write_text(f"schema: 1\neffects:\n  - {LOAD % (1.0, place)}\n", "utf-8")
    with pytest.raises(InputError, match=problem) as told:
        read_corrected(file)
    assert told.value.where == "effects[0]"


def test_an_effect_may_not_hold_twice_at_a_place(file: Path) -> None:
    twice = COMMON.replace("}}", "}, recordings: [a.csv]}")
    file.write_text(
        f"schema: 1\neffects:\n  - {COMMON}\n  - {twice}\n", encoding="utf-8"
    )
    with pytest.raises(InputError, match="occurs twice on joint 2"):
        read_corrected_arm(iiwa_of_three(), file)
