"""The summary in a terminal, and numbers and verdicts in words."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import documents
import pytest
from rich.console import Console, RenderableType

from gapscope.arm.display import display_unit, nrmse, percent, significant, uncertain
from gapscope.diagnosis.document.wording import (
    acts_on,
    joint_ranges,
    parameter_texts,
    possible_texts,
    short_names,
    unexplained_sentence,
    verdict_sentence,
    with_amount,
)
from gapscope.reports.diagnosis import summary
from gapscope.reports.expected import expected_table


def printed(document: dict[str, Any]) -> str:
    return shown(summary(document))


def shown(what: RenderableType) -> str:
    stream = io.StringIO()
    Console(file=stream, width=80, force_terminal=False).print(what)
    return stream.getvalue()


def test_sizes_of_many_joints_are_read_in_80_columns() -> None:
    sizes = [0.12345 * (joint + 1) for joint in range(14)]
    size = {"effect": "saturating_friction", "parameter": "torque", "unit": "N m"}
    entries = [
        {**size, "joints": [j + 1], "nine_of_ten": x, "half": x / 2}
        for j, x in enumerate(sizes)
    ]
    text = shown(expected_table(entries, len(sizes)))
    assert all(f"{significant(x, 2)} " in text for x in sizes) and "…" not in text
    assert all(f"({significant(x / 2, 2)})" in text for x in sizes)


@pytest.mark.parametrize(
    "make", [documents.two_effects, documents.no_gap, documents.unexplained]
)
def test_the_summary_fits_in_80_columns(make: Callable[[], dict[str, Any]]) -> None:
    document = make()
    document["arm"]["joints"] = ["a_rather_long_name_of_a_joint_" * 3] * 7
    text = printed(document)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert all(f"{x:.3f}" in text for x in document["gap"]["before"]["torque_nrmse"])


SAID = {
    documents.two_effects: (
        *("case005: Effects found", "Actuator delay", "4, 5", "8.80 ± 0.20"),
        *("14.60 ± 0.30", "ms", "98 %", "78 %", "Payload", "+1.051 ± 0.013 kg"),
        *("0.655", "0.066", "0.047", "96 % of the gap", "Next recording: a chirp"),
        *("Warning: excitation", "Unexplained: 4 %"),
    ),
    documents.changed: (
        "Compared with: friday (2 recordings); effects are changes since then",
    ),
    documents.no_gap: ("healthy: No gap",),
    documents.unexplained: ("riddle: Unexplained gap", "100 % stays unexplained"),
}


@pytest.mark.parametrize("make", SAID)
def test_the_summary_says_what_was_found(make: Callable[[], dict[str, Any]]) -> None:
    text = printed(make())
    assert not [said for said in SAID[make] if said not in text]
    if make is documents.no_gap:
        assert "Prob." not in text and "Unexplained" not in text


def test_names_are_not_read_as_markup() -> None:
    odd = {"case": "[red]line[/red] 4", "warnings": ["[/] odd"]}
    text = printed(documents.two_effects() | odd)
    assert "[red]line[/red] 4" in text and "[/] odd" in text


def test_the_first_line_says_main_cause_share_and_what_stays() -> None:
    document = documents.two_effects()
    assert verdict_sentence(document) == (
        "Actuator delay (joints 4 and 5) explains 78 % of the gap and payload of 1.05 kg 19 %; "
        "4 % stays unexplained, most of it on joint 5."
    )
    more = document | {"effects": document["effects"] * 2}
    causes = "of the gap, payload of 1.05 kg 19 % and 2 more effects 97 %; "
    assert causes in verdict_sentence(more)
    # one open joint holds all that stays; nothing stays if every joint is at its floor
    document["gap"]["after"]["torque_nrmse"] = [*documents.FLOOR[:4], 0.066, 0.04, 0.05]
    assert verdict_sentence(document).endswith("; 4 % stays unexplained, on joint 5.")
    document["closed"], document["unexplained"]["share"] = 1.0, 0.0
    assert verdict_sentence(document).endswith("; nothing stays unexplained.")
    # effects without a torque gap are found all the same
    assert verdict_sentence(document | {"closed": None}) == (
        "Actuator delay (joints 4 and 5) and payload of 1.05 kg are found; "
        "no joint exceeds its noise floor."
    )


def test_a_gap_without_a_cause_says_so() -> None:
    document = documents.unexplained()
    assert verdict_sentence(document) == (
        "No effect in the catalogue explains the gap, most of it on joint 5."
    )
    document["possible"] = documents.one_possible()["possible"]
    assert verdict_sentence(document).startswith("No effect reaches 50 % probability")
    assert "a cause is missing" in unexplained_sentence(document)


def test_a_gap_as_of_healthy_real_arms_is_said_to_be_no_fault() -> None:
    document = documents.no_gap()
    document["gap"]["after"]["torque_nrmse"] = [0.02] * 7
    assert verdict_sentence(document).endswith("of the torque is noise.")
    document["gap"]["after"]["torque_nrmse"][2] = 0.21
    assert "at most 21 % (joint 3)" in verdict_sentence(document)
    assert "robot file" not in verdict_sentence(document)


def test_a_large_gap_that_a_poor_data_sheet_explains_is_no_praise_of_it() -> None:
    document = documents.no_gap() | {"conditioning": {"nominal_inertials_std": 0.1}}
    document["gap"]["after"]["torque_nrmse"] = [0.3] * 7
    said = verdict_sentence(document)
    assert "at most 30 % (joint 1), is more than models of healthy real arms" in said
    assert said.endswith(
        "errors of the data sheet explain it; the bodies of the robot file are likeliest off by about "
        "10 % of their size."
    )


def test_what_is_possible_stands_apart_with_what_would_settle_it() -> None:
    document = documents.one_possible()
    assert possible_texts(document) == [
        "payload of 1.05 kg, 31 %; to confirm, record a rest"
    ]
    text = printed(document)
    assert "Possible, not confirmed: payload of 1.05 kg, 31 %;" in text
    assert "payload" not in verdict_sentence(document)


def test_an_amount_is_given_if_one_number_says_it() -> None:
    delay, payload = documents.two_effects()["effects"]
    assert with_amount(payload) == "payload of 1.05 kg"
    assert with_amount(delay) == "actuator delay (joints 4 and 5)"
    one = {"unit": "s", "value": [0.0088], "std": [0.0002]}
    single = delay | {"joints": [4], "parameters": {"delay": one}}
    assert with_amount(single) == "actuator delay of 8.80 ms (joint 4)"
    angle = {"unit": "rad", "value": 0.02, "std": 0.001}
    tilt = {"effect": "base_tilt", "joints": []}
    tilt["parameters"] = {"roll": angle, "pitch": angle}
    assert with_amount(tilt) == "base tilt"


def test_what_an_effect_acts_on() -> None:
    assert acts_on({"effect": "payload", "joints": []}) == "the whole arm"
    assert acts_on({"effect": "armature", "joints": [1, 2, 3, 6]}) == "joints 1–3 and 6"
    link = {"unit": "1", "value": 3, "std": None}
    body = {"effect": "link_inertia", "joints": [], "parameters": {"link": link}}
    assert acts_on(body) == "link 3"
    assert joint_ranges([5, 1, 2]) == ["1", "2", "5"]


def test_names_of_joints_are_cut_to_what_tells_them_apart() -> None:
    assert short_names(documents.JOINTS) == [""] * 7
    names = short_names(["shoulder_pan_joint", "elbow_joint"])
    assert names == ["shoulder_pan", "elbow"]
    assert short_names(["a"]) == ["a"]


VALUES = [
    (8.8, 0.2, "8.80 ± 0.20"),
    (12.6, 0.4, "12.6 ± 0.4"),
    (1234.0, 56.0, "1230 ± 60"),
    (-0.04, 0.3, "−0.04 ± 0.30"),
    (2.0, None, "2.00"),
    (2.0, 0.0, "2.00"),
    (0.0, 0.0, "0"),
    (1.0, 1e-9, "1.00000 ± 0.00001"),
]


def test_values_with_their_uncertainty() -> None:
    assert [uncertain(x, std) for x, std, _ in VALUES] == [text for *_, text in VALUES]


def test_numbers() -> None:
    assert significant(None) == nrmse(None) == percent(None) == "–"
    assert significant(0.01234) == "0.0123" and significant(-88.5, 3, True) == "−88.5"
    shares = [percent(x) for x in (0.0, 0.001, 0.5, 0.998, 1.0)]
    assert shares == ["0 %", "< 1 %", "50 %", "> 99 %", "100 %"]
    assert display_unit("s", 0.0088) == (1e3, "ms")
    assert display_unit("kg m^2", 1.0) == (1.0, "kg m²")
    angles = [display_unit("rad", angle)[1] for angle in (0.035, 4.8e-5)]
    assert angles == ["°", "µrad"]


def test_increments_carry_a_sign_and_units_a_prefix() -> None:
    mass, com = parameter_texts(documents.two_effects()["effects"][1])
    assert mass.text == "+1.051 ± 0.013 kg"
    assert com.text == "x 9.8 ± 1.1, y −1.2 ± 1.0, z 51.4 ± 2.0 mm"


def test_a_spring_that_rests_beyond_its_range_is_said_by_its_torque() -> None:
    entry = {
        "effect": "parallel_spring",
        "joints": [2, 3],
        "torque_at_middle": [None, -12.34],
        "parameters": {
            "stiffness": {"unit": "N m/rad", "value": [20.0, 5.0], "std": [1.0, 0.5]},
            "rest": {"unit": "rad", "value": [0.3, -7.0], "std": [0.02, 3.0]},
        },
    }
    texts = {text.name: text.text for text in parameter_texts(entry)}
    assert texts["rest"] == "J2 17.2 ± 1.1°"
    assert texts["no rest inside the range, torque at its middle"] == "J3 −12.3 N m"


def test_a_turned_base_is_said_as_a_case_file_says_it() -> None:
    entry = {
        "effect": "base_tilt",
        "joints": [],
        "gravity": [0.0, -0.001, -9.81],
        "parameters": {
            "roll": {"unit": "rad", "value": 1.5709, "std": 0.001},
            "pitch": {"unit": "rad", "value": 0.0, "std": 0.8},
        },
    }
    texts = {text.name: text.text for text in parameter_texts(entry)}
    assert texts == {"gravity": "[0.00, 0.00, -9.81] m/s²", "roll": "90.01 ± 0.06°"}
