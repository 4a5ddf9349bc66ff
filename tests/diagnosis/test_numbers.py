"""Effects of a document as rows: places, components, units of slides, faults without numbers."""

from __future__ import annotations

import documents

from gapscope.diagnosis.document.numbers import Number, numbers_of


def test_every_number_has_its_place_component_and_unit() -> None:
    delay, payload = documents.two_effects()["effects"]
    assert list(numbers_of(delay)) == [
        Number("actuator_delay", 4, None, "delay", "", "s", 0.0088, 0.0002),
        Number("actuator_delay", 5, None, "delay", "", "s", 0.0146, 0.0003),
    ]
    mass, *com = numbers_of(payload)
    assert (mass.parameter, mass.component, mass.place) == ("mass", "", "the whole arm")
    assert [number.component for number in com] == ["x", "y", "z"]


def test_a_link_is_a_place_and_a_fault_without_numbers_a_row() -> None:
    values = (("link", "1", 3), ("mass", "kg", 0.5))
    parameters = {k: {"unit": unit, "value": x, "std": None} for k, unit, x in values}
    entry = {"effect": "link_inertia", "joints": [], "parameters": parameters}
    (mass,) = numbers_of(entry)
    assert (mass.place, mass.value, mass.std) == ("link 3", 0.5, None)
    swap = {"effect": "joint_swap", "joints": [1, 2], "parameters": {}}
    rows = [(row.place, row.value) for row in numbers_of(swap)]
    assert rows == [("joint 1", None), ("joint 2", None)]


def test_joints_that_turn_and_that_slide_have_a_unit_each() -> None:
    torque = {"unit": "N m, N", "units": ["N m", "N"], "value": [1, 2], "std": [0, 0]}
    entry = {"effect": "x", "joints": [1, 2], "parameters": {"torque": torque}}
    assert [number.unit for number in numbers_of(entry)] == ["N m", "N"]
