"""Cases: read, refused with the field at fault, written and read back."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gapscope.arm.case import Case, case_files, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.io.write_case import write_case, write_recording
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.commands.inputs import read_recording

CONTENT: dict[str, Any] = {
    "name": "two",
    "robot": "robot.urdf",
    "recordings": ["a.csv"],
}


@pytest.fixture
def recording(recording: Recording) -> Recording:
    """Slower, so that each half is long enough for a case."""
    return replace(recording, t=2 * recording.t)


@pytest.fixture
def folder(tmp_path: Path, urdf: Path, recording: Recording) -> Path:
    """A folder with a URDF and three recordings, but no case file yet."""
    write_recording(recording, tmp_path / "a.csv")
    write_recording(replace(recording, tau=-recording.tau), tmp_path / "b.npz")
    (tmp_path / "more").mkdir()
    write_recording(replace(recording, q=recording.q / 2), tmp_path / "more" / "c.npz")
    return tmp_path


def write(folder: Path, **content: Any) -> Path:
    """The case file of a folder."""
    path = folder / "case.yaml"
    path.write_text(yaml.safe_dump(CONTENT | content))
    return path


def loaded(folder: Path, **content: Any) -> Case:
    return load_case(write(folder, **content))


def names_of(recordings: Iterable[Recording]) -> list[str]:
    return [recording.name for recording in recordings]


def test_the_least_case(folder: Path) -> None:
    case = loaded(folder)
    assert case.name == case.arm.name == "two"
    assert case.arm.joints == ("shoulder", "elbow")
    assert names_of(case.recordings) == ["a.csv"]
    assert (case.judged, case.controller) == ((), None)
    assert (case.warnings, case.importing) == ((), None)
    np.testing.assert_array_equal(case.arm.viscous, [0.5, 0.1])
    np.testing.assert_array_equal(case.arm.coulomb, [0.25, 0])


def test_recordings_of_one_name_are_told_by_their_folders(folder: Path) -> None:
    one, other = "morning run/a.csv", "Prüfstand/a.csv"
    for name in (one, other):
        (folder / name).parent.mkdir()
        shutil.copy(folder / "a.csv", folder / name)
    for names in ([one, other, "b.npz"], [one, "a.csv"]):
        assert names_of(loaded(folder, recordings=names).recordings) == names
    # the commands know them by the same names, from any folder
    for given in (Path(one), folder / one):
        assert read_recording(folder, given)[1].name == one


CONTROLLER = {"rate": 1000, "kp": [1, 2], "kd": [3, 4]}
CONTROLLER |= {"kind": "pd", "velocity_filter": {"cutoff": 80}}


def test_a_full_case(folder: Path) -> None:
    sheet = {"armature": [1, 2], "viscous": [3, 4], "torque_limit": [5, 6]}
    sheet |= {"encoder": "joint", "encoder_step": 1e-3}
    arm = {"joints": ["elbow", "shoulder"], "gravity": [0, 0, 1], "nominal": sheet}
    path = write(folder, **arm, controller=CONTROLLER, judge=["b.npz"])
    # a number without a decimal point is text to YAML
    path.write_text(path.read_text().replace("0.001", "1e-3"))
    case = load_case(path)
    assert case.arm.joints == ("elbow", "shoulder")
    assert (case.arm.encoder, case.arm.encoder_step) == ("joint", 1e-3)
    np.testing.assert_array_equal(case.arm.viscous, [3, 4])
    np.testing.assert_array_equal(case.arm.coulomb, [0, 0.25])
    assert case.controller.feedforward == "none"
    assert case.controller.velocity_cutoff == 80
    assert names_of(case.judged) == ["b.npz"]
    assert load_case(path, read_recordings=False).recordings == ()


OVERLAP = r"held out and is fitted(.|\n)*overlap"
HELD_OUT = [
    ({"judge": ["a.csv"]}, r"judge(.|\n)*a.csv.*fitted.*a\.csv"),
    ({"judge": ["c.csv"]}, r"judge(.|\n)*c.csv.*fitted.*a\.csv"),
    ({"import": {"rows": {"fit": [0, 109], "judge": [90, 199]}}}, OVERLAP),
    ({"import": {"rows": {"fit": [0, 109]}}, "judge": ["a.csv"]}, OVERLAP),
]
"""Recordings and rows that are fitted, too; ``c.csv`` is a copy under another name, with other dates."""


@pytest.mark.parametrize(("content", "message"), HELD_OUT)
def test_what_is_fitted_is_not_held_out_too(
    content: dict[str, Any], message: str, folder: Path, recording: Recording
) -> None:
    write_recording(replace(recording, t=recording.t + 5), folder / "c.csv")
    with pytest.raises(InputError, match=message):
        loaded(folder, **content)


def test_rows_to_fit_and_to_judge(folder: Path) -> None:
    rows = {"fit": [[0, 95], [5, 100]], "judge": [100, 199]}
    case = loaded(folder, **{"import": {"rows": rows}})
    found = [(r.name, len(r.t)) for r in case.recordings]
    assert found == [("a.csv rows 0-95", 96), ("a.csv rows 5-100", 96)]
    assert case.judged[0].t[0] == 2.0 and len(case.judged[0].t) == 100


BODY = {"mass": 2.0, "com": [0.0, 0.0, 0.05]}
LOAD = KnownLoad(2.0, (0.0, 0.0, 0.05))
INFINITE, NONE = float("inf"), float("nan")
LOADS: list[tuple[Any, str]] = [
    ({"a.cvs": BODY}, ": no recording is called 'a.cvs'\n  remedy: did you mean 'a.csv'?"),
    ({"xyz": BODY}, ": no recording is called 'xyz'\n  remedy: name one of recordings: or judge:, a.csv"),
    ({"a.csv": BODY | {"mass": -2}}, ".a.csv.mass: expected a number of at least 0, got -2"),
    ({"a.csv": BODY | {"com": [0.0, 0.0]}}, ".a.csv.com: expected at least 3 entries, got 2"),
    ({"a.csv": BODY | {"com": [0, 0, NONE]}}, ".a.csv.com[3]: expected a number, got nan"),
    ({"a.csv": {"mass": 2.0}}, ".a.csv: lacks the key 'com'"),
    ({"a.csv": BODY | {"inertia": 1}}, ".a.csv: unknown key 'inertia'"),
    ({"a.csv": 2.0}, ".a.csv: expected a mapping (key: value), got 2.0"),
    (["a.csv"], ": expected a mapping (key: value) or nothing, got ['a.csv']"),
]  # fmt: skip
"""Known payloads."""
BAD: list[tuple[dict[str, Any], str]] = [
    *(({"payloads": loads}, f"field payloads{message}") for loads, message in LOADS),
    ({"recording": ["a.csv"]}, "case.yaml: unknown key 'recording'\n  remedy: did you mean 'recordings'?"),
    ({"recordings": "a.csv"}, "field recordings: expected a list, got 'a.csv'"),
    ({"recordings": []}, "field recordings: "),
    ({"recordings": ["absent.csv"]}, "absent.csv: no such file"),
    ({"name": 5}, "field name: expected a text, got 5"),
    ({"gravity": [0, 0]}, "field gravity: expected at least 3 entries, got 2"),
    ({"joints": ["shoulder", "wrist"]}, "{folder}/robot.urdf has no movable joint 'wrist'; it has shoulder, elbow"),
    ({"robot": "r2d2"}, "r2d2: no such URDF file\n  remedy: give a URDF, or one of the known robots kuka_iiwa"),
    ({"nominal": {"coulomb": [1]}}, "field nominal.coulomb: expected 2 numbers, one per joint, got 1"),
    ({"nominal": {"armature": [1, -1]}}, "field nominal.armature[2]: expected a number of at least 0, got -1"),
    ({"controller": {"rate": 1000, "kp": [1], "kd": [1, 1]}}, "field controller.kp: expected 2 entries"),
    ({"import": {"q": {"column": "p{j}", "unit": "grad"}}}, "field import.q.unit: expected one of rad, deg, rev"),
    ({"import": {"transmission": {"matrix": [[NONE, 0], [0, 1]]}}}, "matrix[1][1]: expected a number, got nan"),
    ({"import": {"mend": {"time": {"scale": NONE}}}}, "field import.mend.time.scale: expected a number, got nan"),
    ({"import": {"tau": {"sign_bit": 40}}}, "field import.tau.sign_bit: expected a number of at most 31, got 40"),
    ({"controller": CONTROLLER | {"rate": INFINITE}}, "field controller.rate: expected a number, got inf"),
    ({"locked": {"elbow": NONE}}, "field locked.elbow: expected a number, got nan"),
    ({"nominal": {"coupling": [{"motor": 1, "joint": 1}]}}, "nominal.coupling[1]: expected motor and joint, two diff"),
    ({"import": {"tau": "T{j}"}}, "a.csv: has no column T1; it has t, q1, q2"),
    ({"import": {"rows": {"fit": [0, 25]}}}, "a.csv: lasts 0.5 s (26 samples), expected at least 1 s"),
]  # fmt: skip


@pytest.mark.parametrize(("content", "message"), BAD, ids=lambda x: str(x)[:50])
def test_refused(content: dict[str, Any], message: str, folder: Path) -> None:
    with pytest.raises(InputError) as caught:
        loaded(folder, **content)
    assert message.format(folder=folder) in str(caught.value)


LOG = "t,q1\n" + "0.5,1.0\n" * 10_000
NO_CASES = [
    ("case.yaml", "name: [", "line 1, column 8: is not valid YAML"),
    ("case.yaml", "name: !!timestamp later", "is not valid YAML"),
    ("case.yaml", "name: a\nname: b\n", "line 2, column 1: is not valid YAML: key 'name' is given twice"),
    ("case.yaml", "", "expected a mapping (key: value), got None"),
    ("case.yaml", "- a\n", "expected a mapping"),
    ("metadata.yaml", "rosbag2_bagfile_information: {}", "is a log, and a case was expected"),
    ("recording.csv", LOG, "is a log"),
    ("recording.yaml", LOG, "expected a mapping"),
]  # fmt: skip
"""A file alone in a folder; the folder is given for a case where that has a case or a bag, or else the file."""


@pytest.mark.parametrize(("name", "text", "message"), NO_CASES)
def test_what_is_no_case_is_refused_and_not_printed_whole(
    name: str, text: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    given = tmp_path / name if name.startswith("recording") else tmp_path
    with pytest.raises(InputError) as caught:
        load_case(given)
    assert message in str(caught.value) and len(str(caught.value)) < 500


def test_unsigned_torque_is_a_warning(folder: Path, recording: Recording) -> None:
    tau = abs(recording.tau)
    tau[0] = 0
    write_recording(replace(recording, tau=tau), folder / "a.csv")
    said = "a.csv: torque is unsigned: only commands and positions can be trusted"
    assert loaded(folder).warnings == (said,)


def test_data_root(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(folder, recordings=["${GAPSCOPE_DATA}/a.csv"])
    monkeypatch.setenv("GAPSCOPE_DATA", str(tmp_path / "absent"))
    message = "field recordings: .* is replaced by .*absent, which is not a folder"
    with pytest.raises(InputError, match=message):
        load_case(path)
    assert len(load_case(path, data_root=folder).recordings) == 1
    monkeypatch.setenv("GAPSCOPE_DATA", str(folder))
    assert len(load_case(path).recordings) == 1


SHEET = ("joints", "gravity", "armature", "coulomb", "viscous", "torque_limit", "encoder", "encoder_step")  # fmt: skip


def same(one: Case, other: Case) -> None:
    """Everything but the names of files is equal."""
    channels = ("stamps", *CHANNELS)
    for attribute, names in (
        ("arm", SHEET),
        ("controller", vars(one.controller) if one.controller else ()),
        ("recordings", channels),
        ("judged", channels),
    ):
        parts = (np.atleast_1d(getattr(case, attribute)) for case in (one, other))
        for a, b in zip(*parts, strict=True):
            assert (a is None) == (b is None)
            for name in names:
                values = getattr(a, name), getattr(b, name)
                np.testing.assert_array_equal(*values, err_msg=name)


def test_write_case(folder: Path, tmp_path: Path) -> None:
    write(
        folder,
        nominal={"armature": [1, 1 / 3], "torque_limit": [5, 6], "encoder_step": 1e-5},
        controller=CONTROLLER,
        judge=["b.npz", "more/c.npz"],
        **{"import": {"rows": {"fit": [[0, 119], [60, 199]]}}},
    )
    case, made = load_case(folder), tmp_path / "deeper" / "made"
    assert write_case(case, made) == made / "case.yaml"
    logs = ["a_rows_0_119.csv", "a_rows_60_199.csv", "b.csv", "c.csv"]
    names = sorted(path.name for path in made.iterdir())
    assert names == [*logs, "case.yaml", "robot.urdf"]
    same(case, load_case(made))
    with pytest.raises(InputError, match="holds a case already"):
        write_case(case, made)
    write_case(load_case(made), made, overwrite=True)
    same(case, load_case(made))
    assert [path.name for path in made.parent.iterdir()] == ["made"]


def test_write_case_leaves_other_folders_alone(folder: Path) -> None:
    case = loaded(folder)
    # a folder of other files, and a file
    for place in (folder / "more", folder / "a.csv"):
        with pytest.raises(InputError, match="exists and is not a case"):
            write_case(case, place, overwrite=True)


@pytest.mark.parametrize("silent", [(True, True), (False, True)])
def test_recordings_without_torque_and_of_equal_names_are_read_back(
    silent: tuple[bool, bool], folder: Path
) -> None:
    case = loaded(folder)
    (one,) = case.recordings
    both = tuple(replace(one, tau=None) if none else one for none in silent)
    made = replace(case, recordings=both)
    same(made, load_case(write_case(made, folder / "made")))


# Known payloads.


TWO = {"recordings": ["a.csv", "b.npz"], "judge": ["more/c.npz"]}


def test_recordings_carry_what_the_case_says(folder: Path) -> None:
    case = loaded(
        folder, payloads={"b.npz": BODY, "more/c.npz": BODY | {"mass": 0}}, **TWO
    )
    assert [r.payload for r in case.recordings] == [None, LOAD]
    assert case.judged[0].payload == KnownLoad(0.0, LOAD.com)
    assert case.payload_of(folder / "more" / ".." / "b.npz") == LOAD
    assert case.payload_of(folder / "a.csv") is None
    assert load_case(folder, read_recordings=False).payloads == case.payloads
    assert set(case_files(folder)) >= {folder / "b.npz"}
    # every part of a recording carries it
    rows = {"rows": {"fit": [[0, 99]], "judge": [100, 199]}}
    case = loaded(folder, payloads={"b.npz": BODY}, **TWO, **{"import": rows})
    assert [r.payload for r in case.recordings] == [None, LOAD]
    assert [r.payload for r in case.judged] == [None, LOAD, None]


def test_files_side_by_side_may_be_named_by_any_of_them(folder: Path) -> None:
    entry, columns = {"q": "a.csv", "tau": "b.npz"}, {"join": "row"}
    columns |= {key: {"file": key, "column": f"{key}{{j}}"} for key in entry}
    for name in entry.values():
        more = {"recordings": [entry], "import": columns}
        case = loaded(folder, payloads={name: BODY}, **more)
        assert case.recordings[0].payload == LOAD


def test_payloads_are_written_and_read_back(folder: Path) -> None:
    write(folder, payloads={"b.npz": BODY, "more/c.npz": BODY}, **TWO)
    again = load_case(write_case(load_case(folder), folder / "again"))
    assert [r.payload for r in again.recordings] == [None, LOAD]
    assert again.judged[0].payload == LOAD
    plain = write_case(load_case(folder / "again"), folder / "third", ending="npz")
    assert list(yaml.safe_load(plain.read_text())["payloads"]) == ["b.npz", "c.npz"]
    # a case without any is written without the section
    write(folder, **TWO)
    bare = write_case(load_case(folder), folder / "bare")
    assert "payloads" not in yaml.safe_load(bare.read_text())
