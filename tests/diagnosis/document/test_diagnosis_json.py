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
from gapscope.diagnosis.document.findings import (
    GapStages,
    suggested_recording,
    with_faults,
    with_torques_turned,
)
from gapscope.diagnosis.document.wording import pulled_texts, verdict
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, TurnedBase
from gapscope.effects.setup_faults import SignFlip

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


# Faults of the set-up among the findings: shares of one whole, worked out by hand.


EFFECT = {"effect": "armature", "share": 0.5, "share_interval": [0.4, 0.6]}


def stages(recorded: float, repaired: float, corrected: float) -> GapStages:
    """Joint 1 has the gaps, joint 2 is at its floor."""
    floor = np.array([0.1, 0.1])
    gaps = (np.array([gap, 0.1]) for gap in (recorded, repaired, corrected))
    return GapStages(*gaps, floor)


def fault(only: float | None) -> FoundFault:
    gap = None if only is None else np.array([only, 0.1])
    return FoundFault(SignFlip((1,)), 0.99, gap_with_only_this=gap)


def test_without_faults_the_effects_share_the_whole() -> None:
    gap = stages(recorded=0.6, repaired=0.6, corrected=0.35)
    (effect,) = with_faults([EFFECT], (), gap)
    assert effect["share"] == pytest.approx(0.5)
    assert effect["share_interval"] == pytest.approx([0.4, 0.6])


def test_shares_add_up_to_what_is_closed() -> None:
    """Of 0.5 above the floor 0.4 are closed: effects with shares of 0.26 and 0.14 have twice as much."""
    gap = stages(recorded=0.6, repaired=0.6, corrected=0.2)
    small = {"effect": "torque_offset", "share": 0.14, "share_interval": [0.1, 0.2]}
    large = EFFECT | {"share": 0.26}
    first, second = with_faults([small, large], (), gap)
    assert gap.closed == pytest.approx(0.8)
    assert (first["share"], second["share"]) == pytest.approx((0.52, 0.28))


def test_a_joint_below_its_floor_pays_for_no_other() -> None:
    """0.2 of 0.4 above the floor is left on joint 1; joint 2, far below its floor, changes nothing."""
    gap = GapStages(
        recorded=np.array([0.5, 0.05]),
        repaired=np.array([0.5, 0.05]),
        corrected=np.array([0.3, 0.0]),
        floor=np.array([0.1, 0.1]),
    )
    assert gap.closed == pytest.approx(0.5)


def test_a_gap_that_grows_is_closed_by_nothing_and_none_is_not_closed() -> None:
    assert stages(recorded=0.5, repaired=0.5, corrected=0.7).closed == 0.0
    assert stages(recorded=0.1, repaired=0.1, corrected=0.05).closed is None


def test_a_fault_takes_its_part_of_the_whole_and_leaves_the_rest() -> None:
    """Of 1.0 above the floor a repair leaves 0.4: the fault has 0.6, an effect with half of the rest 0.2."""
    gap = stages(recorded=1.1, repaired=0.5, corrected=0.3)
    first, second = with_faults([EFFECT], (fault(only=0.5),), gap)
    assert (first["effect"], first["share"]) == ("sign_flip", pytest.approx(0.6))
    assert (second["effect"], second["share"]) == ("armature", pytest.approx(0.2))
    assert second["share_interval"] == pytest.approx([0.16, 0.24])
    assert first["gap_with_only_this"] == {"torque_nrmse": [0.5, 0.1]}


def test_a_fault_without_a_gap_of_its_own_has_no_share() -> None:
    gap = stages(recorded=1.1, repaired=1.1, corrected=0.1)
    first, second = with_faults([EFFECT], (fault(only=None),), gap)
    assert (first["effect"], second["share"]) == ("armature", 0.0)
    assert second["gap_without_this"] == {"torque_nrmse": [1.1, 0.1]}


def test_the_whole_is_what_is_closed_if_the_floor_is_estimated_too_high() -> None:
    gap = stages(recorded=0.12, repaired=0.12, corrected=0.02)
    assert gap.whole == pytest.approx(0.1)


def test_all_torques_turned_and_a_base_that_hangs_are_each_others_alternative() -> None:
    base = TurnedBase(np.pi, 0.0)
    turned = FoundFault(SignFlip((1, 2)), 0.9, others=((base, 0.1),))
    gap = stages(recorded=0.6, repaired=0.1, corrected=0.1)
    (flip,) = with_faults([], (turned,), gap)
    (other,) = flip["alternatives"]
    assert (other["effect"], other["probability"]) == ("base_tilt", 0.1)
    assert "friction" in other["separated_by"]

    def tilt(roll: float) -> dict[str, object]:
        angles = {"roll": {"value": roll}, "pitch": {"value": 0.1}}
        return {"effect": "base_tilt", "parameters": angles, "alternatives": []}

    (hung, tilted) = with_torques_turned([tilt(3.0), tilt(0.1)], 2)
    assert [o["effect"] for o in hung["alternatives"]] == ["sign_flip"]
    assert hung["alternatives"][0]["joints"] == [1, 2]
    assert tilted["alternatives"] == []


# The recording that is suggested: for what is unexplained, else for the likeliest open alternative, else none.


def finding(probability: float, alternative: str = "actuator_lag") -> dict[str, Any]:
    other = {
        "effect": alternative,
        "probability": probability,
        "separated_by": "a chirp above 10 Hz",
    }
    return {"effect": "actuator_delay", "alternatives": [other]}


def test_what_is_unexplained_comes_first_with_what_it_will_tell() -> None:
    text = suggested_recording("unexplained", [finding(0.4)], [], [2, 5])
    assert text is not None and "unexplained on joint 2, 5" in text
    assert "doubles with the speed" in text


def test_then_the_likeliest_alternative_with_its_probability() -> None:
    found = [finding(0.01), finding(0.05), finding(0.2, "elasticity"), finding(0.1)]
    text = suggested_recording("effects_found", found, [], [])
    assert text is not None and text.startswith(
        "to tell actuator delay from elasticity, which has a probability of 20 %: a chirp above 10 Hz"
    )


def test_nothing_in_its_place_is_an_alternative_too() -> None:
    text = suggested_recording("effects_found", [finding(0.3, "none")], [], [])
    assert text is not None and text.startswith("to tell actuator delay from nothing")


def test_a_case_that_is_misread_is_corrected_first() -> None:
    line = "say in the case gravity: [0.0, 9.81, 0.0]"
    text = suggested_recording("unexplained", [], [], [2], first=line)
    assert text == f"none yet: first {line}, and diagnose again"


def test_else_none() -> None:
    assert suggested_recording("effects_found", [finding(0.049)], [], []) is None
    assert suggested_recording("no_gap", [], [finding(0.4)], []) is None


def test_what_is_possible_is_settled_after_what_is_named() -> None:
    rare, likely = finding(0.01), finding(0.4, "none")
    text = suggested_recording("effects_found", [rare], [likely], [])
    assert text is not None and text.startswith("to tell actuator delay from nothing")
    first = suggested_recording("effects_found", [finding(0.2)], [likely], [])
    assert first is not None and "actuator lag" in first


def test_two_names_of_one_cause_ask_for_no_recording() -> None:
    named = finding(0.09, "link_inertia")
    named["alternatives"][0]["equivalent"] = True
    assert suggested_recording("effects_found", [named], [], []) is None


# The verdict as a truth table over all combinations of its three facts.


# found, unknown, rejected
TABLE = {
    (True, True, True): "unexplained",
    (True, True, False): "unexplained",
    (True, False, True): "effects_found",
    (True, False, False): "effects_found",
    (False, True, True): "unexplained",
    (False, True, False): "unexplained",
    (False, False, True): "unexplained",
    (False, False, False): "no_gap",
}


@pytest.mark.parametrize(("facts", "expected"), TABLE.items())
def test_verdict(facts: tuple[bool, bool, bool], expected: str) -> None:
    found, unknown, rejected = facts
    assert verdict(found=found, unknown=unknown, rejected=rejected) == expected


# Findings in words: values that the noise of the encoders pulled.


def rotor(
    value: list[float], std: list[float], by_commands: list[float]
) -> dict[str, Any]:
    inertia = {"unit": "kg m^2", "value": value, "std": std, "by_commands": by_commands}
    return {"effect": "armature", "joints": [2, 4], "parameters": {"inertia": inertia}}


def test_values_beyond_two_deviations_and_a_twentieth_are_listed() -> None:
    (text,) = pulled_texts(rotor([0.5, 0.35], [0.01, 0.01], [0.51, 0.39]))
    assert text.startswith("inertia J4 0.39") and "kg" in text


def test_values_that_agree_are_not() -> None:
    assert pulled_texts(rotor([0.5, 0.35], [0.01, 0.1], [0.515, 0.39])) == []


def test_nothing_is_listed_if_the_commands_are_not_known() -> None:
    found = rotor([0.5, 0.35], [0.01, 0.01], [0.6, 0.6])
    del found["parameters"]["inertia"]["by_commands"]
    assert pulled_texts(found) == []
