"""The document of a diagnosis: what its schema accepts, what it rejects and with which words, and writing it."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import plain
from gapscope.diagnosis.document.diagnosis_json import validate, write_document

Change = Callable[[dict[str, Any]], Any]


@pytest.mark.parametrize(
    "make",
    [
        documents.two_effects,
        documents.no_gap,
        documents.unexplained,
        documents.changed,
        documents.one_possible,
    ],
)
def test_good_documents_are_accepted(make: Callable[[], dict[str, Any]]) -> None:
    validate(make())


def test_the_example_of_the_format_without_optional_keys_is_accepted() -> None:
    document = documents.two_effects()
    for key in (
        "arm",
        "recordings",
        "conditioning",
        "warnings",
        "where",
        "considered",
        "judged_on",
    ):
        del document[key]
    validate(document)


def test_unknown_keys_are_allowed_everywhere() -> None:
    document = documents.two_effects()
    for place in (
        document,
        document["gap"]["before"],
        document["effects"][0],
        document["unexplained"],
    ):
        place["note"] = {"anything": [1, None]}
    validate(document)


def test_unknown_values_are_null() -> None:
    document = documents.two_effects()
    document["gap"]["before"]["replay_rmse"] = None
    document["gap"]["after"]["torque_nrmse"] = [None] * 7
    document["effects"][0]["parameters"]["delay"]["std"] = None
    validate(document)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("today"), "field against: 'today' is a required property"),
        (lambda a: a.update(recordings=[]), "field against.recordings"),
        (
            lambda a: a["identified"].pop("coulomb"),
            "field against.identified: 'coulomb'",
        ),
        (lambda a: a["today"].pop("viscous"), "field against.today: 'viscous'"),
        (
            lambda a: a["held_out"].update(torque_nrmse=[-0.1]),
            "field against.held_out.torque_nrmse[0]",
        ),
        (
            lambda a: a["held_out"].update(rmse=[0.1]),
            "against.held_out.rmse: has 1 entries",
        ),
    ],
)
def test_broken_references_are_rejected(change: Change, message: str) -> None:
    document = documents.changed()
    change(document["against"])
    with pytest.raises(GapscopeError, match=re.escape(message)):
        validate(document)


BROKEN: dict[str, tuple[Change, str]] = {
    "schema": (lambda d: d.update(schema=2), "schema"),
    "verdict": (lambda d: d.update(verdict="fine"), "verdict"),
    "no case": (lambda d: d.pop("case"), "'case' is a required property"),
    "no next_recording": (
        lambda d: d.pop("next_recording"),
        "'next_recording' is a required property",
    ),
    "no possible": (
        lambda d: d.pop("possible"),
        "'possible' is a required property",
    ),
    "closed": (lambda d: d.update(closed=1.2), "field closed"),
    "possible without a share": (
        lambda d: d.update(possible=[{"effect": "payload"}]),
        "field possible[0]",
    ),
    "above the floor": (
        lambda d: d["unexplained"].update(above_floor=True),
        "unexplained.above_floor: is true, but the verdict is effects_found",
    ),
    "no floor": (lambda d: d["gap"]["before"].pop("floor"), "field gap.before"),
    "no probability": (
        lambda d: d["effects"][1].pop("probability"),
        "field effects[1]: 'probability'",
    ),
    "probability": (
        lambda d: d["effects"][0].update(probability=1.4),
        "field effects[0].probability: 1.4",
    ),
    "negative share": (
        lambda d: d["effects"][0].update(share=-0.1),
        "field effects[0].share",
    ),
    "joint zero": (
        lambda d: d["effects"][0].update(joints=[0, 5]),
        "field effects[0].joints[0]",
    ),
    "joint eight": (
        lambda d: d["effects"][0].update(joints=[4, 8]),
        "effects[0].joints: names joint 8",
    ),
    "text in gap": (
        lambda d: d["gap"]["after"]["torque_nrmse"].__setitem__(2, "low"),
        "gap.after.torque_nrmse[2]",
    ),
    "short gap": (
        lambda d: d["gap"]["after"]["torque_nrmse"].pop(),
        "gap.after.torque_nrmse: has 6 entries",
    ),
    "NaN": (
        lambda d: d["gap"]["after"]["torque_nrmse"].__setitem__(0, float("nan")),
        "torque_nrmse[0]: is not a finite",
    ),
    "short value": (
        lambda d: d["effects"][0]["parameters"]["delay"].update(value=[0.1]),
        "parameters.delay.value: is 1",
    ),
    "std": (
        lambda d: d["effects"][0]["parameters"]["delay"].update(std=0.1),
        "delay.std: does not have the shape",
    ),
    "no unit": (
        lambda d: d["effects"][0]["parameters"]["delay"].pop("unit"),
        "effects[0].parameters.delay",
    ),
    "found nothing": (
        lambda d: d.update(effects=[]),
        "verdict: is effects_found, but effects lists 0",
    ),
    "order": (lambda d: d["effects"].reverse(), "effects: are not ordered by share"),
    "role": (lambda d: d["recordings"][0].update(role="test"), "recordings[0].role"),
    "kind": (lambda d: d["where"][0].update(kind="mood"), "where[0].kind"),
    "reason": (lambda d: d["considered"][2].pop("reason"), "considered[2]"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_document_is_rejected_by_name_of_the_field(name: str) -> None:
    change, expected = BROKEN[name]
    document = copy.deepcopy(documents.two_effects())
    change(document)
    with pytest.raises(GapscopeError) as raised:
        validate(document)
    assert expected in raised.value.message


def test_no_gap_lists_no_effects() -> None:
    document = documents.two_effects() | {"verdict": "no_gap"}
    with pytest.raises(GapscopeError, match="no_gap, but effects lists 2"):
        validate(document)


def test_round_trip(tmp_path: Path) -> None:
    document = documents.two_effects() | {"case": "Zelle 4 – Übergabe"}
    write_document(document, tmp_path / "new" / "diagnosis.json")
    assert (
        json.loads((tmp_path / "new" / "diagnosis.json").read_text(encoding="utf-8"))
        == document
    )
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["diagnosis.json"]


def test_numpy_values_and_tuples_are_written_as_plain_ones(tmp_path: Path) -> None:
    document = documents.two_effects()
    document["gap"]["after"]["torque_nrmse"] = np.array(documents.AFTER)
    document["effects"][0]["joints"] = (np.int64(4), np.int64(5))
    write_document(document, tmp_path / "diagnosis.json")
    assert json.loads(
        (tmp_path / "diagnosis.json").read_text(encoding="utf-8")
    ) == plain(document)


def test_a_document_that_is_not_valid_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.json"
    write_document(documents.no_gap(), path)
    before = path.read_bytes()
    with pytest.raises(GapscopeError):
        write_document(documents.no_gap() | {"schema": 3}, path)
    assert path.read_bytes() == before


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GapscopeError, match="cannot be written"):
        write_document(documents.no_gap(), tmp_path / "file" / "diagnosis.json")
