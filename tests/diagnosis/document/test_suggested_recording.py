"""The recording that is suggested: for an open alternative, else for an open joint, else none."""

from __future__ import annotations

from typing import Any

from gapscope.diagnosis.document.suggested_recording import suggested_recording


def finding(probability: float, alternative: str = "actuator_lag") -> dict[str, Any]:
    other = {
        "effect": alternative,
        "probability": probability,
        "separated_by": "a chirp above 10 Hz",
    }
    return {"effect": "actuator_delay", "alternatives": [other]}


def test_an_open_alternative_is_separated_first() -> None:
    assert (
        suggested_recording([finding(0.01), finding(0.05)], [], [3])
        == "to tell actuator delay from actuator lag: a chirp above 10 Hz"
    )


def test_nothing_in_its_place_is_an_alternative_too() -> None:
    text = suggested_recording([finding(0.3, "none")], [], [])
    assert text is not None and text.startswith("to tell actuator delay from nothing:")


def test_then_the_joints_with_a_residual() -> None:
    text = suggested_recording([finding(0.049)], [], [2, 5])
    assert text is not None and "unexplained on joint 2, 5" in text


def test_else_none() -> None:
    assert suggested_recording([finding(0.049)], [], []) is None
    assert suggested_recording([], [], []) is None


def test_what_is_possible_is_settled_after_what_is_named() -> None:
    rare, likely = finding(0.01), finding(0.4, "none")
    text = suggested_recording([rare], [likely], [])
    assert text is not None and text.startswith("to tell actuator delay from nothing:")
    first = suggested_recording([finding(0.2)], [likely], [])
    assert first is not None and "actuator lag" in first


def test_two_names_of_one_cause_ask_for_no_recording() -> None:
    named = finding(0.09, "link_inertia")
    named["alternatives"][0]["equivalent"] = True
    assert suggested_recording([named], [], []) is None
