"""Known payloads in a case: read, refused with the field at fault, written and read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gapscope.arm.case import case_files, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.io.write_case import write_case, write_recording
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.recording import Recording

BODY = {"mass": 2.0, "com": [0.0, 0.0, 0.05]}
LOAD = KnownLoad(2.0, (0.0, 0.0, 0.05))


@pytest.fixture
def folder(tmp_path: Path, urdf: Path, recording: Recording) -> Path:
    """A folder with a URDF and three recordings, but no case file yet."""
    (tmp_path / "more").mkdir()
    for factor, name in enumerate(("a.csv", "b.csv", "more/c.npz"), start=1):
        other = replace(recording, q=factor * recording.q / 3)
        write_recording(other, tmp_path / name)
    return tmp_path


def write(folder: Path, payloads: Any, **content: Any) -> None:
    """The case file of a folder."""
    full = {
        "name": "two",
        "robot": "robot.urdf",
        "recordings": ["a.csv", "b.csv"],
        "judge": ["more/c.npz"],
    }
    (folder / "case.yaml").write_text(
        yaml.safe_dump(full | {"payloads": payloads} | content)
    )


def test_recordings_carry_what_the_case_says(folder: Path) -> None:
    write(folder, {"b.csv": BODY, "more/c.npz": BODY | {"mass": 0}})
    case = load_case(folder)
    assert [r.payload for r in case.recordings] == [None, LOAD]
    assert case.judged[0].payload == KnownLoad(0.0, LOAD.com)
    assert (
        case.payload_of(folder / "more" / ".." / "b.csv") == LOAD
        and case.payload_of(folder / "a.csv") is None
    )
    assert load_case(folder, read_recordings=False).payloads == case.payloads
    assert set(case_files(folder)) >= {folder / "b.csv"}


def test_every_part_of_a_recording_carries_it(folder: Path) -> None:
    write(
        folder,
        {"b.csv": BODY},
        **{"import": {"rows": {"fit": [[0, 120]], "judge": [60, 199]}}},
    )
    case = load_case(folder)
    assert [r.payload for r in case.recordings] == [None, LOAD]
    assert [r.payload for r in case.judged] == [None, LOAD, None]


@pytest.mark.parametrize("payloads", [None, {}])
def test_an_empty_section_is_none(payloads: Any, folder: Path) -> None:
    write(folder, payloads)
    assert all(r.payload is None for r in load_case(folder).recordings)


def test_files_side_by_side_may_be_named_by_any_of_them(folder: Path) -> None:
    importing = {
        "join": "row",
        "q": {"file": "motion", "column": "q{j}"},
        "tau": {"file": "force", "column": "tau{j}"},
    }
    entry = {"motion": "a.csv", "force": "b.csv"}
    for name in entry.values():
        write(
            folder, {name: BODY}, recordings=[entry], judge=[], **{"import": importing}
        )
        assert load_case(folder).recordings[0].payload == LOAD


BAD: list[tuple[Any, str]] = [
    (
        {"b.cvs": BODY},
        "field payloads: no recording is called 'b.cvs'\n  remedy: did you mean b.csv?",
    ),
    (
        {"xyz": BODY},
        "no recording is called 'xyz'\n  remedy: name one of recordings: or judge:, a.csv, b.csv, more/c",
    ),
    (
        {"b.csv": BODY | {"mass": -2}},
        "field payloads.b.csv.mass: expected a number of at least 0, got -2",
    ),
    (
        {"b.csv": BODY | {"mass": float("inf")}},
        "field payloads.b.csv, mass: a payload of inf kg is none",
    ),
    (
        {"b.csv": BODY | {"mass": float("nan")}},
        "field payloads.b.csv, mass: a payload of nan kg is none",
    ),
    (
        {"b.csv": BODY | {"mass": "2 kg"}},
        "field payloads.b.csv.mass: expected a number, got '2 kg'",
    ),
    (
        {"b.csv": BODY | {"com": [0.0, 0.0]}},
        "field payloads.b.csv.com: expected at least 3 entries, got 2",
    ),
    (
        {"b.csv": BODY | {"com": [0, 0, float("nan")]}},
        "field payloads.b.csv, com: the centre of the payload needs",
    ),
    ({"b.csv": {"mass": 2.0}}, "field payloads.b.csv: lacks the key 'com'"),
    ({"b.csv": BODY | {"inertia": 1}}, "field payloads.b.csv: unknown key 'inertia'"),
    ({"b.csv": 2.0}, "field payloads.b.csv: expected a mapping (key: value), got 2.0"),
    (
        ["b.csv"],
        "field payloads: expected a mapping (key: value) or nothing, got ['b.csv']",
    ),
]


@pytest.mark.parametrize(
    ("payloads", "message"), BAD, ids=[message[:60] for _, message in BAD]
)
def test_refused(payloads: Any, message: str, folder: Path) -> None:
    write(folder, payloads)
    with pytest.raises(InputError) as caught:
        load_case(folder)
    assert message in str(caught.value) and f"{folder / 'case.yaml'}, " in str(
        caught.value
    )


def test_written_and_read_back(folder: Path) -> None:
    write(folder, {"b.csv": BODY, "more/c.npz": BODY})
    case = load_case(folder)
    again = load_case(write_case(case, folder / "again"))
    assert [r.payload for r in again.recordings] == [None, LOAD] and again.judged[
        0
    ].payload == LOAD
    plain = write_case(load_case(folder / "again"), folder / "third", ending="npz")
    assert list(yaml.safe_load(plain.read_text())["payloads"]) == ["b.npz", "c.npz"]


def test_a_case_without_any_is_written_without_the_section(folder: Path) -> None:
    write(folder, None)
    content = yaml.safe_load(
        write_case(load_case(folder), folder / "again").read_text()
    )
    assert "payloads" not in content


def test_parameters_of_a_point_mass() -> None:
    np.testing.assert_allclose(
        KnownLoad(2.0, (1.0, 2.0, 3.0)).parameters,
        [2, 2, 4, 6, 26, -4, 20, -6, -12, 10],
    )
