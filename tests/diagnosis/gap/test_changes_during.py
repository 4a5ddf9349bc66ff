"""A load picked up in the middle of a recording is a finding with its moment; what follows is of the arm before."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import iiwa_of_three
from cases import changed_during
from sweeps import nightly

from gapscope.arm.case import Case, load_case
from gapscope.diagnosis.diagnose import SheetComparison, examine
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.gap.plausible_data import up_to_changes
from gapscope.effects.applied import AppliedEffect
from gapscope.model.changes import Change, change_findings, change_text, changes_of

REAL = Path(__file__).parents[3] / "experiments" / "cases"
MOMENT = {"load": 4.1, "friction": 4.4}
CHANGED = {
    "load": AppliedEffect("payload", (), {"mass": 1.5, "com": [0.0, 0.02, 0.08]}),
    "friction": AppliedEffect("coulomb_friction", (2,), {"torque": [2.0]}),
}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Three recordings: one in which a load is picked up, one in which friction rises, one without change."""
    later = {name: (MOMENT[name], (effect,)) for name, effect in CHANGED.items()}
    folder = tmp_path_factory.mktemp("case")
    names = ("healthy", "load", "friction")
    return changed_during("changes", folder, later, *names, arm=iiwa_of_three())


@pytest.fixture(scope="module")
def examined(case: Case) -> SheetComparison:
    return examine(case)


@pytest.fixture(scope="module")
def changes(examined: SheetComparison) -> tuple[Change, ...]:
    return examined.prepared.changes


def test_what_changed_is_found_with_its_moment_and_size(
    changes: tuple[Change, ...],
) -> None:
    found = {entry["recording"]: entry for entry in change_findings(changes)}
    assert set(found) == {"load", "friction"}
    for name, moment in MOMENT.items():
        assert found[name]["time"] == pytest.approx(moment, abs=0.05)
        low, high = found[name]["interval"]
        assert low <= moment <= high
    load, friction = found["load"], found["friction"]
    assert load["what"] == "payload" and load["joints"] == []
    assert load["parameters"]["mass"]["value"] == pytest.approx(1.5, abs=0.1)
    assert friction["what"] == "friction" and friction["joints"] == [2]
    assert friction["parameters"]["coulomb"]["value"] == pytest.approx(2.0, abs=0.4)
    assert "picked up at 4." in change_text(load)
    assert change_text(friction).startswith("friction of joint 2 changed at 4.")


def test_recordings_are_used_up_to_their_changes(
    case: Case, changes: tuple[Change, ...]
) -> None:
    cut = up_to_changes(case, changes)
    healthy, load, friction = cut.recordings
    assert healthy is case.recordings[0]
    assert load.t[-1] == pytest.approx(MOMENT["load"], abs=0.1)
    assert friction.t[-1] == pytest.approx(MOMENT["friction"], abs=0.1)
    assert "used up to 4." in load.notes[-1]


def test_the_longest_part_remains_if_all_change_at_once(
    case: Case, changes: tuple[Change, ...]
) -> None:
    (found,) = (f for f in changes if f.recording == "load")
    alone = replace(case, recordings=(case.recordings[1],))
    # of what may be before the change too little is left, or nothing
    for time, interval in ((1.5, (1.5, 1.5)), (3.5, (0.5, 4.0)), (3.5, (0.0, 4.0))):
        early = replace(found, time=time, interval=interval)
        (kept,) = up_to_changes(alone, (early,)).recordings
        assert kept.t[0] > time and kept.t[-1] == case.recordings[1].t[-1]


def test_a_diagnosis_names_the_changes_and_no_effect(
    examined: SheetComparison,
) -> None:
    found = examined.diagnosis()
    document = found.document
    validate(document)
    changes = {change["recording"]: change for change in document["changes"]}
    what = {name: change["what"] for name, change in changes.items()}
    assert what == {"load": "payload", "friction": "friction"}
    assert document["verdict"] == "effects_found" and document["effects"] == []
    # what is corrected has each from its moment on
    states = {
        name: [s for s in found.states if name in s.place.recordings]
        for name in ("healthy", *MOMENT)
    }
    assert [state.effects for state in states["healthy"]] == [()]
    before, after = states["load"]
    assert before.effects == () and after.place.start == changes["load"]["time"]
    (load,) = after.effects
    assert load.parameters["mass"] == pytest.approx(1.5, abs=0.1)
    before, after = states["friction"]
    (friction,) = after.effects
    assert before.effects == () and friction.joints == (2,)
    assert friction.parameters["torque"] == pytest.approx(2.0, abs=0.4)


def test_a_force_for_a_while_is_one(tmp_path: Path) -> None:
    """It is no load, spring or tilt that comes and goes."""
    force = np.array([-12.0, 9.0, 6.0])
    times = {"start": np.array(2.5), "end": np.array(4.7)}
    effect = AppliedEffect("external_force", (), {"force": force, **times})
    later, names = {"pushed": (2.0, (effect,))}, ("healthy", "pushed")
    case = changed_during("pushed", tmp_path, later, *names, arm=iiwa_of_three())
    begins, ends = changes_of(case.recordings, case.arm).during
    assert begins.term.effect == ends.term.effect == effect.name
    assert begins.interval[0] <= 2.5 <= begins.interval[1]
    assert ends.interval[0] <= 4.7 <= ends.interval[1]
    assert begins.value == pytest.approx(force, abs=2.0)
    assert ends.value == pytest.approx(-begins.value)
    entry, _ = change_findings((begins, ends))
    assert set(entry["parameters"]) == {"force"}
    assert "external force changed at 2." in change_text(entry)


@pytest.mark.parametrize(
    ("name", "joint", "moment", "factor"),
    [("emps", 1, 16.94, 1.3), nightly("ur10", 3, 10.4, 1.45)],
)
def test_a_constant_of_a_real_drive_changes_at_once(
    data_root: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    joint: int,
    moment: float,
    factor: float,
) -> None:
    """What a model leaves of a real arm lasts for a while, and is no ramp; one recording alone shows the change."""
    monkeypatch.setenv("GAPSCOPE_DATA", str(data_root))
    case = load_case(REAL / f"{name}.yaml")
    longest = max(case.recordings, key=lambda r: r.duration)
    tau = longest.tau.copy()
    tau[longest.t >= longest.t[0] + moment, joint - 1] *= factor
    (change,) = changes_of((replace(longest, tau=tau),), case.arm).during
    assert (change.term.effect, change.term.joint) == ("torque_scale", joint)
    assert change.until is None
    low, high = change.interval
    assert low <= moment <= high
    assert change.value[0] == pytest.approx(1 / factor - 1, rel=0.2)
