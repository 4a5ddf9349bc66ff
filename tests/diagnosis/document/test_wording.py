"""Findings in words: values that the noise of the encoders pulled."""

from __future__ import annotations

from typing import Any

from gapscope.diagnosis.document.wording import pulled_texts


def finding(
    value: list[float], std: list[float], by_commands: list[float]
) -> dict[str, Any]:
    inertia = {"unit": "kg m^2", "value": value, "std": std, "by_commands": by_commands}
    return {"effect": "armature", "joints": [2, 4], "parameters": {"inertia": inertia}}


def test_values_beyond_two_deviations_and_a_twentieth_are_listed() -> None:
    (text,) = pulled_texts(finding([0.5, 0.35], [0.01, 0.01], [0.51, 0.39]))
    assert text.startswith("inertia J4 0.39") and "kg" in text


def test_values_that_agree_are_not() -> None:
    assert pulled_texts(finding([0.5, 0.35], [0.01, 0.1], [0.515, 0.39])) == []


def test_nothing_is_listed_if_the_commands_are_not_known() -> None:
    found = finding([0.5, 0.35], [0.01, 0.01], [0.6, 0.6])
    del found["parameters"]["inertia"]["by_commands"]
    assert pulled_texts(found) == []
