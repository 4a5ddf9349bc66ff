"""Effects of a user are read from a file, tried, and refused with a word on what to do."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_effect_page import blocks, write_example

import gapscope
from gapscope.arm.errors import InputError
from gapscope.effects.catalogue import (
    CATALOGUE,
    FILES,
    explained,
    known_effect,
    register,
    remove,
)
from gapscope.effects.effect import Inertial, Signals, TorqueLaw
from gapscope.effects.friction import COULOMB
from gapscope.effects.own_effects import check_effect
from gapscope.effects.parametrisation import linear_in
from gapscope.many.workers import in_order
from gapscope.provenance import program

EXAMPLE = blocks("python")[0]


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    """The catalogue as it was, after each test."""
    names = set(CATALOGUE)
    yield
    for name in set(CATALOGUE) - names:
        remove(name)


@pytest.fixture
def example() -> TorqueLaw:
    """The record of the documentation, which is not in the catalogue."""
    names: dict[str, Any] = {}
    exec(EXAMPLE, names)
    return names["CABLE_DRAG"]


def test_a_file_brings_what_stands_at_its_top_level(tmp_path: Path) -> None:
    (effect,) = gapscope.load_effects(write_example(tmp_path))
    assert CATALOGUE["cable_drag"] is effect
    assert explained()[-1] is effect
    assert os.environ[FILES] == str(tmp_path / "cable_drag.py")
    # what was removed is passed on no more
    remove("cable_drag")
    assert known_effect("cable_drag") is None
    assert os.environ[FILES] == ""


def test_a_file_may_import_effects_and_register_its_own(tmp_path: Path) -> None:
    file = write_example(tmp_path)
    file.write_text(
        "from gapscope.effects.friction import COULOMB\n"
        "from gapscope.effects.catalogue import register\n"
        f"{EXAMPLE}\nregister(CABLE_DRAG)\ndel CABLE_DRAG\n"
    )
    (effect,) = gapscope.load_effects(file)
    assert effect.name == "cable_drag"
    assert CATALOGUE["coulomb_friction"] is COULOMB


def test_a_file_is_read_again_only_after_a_change(tmp_path: Path) -> None:
    file = write_example(tmp_path)
    (first,) = gapscope.load_effects(file)
    before = program()
    assert gapscope.load_effects(file) == (first,)
    file.write_text(EXAMPLE.replace("tanh(v / 0.1 rad/s)", "sgn v"))
    (second,) = gapscope.load_effects(file)
    assert CATALOGUE["cable_drag"] is second
    assert second.equation.endswith("sgn v")
    assert program() != before, "diagnoses made with the old law are not kept"


@pytest.mark.parametrize(("backend", "pools"), [("local", 1), ("ray", 2)])
def test_workers_have_the_effects_of_files(
    tmp_path: Path, backend: str, pools: int, request: pytest.FixtureRequest
) -> None:
    """The second pool of Ray joins the cluster of the first."""
    if backend == "ray":
        # tests that come later in this process have clusters of their own
        request.addfinalizer(pytest.importorskip("ray").shutdown)
    gapscope.load_effects(write_example(tmp_path))
    calls = [("cable_drag",), ("no_such_effect",)]
    for _ in range(pools):
        own, none = in_order(known_effect, calls, 2, backend)
        assert own.equation == CATALOGUE["cable_drag"].equation and none is None


CHANGED = [
    ('"cable_drag"', '"backlash"', "called 'backlash'"),
    ('"cable_drag"', '"Cable Drag"', "snake case"),
    ('family="friction"', 'family="cable"', "'cable'"),
    ('scope="joint"', 'scope="arm"', "scope: .*use joint"),
    ("(1.0, 10.0)", "(1.0, 1e9)", "typical values"),
    ('"torque", "width", Grid', '"c", "width", Grid', "gives c"),
    (", Grid(0.1, 2.0, (0.05, 6.0))", "", "no Grid"),
    ("nonzero(width)", "width", "gives nan where every"),
    ("return torque *", "return 1.0 + torque *", "gives 1 where"),
    (", width: np.ndarray", "", "positional arguments"),
    ("(signals.velocity / 0.1)", "(signals.speed)", "'speed'"),
    ("return torque", "return np.log(-torque)", "nan or inf"),
    ("/ 0.1)\n", "/ 0.1).sum(axis=-1)\n", "shape"),
    ("/ 0.1)\n", "/ 0.1) * signals.load.mean()\n", "one sample"),
]
"""What is put into the example in place of what."""
UNUSABLE = [
    ("x = 1\n", "holds no effect"),
    ("x = 1\ndef f(:\n", "line 2: is not valid Python"),
    ("import numpy\n\nnumpy.no_such_name\n", "line 3: fails while it is read"),
    ("raise SystemExit(3)\n", "line 1: fails"),
    *((EXAMPLE.replace(old, new), message) for old, new, message in CHANGED),
]


@pytest.mark.parametrize(("text", "message"), UNUSABLE)
def test_a_file_that_cannot_be_used_is_refused_with_a_remedy(
    text: str, message: str, tmp_path: Path
) -> None:
    file, before = tmp_path / "mine.py", dict(CATALOGUE)
    file.write_text(text)
    with pytest.raises(InputError, match=rf"(?s)mine\.py.*{message}") as caught:
        gapscope.load_effects(file)
    assert caught.value.remedy
    assert before == CATALOGUE
    with pytest.raises(InputError, match=r"none\.py: no such file"):
        gapscope.load_effects(tmp_path / "none.py")


def test_a_record_that_cannot_be_used_is_refused(example: TorqueLaw) -> None:
    alone = linear_in(example.parameters[0])
    common = {field.name: getattr(example, field.name) for field in fields(Inertial)}
    refused = {
        "no quantity": replace(example, quantities={"torque": "colour"}),
        "severity: gives nothing": replace(example, severity=lambda *_: {}),
        "severity: cannot be computed": replace(example, severity=lambda: {}),
        "gives torque, but the .* torque, width": replace(
            example, parametrisation=alone
        ),
        "Inertial has no law": Inertial(**common),
    }
    for message, record in refused.items():
        with pytest.raises(InputError, match=message):
            register(record)
        assert "cable_drag" not in CATALOGUE


def test_a_name_is_entered_once(example: TorqueLaw) -> None:
    assert register(example) is register(example)
    with pytest.raises(InputError, match="'cable_drag'"):
        register(replace(example, equation="another"))
    assert CATALOGUE["cable_drag"] is example


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_effects_of_the_package_pass_the_same_checks(name: str) -> None:
    effect = CATALOGUE[name]
    if type(effect) is Inertial:
        pytest.skip("changes the model by code of its own")
    check_effect(effect)


def test_the_law_of_the_example_is_what_its_page_says(example: TorqueLaw) -> None:
    """c (1 - exp(-(q / w)^2)) tanh(v / 0.1) with q = w and v = 0.1 rad/s: c (1 - 1/e) tanh 1."""
    signals = Signals(0.0, np.array([0.5]), np.array([0.1]), np.zeros(1))
    torque = example.law(signals, np.array([6.0]), np.array([0.5]))
    assert torque == pytest.approx(6.0 * 0.632121 * 0.761594, rel=1e-5)
