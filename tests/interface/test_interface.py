"""The Python interface, as a script beside its own data would use it."""

from __future__ import annotations

import doctest
import importlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rubbing_arm import COULOMB, arrays, synthetic

import gapscope
from gapscope.arm.errors import InputError

Truth, arm = synthetic.Truth, synthetic.arm


def test_names_are_offered_and_imported_when_used():
    code = (
        "import gapscope, sys; loaded = set(sys.modules); "
        "assert not {m for m in loaded if m.startswith('gapscope.interface')}; "
        "assert set(gapscope.__all__) <= set(dir(gapscope)); "
        "[getattr(gapscope, name) for name in gapscope.__all__]"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with pytest.raises(AttributeError, match="diagnos_all"):
        _ = gapscope.diagnos_all


MODULES = [
    "arm.case",
    *(
        f"interface.{path.stem}"
        for path in (Path(gapscope.__file__).parent / "interface").glob("[a-z]*.py")
    ),
]


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_hold(name):
    failed, _ = doctest.testmod(importlib.import_module(f"gapscope.{name}"))
    assert failed == 0


@pytest.mark.parametrize("name", gapscope.__all__)
def test_every_name_has_an_example(name):
    thing = getattr(gapscope, name)
    text = (thing.__doc__ or "") + (getattr(thing, "from_arrays", thing).__doc__ or "")
    assert ">>>" in text


def test_a_data_sheet_beside_that_of_an_arm_or_case_is_refused(case):
    arm = gapscope.make_arm(case)
    assert gapscope.make_arm(arm) is arm is case.arm
    for robot in (case, arm):
        with pytest.raises(InputError, match=r"coulomb: .*has its own data sheet"):
            gapscope.make_arm(robot, coulomb=[1.0] * 3)


def test_diagnosis_from_arrays_names_the_friction(result):
    assert result.verdict == "effects_found"
    frame = result.to_frame()
    row = frame[frame["effect"] == "coulomb_friction"].set_index("joint").loc[2]
    assert row["value"] == pytest.approx(COULOMB[1], rel=0.05)
    assert "Coulomb friction" in result.summary()
    assert "<table" in result._repr_html_()


def test_saved_diagnosis_is_that_of_the_command(result, tmp_path):
    report, document, corrected = result.save(tmp_path / "out")
    content = json.loads(document.read_text(encoding="utf-8"))
    assert content["verdict"] == result.verdict
    assert set(content["made_from"]) == {"case_sha256", "program_sha256"}
    assert report.read_text(encoding="utf-8").lower().startswith("<!doctype html>")
    again = gapscope.read_corrected(corrected, arm())
    assert [e.name for e in again.effects] == [e.name for e in result.effects]


def test_what_an_earlier_comparison_corrected_does_not_stay(result, tmp_path):
    """What gapscope identify has left under the same names does."""
    identified = tmp_path / "identified_case.yaml"
    for corrects, stays in (("", True), (f"corrects: {identified.name}\n", False)):
        identified.touch()
        (tmp_path / "corrected.yaml").write_text(corrects)
        result.save(tmp_path)
        assert identified.exists() == stays


def test_case_in_memory_is_told_apart_from_another(case):
    from gapscope.provenance import made_from

    other = gapscope.Case.from_arrays(arm(), **arrays(Truth()), name="stiff")
    assert made_from(case) == made_from(case)
    assert made_from(case)["case_sha256"] != made_from(other)["case_sha256"]


def test_gap_prediction_and_replay_are_better_with_the_model(case, result, tmp_path):
    before, after = gapscope.gap(case), gapscope.gap(case, result.corrected)
    assert "torque NRMSE" in before.summary()
    worst = [found.to_frame()["torque_nrmse"].max() for found in (before, after)]
    assert worst[1] < 0.5 * worst[0]

    recorded = case.recordings[0].tau
    nominal, corrected = (
        gapscope.predict(case, 0, model) for model in (None, result.corrected)
    )
    errors = [np.abs(p.tau - recorded)[:, 1].mean() for p in (nominal, corrected)]
    assert errors[1] < 0.3 * errors[0]
    (file,) = corrected.save(tmp_path)
    assert list(pd.read_csv(file).columns) == ["t", "tau1", "tau2", "tau3"]

    still = gapscope.replay(case, 0).rmse
    assert gapscope.replay(case, 0, result.corrected).rmse[1] < still[1]


def test_identification_of_a_case_in_memory_and_the_first_screens(
    case, result, tmp_path
):
    found = gapscope.identify(case)
    names = {path.name for path in found.save(tmp_path)}
    assert {"report.html", "identification.json", "identified_case.yaml"} <= names
    assert gapscope.load_case(tmp_path / "identified_case.yaml").arm.n_joints == 3
    assert len(found.to_frame()) == found.identification.base.count
    assert "RMS residual" in found.summary()
    # a repr is the first screen
    assert result.summary().startswith(repr(result).splitlines()[0])
    for one in (result, gapscope.predict(case), found):
        lines = repr(one).splitlines()
        assert len(lines) <= 24 and max(map(len, lines)) <= 100
        assert "array(" not in repr(one)
    assert "print(result)" in repr(result) or len(result.summary().splitlines()) <= 24


def test_frames_make_the_same_case_as_arrays(case):
    frames = []
    for r in case.recordings:
        columns = {f"q{j + 1}": x for j, x in enumerate(r.q.T)}
        columns |= {f"tau{j + 1}": x for j, x in enumerate(r.tau.T)}
        frames.append(pd.DataFrame({"t": r.t, **columns}))
    other = gapscope.Case.from_frames(arm(), frames)
    for one, two in zip(case.recordings, other.recordings, strict=True):
        assert np.array_equal(one.q, two.q)
        assert np.array_equal(one.tau, two.tau)


BAD = {
    "q3": lambda t, q: {"q": q[:, :2]},
    "q: has shape": lambda t, q: {"q": q[:, 0]},
    "lasts": lambda t, q: {"t": t[:20], "q": q[:20]},
    "recording_1: its arrays differ in length: t ": lambda t, q: {"t": t[:-1]},
    "recording_1: has no rows": lambda t, q: {"t": t[:0], "q": q[:0]},
    "2 recordings": lambda t, q: {"q": [q, q]},
    "row 2, column q1: is not a finite number": lambda t, q: {
        "q": np.where(np.arange(len(t))[:, None] % 2, np.nan, q)
    },
}
"""What is said of arrays, and the arrays."""


@pytest.mark.parametrize("place", BAD)
def test_bad_arrays_are_refused_with_the_place(place, case):
    t, q = case.recordings[0].t, case.recordings[0].q
    with pytest.raises(InputError, match=place):
        gapscope.Case.from_arrays(arm(), **({"t": t, "q": q} | BAD[place](t, q)))


GAINS = {"kp": [1] * 3, "kd": [1] * 3}


@pytest.mark.parametrize(
    ("description", "place"),
    [
        ({"controller": {"kind": "foo", "rate": 9}}, r"field controller.kind: expected one of pd"),
        ({"controller": {"kp": [1] * 3}}, r"field controller: lacks the key 'rate'"),
        ({"controller": {"rate": 100, "kp": 1, "kd": [1] * 3}}, r"field controller.kp: expected a list"),
        ({"controller": {**GAINS, "rate": 9, "velocity_filter": 80}}, r"controller.velocity_filter"),
        ({"joints": ["joint_1"] * 2}, r"field joints: has an entry twice"),
        ({"chain": ["base"]}, r"field chain: expected at least 2"),
        ({"gravity": -9.81}, r"field gravity: expected a list"),
        ({"gravity": [0, 0, -np.inf]}, r"field gravity\[3\]: expected a number, got -inf"),
    ],
)  # fmt: skip
def test_descriptions_in_memory_are_checked_as_those_of_files(description, place, case):
    t, q = case.recordings[0].t, case.recordings[0].q
    with pytest.raises(InputError, match=place):
        gapscope.Case.from_arrays(arm().urdf, t=t, q=q, **description)


def test_a_case_in_memory_is_checked(case):
    found = gapscope.check(case)
    assert found.document["case"] == "stiff"
    assert len(found.to_frame()) == len(found.document["remarks"])


@pytest.fixture(scope="module")
def written(case, tmp_path_factory):
    """The case as files."""
    from gapscope.arm.io.write_case import write_case

    file = write_case(case, tmp_path_factory.mktemp("written") / "case")
    return gapscope.load_case(file)


def test_a_recording_is_named_by_number_name_or_path(written, tmp_path, monkeypatch):
    name = written.recordings[0].name
    path = written.folder / name
    by_number = gapscope.predict(written, 0)
    for given in (name, path, str(path)):
        found = gapscope.predict(written, given)
        assert np.array_equal(found.tau, by_number.tau)
    with pytest.raises(InputError, match="no recording of that name") as caught:
        gapscope.predict(written, "other.csv")
    assert name in caught.value.remedy
    # the command takes a name of the case too
    from gapscope.commands.inputs import read_recording

    monkeypatch.chdir(tmp_path)
    for given in (Path(name), path):
        _, recording = read_recording(written.folder, given, every_row=True)
        assert np.array_equal(recording.q, written.recordings[0].q)
    with pytest.raises(InputError, match="no recording of that name"):
        read_recording(written.folder, Path("other.csv"))
    # another file of that name, in the current folder, is meant before the case's
    rows = path.read_text().splitlines(keepends=True)
    Path(name).write_text("".join(rows[: len(rows) // 2]))
    _, recording = read_recording(written.folder, Path(name), every_row=True)
    for given in (name, Path(name)):
        assert len(gapscope.predict(written, given).t) == len(recording.t)
    assert len(recording.t) == len(rows) // 2 - 1
    # in the case's folder a name is that of the recording as the case holds it
    monkeypatch.chdir(written.folder)
    held = written.each(lambda r: replace(r, q=0.5 * r.q))
    assert not np.array_equal(gapscope.predict(held, name).tau, by_number.tau)


def test_inspection_makes_a_case(written, tmp_path):
    log = written.folder / written.recordings[0].name
    found = gapscope.inspect(log, written.arm.urdf)
    assert set(found.to_frame()["channel"]) >= {"time", "q", "tau"}
    assert "columns" in found.summary()
    *_, file = found.save(tmp_path / "made")
    assert gapscope.load_case(file).arm.n_joints == 3
    with pytest.raises(InputError, match="is there already"):
        found.save(tmp_path / "made")
