"""The document of a diagnosis: what its schema accepts, what it rejects and with which words, and writing it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest

from gapscope.arm.errors import GapscopeError
from gapscope.diagnosis.document.diagnosis_json import validate, write_document
from gapscope.diagnosis.document.findings import (
    GapStages,
    suggested_recording,
    with_faults,
    with_torques_turned,
)
from gapscope.diagnosis.document.wording import pulled_texts
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, TurnedBase
from gapscope.effects.setup_faults import SignFlip

MAKERS = (
    *(documents.two_effects, documents.no_gap, documents.unexplained),
    *(documents.changed, documents.one_possible),
)
OPTIONAL = (
    *("arm", "recordings", "conditioning", "warnings", "where", "considered"),
    "judged_on",
)


@pytest.mark.parametrize("make", MAKERS)
def test_good_documents_are_accepted(make: Callable[[], dict[str, Any]]) -> None:
    """Without optional keys, with unknown ones anywhere, with null for what is not known."""
    document = make()
    validate(document)
    for key in OPTIONAL:
        del document[key]
    before, after = document["gap"]["before"], document["gap"]["after"]
    for place in (document, before, *document["effects"], document["unexplained"]):
        place["note"] = {"anything": [1, None]}
    before["replay_rmse"], after["torque_nrmse"] = None, [None] * 7
    for effect in document["effects"]:
        for parameter in effect["parameters"].values():
            parameter["std"] = None
    validate(document)


GONE = object()
"""Instead of a value: the key is left out."""
NRMSE = "gap.after.torque_nrmse"
DELAY = "effects.0.parameters.delay"
BROKEN: list[tuple[str, Any, str]] = [
    ("schema", 2, "schema"),
    ("verdict", "fine", "verdict"),
    ("verdict", "no_gap", "no_gap, but effects lists 2"),
    ("case", GONE, "'case' is a required property"),
    ("next_recording", GONE, "'next_recording' is a required property"),
    ("possible", GONE, "'possible' is a required property"),
    ("possible", [{"effect": "payload"}], "field possible[0]"),
    ("closed", 1.2, "field closed"),
    ("unexplained.above_floor", True, "is true, but the verdict is effects_found"),
    ("gap.before.floor", GONE, "field gap.before"),
    ("effects.1.probability", GONE, "field effects[1]: 'probability'"),
    ("effects.0.probability", 1.4, "field effects[0].probability: 1.4"),
    ("effects.0.share", -0.1, "field effects[0].share"),
    ("effects.0.joints", [0, 5], "field effects[0].joints[0]"),
    ("effects.0.joints", [4, 8], "effects[0].joints: names joint 8"),
    (f"{NRMSE}.2", "low", "gap.after.torque_nrmse[2]"),
    (f"{NRMSE}.6", GONE, "gap.after.torque_nrmse: has 6 entries"),
    (f"{NRMSE}.0", float("nan"), "torque_nrmse[0]: is not a finite"),
    (f"{DELAY}.value", [0.1], "parameters.delay.value: is 1"),
    (f"{DELAY}.std", 0.1, "delay.std: does not have the shape"),
    (f"{DELAY}.unit", GONE, "effects[0].parameters.delay"),
    ("effects", [], "verdict: is effects_found, but effects lists 0"),
    ("effects.0.share", 0.1, "effects: are not ordered by share"),
    ("recordings.0.role", "test", "recordings[0].role"),
    ("where.0.kind", "mood", "where[0].kind"),
    ("considered.2.reason", GONE, "considered[2]"),
    ("against.today", GONE, "field against: 'today' is a required property"),
    ("against.recordings", [], "field against.recordings"),
    ("against.identified.coulomb", GONE, "field against.identified: 'coulomb'"),
    ("against.today.viscous", GONE, "field against.today: 'viscous'"),
    ("against.held_out.torque_nrmse", [-0.1], "against.held_out.torque_nrmse[0]"),
    ("against.held_out.rmse", [0.1], "against.held_out.rmse: has 1 entries"),
]
"""A place in a document against a reference, what stands there, and what is said of it."""


@pytest.mark.parametrize(("place", "value", "message"), BROKEN)
def test_a_broken_document_is_rejected_by_name_of_the_field(
    place: str, value: Any, message: str
) -> None:
    document = documents.changed()
    *steps, last = (int(x) if x.isdigit() else x for x in place.split("."))
    parent: Any = document
    for step in steps:
        parent = parent[step]
    if value is GONE:
        del parent[last]
    else:
        parent[last] = value
    with pytest.raises(GapscopeError, match=re.escape(message)):
        validate(document)


def test_round_trip(tmp_path: Path) -> None:
    document = documents.two_effects() | {"case": "Zelle 4 – Übergabe"}
    path = tmp_path / "new" / "diagnosis.json"
    write_document(document, path)
    # one that is not valid leaves the old file
    with pytest.raises(GapscopeError):
        write_document(documents.no_gap() | {"schema": 3}, path)
    assert json.loads(path.read_text(encoding="utf-8")) == document
    assert list(path.parent.iterdir()) == [path]


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


TWO = [
    {"effect": "torque_offset", "share": 0.14, "share_interval": [0.1, 0.2]},
    EFFECT | {"share": 0.26},
]


@pytest.mark.parametrize(
    ("gaps", "effects", "only", "shares"),
    [
        ((0.6, 0.6, 0.35), [EFFECT], (), [("armature", 0.5)]),
        # of 0.5 above the floor 0.4 are closed: effects have twice what was fitted
        ((0.6, 0.6, 0.2), TWO, (), [("armature", 0.52), ("torque_offset", 0.28)]),
        # of 1.0 above the floor a repair leaves 0.4, of which an effect has half
        ((1.1, 0.5, 0.3), [EFFECT], (0.5,), [("sign_flip", 0.6), ("armature", 0.2)]),
        # a fault without a gap of its own has no share
        ((1.1, 1.1, 0.1), [EFFECT], (None,), [("armature", 1.0), ("sign_flip", 0.0)]),
    ],
)
def test_shares_add_up_to_what_is_closed(gaps, effects, only, shares) -> None:
    gap = stages(*gaps)
    found = with_faults(effects, tuple(fault(x) for x in only), gap)
    assert [f["effect"] for f in found] == [name for name, _ in shares]
    assert [f["share"] for f in found] == pytest.approx([x for _, x in shares])
    assert sum(f["share"] for f in found) == pytest.approx(gap.closed)


def test_what_is_closed() -> None:
    assert stages(0.5, 0.5, 0.7).closed == 0.0
    assert stages(0.1, 0.1, 0.05).closed is None
    # the whole is what is closed if the floor is estimated too high
    assert stages(0.12, 0.12, 0.02).whole == pytest.approx(0.1)
    # 0.2 of 0.4 above the floor is left on joint 1; joint 2, far below its floor, pays for no other
    recorded, corrected = np.array([0.5, 0.05]), np.array([0.3, 0.0])
    gap = GapStages(recorded, recorded, corrected, np.array([0.1, 0.1]))
    assert gap.closed == pytest.approx(0.5)


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

    hung, tilted = (with_torques_turned(tilt(roll), 2) for roll in (3.0, 0.1))
    assert [o["effect"] for o in hung["alternatives"]] == ["sign_flip"]
    assert hung["alternatives"][0]["joints"] == [1, 2]
    assert tilted["alternatives"] == []


# The recording that is suggested: for what is unexplained, else for the likeliest open alternative, else none.


def finding(probability: float, alternative: str = "actuator_lag") -> dict[str, Any]:
    other = {"effect": alternative, "probability": probability}
    other["separated_by"] = "a chirp above 10 Hz"
    return {"effect": "actuator_delay", "alternatives": [other]}


NAMED = [finding(0.01), finding(0.05), finding(0.2, "elasticity"), finding(0.1)]
NOTHING = [finding(0.4, "none")]
SAME_BODY = finding(0.09, "link_inertia")
SAME_BODY["alternatives"][0]["equivalent"] = True
UNEXPLAINED = "to find what is unexplained on joints 2 and 5: move each of them alone"
LIKELIEST = "to tell actuator delay from elasticity, which has a probability of 20 %: a chirp above 10 Hz"
OR_NONE = "to tell actuator delay from nothing"


@pytest.mark.parametrize(
    ("reached", "effects", "possible", "joints", "begins"),
    [
        ("unexplained", NAMED, [], [2, 5], UNEXPLAINED),
        ("effects_found", NAMED, NOTHING, [], LIKELIEST),
        ("effects_found", NOTHING, [], [], OR_NONE),
        ("effects_found", [finding(0.01)], NOTHING, [], OR_NONE),
        ("effects_found", [finding(0.049)], [], [], None),
        ("no_gap", [], [finding(0.4)], [], None),
        ("effects_found", [SAME_BODY], [], [], None),
    ],
)
def test_what_is_to_be_recorded_next(
    reached, effects, possible, joints, begins
) -> None:
    text = suggested_recording(reached, effects, possible, joints)
    assert text is None if begins is None else text.startswith(begins)


def test_a_case_that_is_misread_is_corrected_first() -> None:
    line = "say in the case gravity: [0.0, 9.81, 0.0]"
    text = suggested_recording("unexplained", [], [], [2], first=line)
    assert text == f"none yet: first {line}, and diagnose again"


# Findings in words: values that the noise of the encoders pulled.


def rotor(
    value: list[float], std: list[float], by_commands: list[float]
) -> dict[str, Any]:
    inertia = {"unit": "kg m^2", "value": value, "std": std, "by_commands": by_commands}
    return {"effect": "armature", "joints": [2, 4], "parameters": {"inertia": inertia}}


def test_values_beyond_two_deviations_and_a_twentieth_are_listed() -> None:
    (text,) = pulled_texts(rotor([0.5, 0.35], [0.01, 0.01], [0.51, 0.39]))
    assert text.startswith("inertia J4 0.39") and "kg" in text
    assert pulled_texts(rotor([0.5, 0.35], [0.01, 0.1], [0.515, 0.39])) == []
    found = rotor([0.5, 0.35], [0.01, 0.01], [0.6, 0.6])
    del found["parameters"]["inertia"]["by_commands"]
    assert pulled_texts(found) == []
