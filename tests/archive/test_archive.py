"""Diagnoses below a folder: found at any depth, read again if they change, and put in order over time."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import documents
import pytest

from gapscope.arm.errors import InputError
from gapscope.many.archive import Archive, answer


def put(root: Path, folder: str, **changes: object) -> Path:
    """Write a diagnosis with some keys changed."""
    file = root / folder / "diagnosis.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps({**documents.two_effects(), **changes}))
    return file


def test_diagnoses_at_any_depth_the_latest_first(tmp_path):
    for folder in ("2026-01-05", "line/2026-03-05/x", "2026-02-05/y", ".2026-04-05"):
        put(tmp_path, folder)
    found = [entry.folder for entry in Archive(tmp_path).rows()]
    assert found == ["line/2026-03-05/x", "2026-02-05/y", "2026-01-05"]


def test_a_file_is_read_again_only_if_it_changes(tmp_path):
    archive = Archive(tmp_path)
    file = put(tmp_path, "2026-01-05")
    first = archive.rows()[0]
    assert archive.rows()[0] is first

    put(tmp_path, "2026-01-05", case="renamed")
    os.utime(file, ns=(1, 1))
    assert archive.rows()[0].case == "renamed"
    put(tmp_path, "2026-02-05", case="new")
    assert [entry.case for entry in archive.rows()] == ["new", "renamed"]
    file.unlink()
    assert [entry.case for entry in archive.rows()] == ["new"]


def test_without_a_date_in_a_name_it_is_that_of_the_file(tmp_path):
    os.utime(put(tmp_path, "x"), (1_700_000_000, 1_700_000_000))
    (entry,) = Archive(tmp_path).rows()
    assert not entry.dated and entry.date.timestamp() == 1_700_000_000


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('{"schema": 1, "case": "ha', "not valid JSON"),
        ("[]", "no diagnosis"),
        ('{"schema": 1}', "required"),
        ("[" * 100_000, "deep"),
    ],
)
def test_a_broken_file_is_an_entry_that_says_why(tmp_path, text, problem):
    put(tmp_path, "2026-01-05")
    put(tmp_path, "2026-02-05").write_text(text)
    broken, whole = Archive(tmp_path).rows()
    assert broken.verdict == "failed" and problem in broken.problem
    assert whole.verdict == "effects_found"


def test_a_document_of_another_version_is_an_entry_that_says_so(tmp_path):
    change = {"recording": "a", "what": "payload", "joints": [], "time": 3.7}
    change |= {"interval": [3.0, 4.0], "parameters": {}, "times_threshold": 9.0}
    put(tmp_path, "x", changes=[change])
    (entry,) = Archive(tmp_path).rows()
    assert entry.verdict == "failed" and "mass" in entry.problem

    change["parameters"] = {"mass": {"unit": "kg", "value": 1.5, "std": 0.01}}
    put(tmp_path, "x", changes=[change], case="again")
    (entry,) = Archive(tmp_path).rows()
    assert entry.changes == ("load of 1.500 ± 0.010 kg picked up at 3.70 s of a",)


def test_a_link_that_leaves_the_folder_is_not_read(tmp_path):
    secret = put(tmp_path / "outside", "x", case="secret")
    (tmp_path / "inside" / "y").mkdir(parents=True)
    (tmp_path / "inside" / "y" / "diagnosis.json").symlink_to(secret)
    (tmp_path / "inside" / "z").symlink_to(secret.parent)
    (entry,) = Archive(tmp_path / "inside").rows()
    assert entry.folder == "y" and "leaves" in entry.problem


def test_a_missing_folder_and_an_unknown_unit_are_refused(tmp_path):
    with pytest.raises(InputError, match="not a folder"):
        Archive(tmp_path / "none")
    with pytest.raises(InputError, match="known are case, folder"):
        Archive(tmp_path, "robot")


def test_the_history_of_a_unit_has_every_joint_and_says_where_an_effect_is_absent(
    tmp_path,
):
    delay, payload = documents.two_effects()["effects"]
    for month in (3, 1, 2):
        delay["parameters"]["delay"]["value"] = [0.001 * month, 0.002 * month]
        effects = [delay, payload] if month != 2 else [delay]
        put(tmp_path, f"2026-0{month}/arm", case="arm", effects=effects)
    put(tmp_path, "2026-01/other", case="other")

    page = answer(Archive(tmp_path), "/unit/arm").content.decode()
    titles = re.findall(r"<h2>(.*?)</h2>\s*<p[^>]*>(.*?)</p>", page)
    assert titles == [
        ("Actuator delay, joint 4", "Named in 3 of 3 diagnoses."),
        ("Actuator delay, joint 5", "Named in 3 of 3 diagnoses."),
        ("Payload, the whole arm", "Named in 2 of 3 diagnoses."),
    ]
    assert page.count("2026-02-01_00:00:00,0 V 1") == 1
    shown = [json.loads(y) for y in re.findall(r'"y":(\[.*?\])', page)]
    # in ms
    assert shown[0] == pytest.approx([1.0, 2.0, 3.0])
    assert shown[1] == pytest.approx([2.0, 4.0, 6.0])
    assert re.findall(r'"name":"com (.)"', page) == ["x", "y", "z"]
