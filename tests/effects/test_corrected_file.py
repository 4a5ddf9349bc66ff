"""The file corrected.yaml: it comes back as it was written, and each fault is told with file and field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from arms import iiwa_of_three
from cases import sines, untrained_network

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import (
    read_corrected,
    read_corrected_arm,
    read_with_faults,
    write_corrected,
)
from gapscope.effects.residual import read_residual, write_residual
from gapscope.effects.setup_faults import ShiftedInertials, SignFlip, UnitMismatch
from gapscope.effects.severity import draw

NUMBERS = AppliedEffect(
    "coulomb_friction", (1, 3, 2), {"torque": [1e-17, 5e-324, 0.1 + 0.2]}
)
"""Which YAML takes for texts if they are written without a point, and one of many digits."""
NAMES = ("", "null", "1e5", "a: b # c", "- Grüße\n\t'\"\\", "\x00\x85\u2028\U0001f600")


@pytest.mark.parametrize("name", NAMES)
def test_round_trip_of_every_effect(name: str, tmp_path: Path) -> None:
    path, scale = tmp_path / "corrected.yaml", ArmScale.of(iiwa_of_three())
    rng = np.random.default_rng(0)
    effects = (NUMBERS, *(draw(each, rng, scale) for each in CATALOGUE))
    write_corrected(name, effects, path)
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert (content["schema"], content["case"]) == (1, name)
    assert [entry.name for entry in tmp_path.iterdir()] == ["corrected.yaml"]
    for read, written in zip(read_corrected(path), effects, strict=True):
        assert (read.name, read.joints) == (written.name, written.joints)
        for key, value in written.parameters.items():
            np.testing.assert_array_equal(read.parameters[key], value)


LOAD = "effect: payload, parameters: {mass: 1, com: [0, 0, 0]}"


def entry(text: str) -> str:
    return f"schema: 1\neffects:\n  - {{{LOAD}}}\n  - {text}\n"


def coulomb(joints: object = "[1]", torque: object = "[1]", more: str = "") -> str:
    values = f"{{torque: {torque}}}" if torque else "{}"
    inside = f"effect: coulomb_friction, joints: {joints}, parameters: {values}{more}"
    return entry(f"{{{inside}}}")


def beside(text: str) -> str:
    return f"schema: 1\neffects: []\n{text}\n"


def carried(place: str) -> str:
    return entry(f"{{{LOAD}, {place}}}")


KEYS, ENTRY = "expected the keys schema: 1 and effects", r"effects\[1\]"
BAD = [
    ("effects: [", "is not valid YAML"),
    ("\xff", "is not a text in UTF-8"),
    ("[1, 2]", KEYS),
    ("", KEYS),
    ("schema: 2\neffects: []", "expected the keys schema: 1"),
    ("schema: 1\neffects: {}", "effects: \\[...\\]"),
    (beside("efects: []"), "unknown key 'efects'"),
    (entry("coulomb_friction"), f"{ENTRY}: expected effect:, joints: and parameters:"),
    (entry("{effect: stiction}"), ENTRY),
    (entry("{effect: stiction, joints: [1], parameters: {torque: 1}}"), f"{ENTRY}: unknown effect 'stiction'"),
    (coulomb(torque=None), f"{ENTRY}, coulomb_friction: expected the param"),
    (coulomb("[elbow]"), ENTRY),
    (coulomb(1), ENTRY),
    (coulomb(torque="[much]"), f"{ENTRY}, coulomb_friction.torque: .*not a number"),
    (coulomb(torque="[null]"), f"{ENTRY}, coulomb_friction.torque"),
    (coulomb("[yes]"), rf"{ENTRY}.joints\[0\]: expected a number \(true"),
    (coulomb(torque="[true]"), rf"{ENTRY}.parameters.torque\[0\]: expected a number"),
    (entry("{effect: payload, parameters: {mass: on, com: [0, 0, 0]}}"), "parameters.mass: expected a number"),
    (entry("{effect: payload, parameters: {mass: 1, com: [0, [1, 2], 0]}}"), ENTRY),
    (carried("recordings: b.csv"), f"{ENTRY}.*expected names of recordings"),
    (carried("from: 3"), f"{ENTRY}.*recordings: beside from: and to:"),
    (carried("recordings: [b.csv], to: soon"), f"{ENTRY}.*expected a time in s"),
    (carried("recordings: [b.csv], from: 3, to: 2"), f"{ENTRY}.*which is no time"),
    (carried("recordings: [b.csv], from: .nan"), f"{ENTRY}.*which is no time"),
    (entry("{effect: sign_flip, joints: [2], variant: torque}"), "fault of the set-up"),
    (f"{coulomb()}  - {coulomb().splitlines()[-1][4:-1]}, recordings: [a.csv]}}", "occurs twice on joint 1"),
    (beside("remainder: [1.0, 2.0]"), "remainder"),
    (beside("remainder: heavy"), "remainder"),
    (beside(f"remainder: {[[1.0] * 9] * 3}"), "remainder"),
    (beside("presliding: [1.0e-5, 1.0e-5]"), "presliding"),
    (beside("presliding: [-1.0e-5]"), "presliding"),
    (beside("presliding: [much]"), "presliding"),
]  # fmt: skip
"""What stands in a file, and what is said of it."""


@pytest.mark.parametrize(("text", "message"), BAD)
def test_fault_names_file_and_field(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "found.yaml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=f"(?s){message}") as caught:
        read_corrected_arm(iiwa_of_three(), path)
    assert caught.value.file == path and str(path) in str(caught.value)


def test_written_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(GapscopeError, match="cannot be written"):
        write_corrected("case", (), tmp_path / "file" / "corrected.yaml")
    write_corrected("old", (), tmp_path / "corrected.yaml")
    with pytest.raises(AttributeError):
        write_corrected("new", (None,), tmp_path / "corrected.yaml")
    assert yaml.safe_load((tmp_path / "corrected.yaml").read_text())["case"] == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["corrected.yaml", "file"]


def test_setup_faults_go_there_and_back(tmp_path: Path) -> None:
    path, gears = tmp_path / "truth.yaml", UnitMismatch("motor_side", (1, 2), 80.0)
    faults = (SignFlip((2,), "joint"), gears, ShiftedInertials(-1))
    coulomb = AppliedEffect("coulomb_friction", (1,), {"torque": [3.0]})
    write_corrected("c", (coulomb,), path, faults=faults)
    effects, found = read_with_faults(path)
    assert found == faults and [x.name for x in effects] == ["coulomb_friction"]


@pytest.mark.parametrize(
    ("entry", "place", "message"),
    [
        ("{effect: sign_flip, joints: [2], variant: torqe}", "", "did you mean 'torque'"),
        ("{effect: sign_flip, joints: [2], parameters: {size: 1}}", "", "has no 'size'"),
        ("{effect: time_stamps, variant: jitter}", "", "amount"),
        ("{effect: sign_flip, joints: [true], variant: torque}", ".joints[0]", "expected a number"),
        ("{effect: sign_flip, joints: ['1'], variant: torque}", "", "joints count from 1 and occur once, got ('1',)"),
        ("{effect: joint_swap, joints: [1, 2, 1]}", "", "joints count from 1 and occur once, got (1, 2, 1)"),
        ("{effect: shifted_inertials, parameters: {by: 0.5}}", "", "a number of links is whole, got 0.5"),
        ("{effect: shifted_inertials, parameters: {by: on}}", ".parameters.by", "expected a number"),
    ],
)  # fmt: skip
def test_setup_faults_that_cannot_be_made_name_their_entry(
    tmp_path: Path, entry: str, place: str, message: str
) -> None:
    path = tmp_path / "truth.yaml"
    path.write_text(f"schema: 1\neffects:\n  - {entry}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"truth\.yaml") as caught:
        read_with_faults(path)
    assert f"effects[0]{place}" in str(caught.value) and message in str(caught.value)
    with pytest.raises(InputError, match="fault of the set-up|expected a number"):
        read_corrected(path)


REMAINDER = np.arange(30.0).reshape(3, 10) / 7.0
"""What the links of a three-joint arm lack."""


def test_what_bodies_lack_comes_back_except_in_simulators(tmp_path: Path) -> None:
    path = tmp_path / "corrected.yaml"
    write_corrected("c", (), path, corrects="identified_case.yaml", remainder=REMAINDER)
    assert yaml.safe_load(path.read_text())["corrects"] == "identified_case.yaml"
    back = read_corrected_arm(iiwa_of_three(), path)
    np.testing.assert_array_equal(back.remainder, REMAINDER)
    with pytest.warns(ModelWarning, match="remainder"):
        assert read_corrected(path) == ()


# The file of a residual network, and the corrected arm that carries one: no torch is needed to use it.


NETWORK = untrained_network(3)


def test_corrected_arm_adds_it_and_a_simulator_leaves_it_out(tmp_path: Path) -> None:
    arm, path = iiwa_of_three(), tmp_path / "corrected.yaml"
    write_residual(NETWORK, tmp_path / "nets" / "residual.npz")
    write_corrected("case", (), path, residual="nets/residual.npz")
    corrected, body = read_corrected_arm(arm, path), RigidBody(arm)
    moving = sines(np.arange(200) / 100.0, 1.0, 1.0, np.arange(3))
    plain = CorrectedArm(arm).predict(body, moving)
    expected = plain + NETWORK.torque(moving, plain)
    found = corrected.predict(body, moving)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert np.abs(found - plain).max() > 0.1
    with pytest.warns(ModelWarning, match="residual network is left out"):
        assert read_corrected(path) == ()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("residual.npz", "corrected.yaml, residual: .* 4 joints, this one has 3"),
        ("short.npz", "short.npz: cannot be read as NPZ"),
        ("none.npz", "none.npz: no such file"),
        (3, "residual: expected the name of a file"),
    ],
)
def test_a_network_that_is_none_of_the_arm_is_told(
    name: object, message: str, tmp_path: Path
) -> None:
    whole = tmp_path / "residual.npz"
    write_residual(untrained_network(4), whole)
    (tmp_path / "short.npz").write_bytes(whole.read_bytes()[:-200])
    model = tmp_path / "corrected.yaml"
    write_corrected("case", (), model, residual=name)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        read_corrected_arm(iiwa_of_three(), model)


RNN, SCHEMA_1 = {"forms": np.array(["rnn"])}, {"schema": np.array(1), "forms": None}
FIVE = "bound: holds float64 of shape (5,), expected numbers of shape (3)"
NO_NETWORKS = [
    (RNN, "forms rnn; known are"),
    ({"schema": np.array(3)}, "schema 3"),
    (SCHEMA_1, "is of schema 1 and forms unknown; known are schema 2"),
    ({"scale": None}, "scale is missing"),
    ({"mlp.weight1": None}, "mlp.weight1 is missing"),
    ({"additive.own": None}, "additive.own is missing"),
    ({"bound": np.ones(5)}, FIVE),
    ({"mlp.bias0": np.full((3, 3, 5), np.nan)}, "mlp.bias0: holds values that are not"),
    ({"mlp.weight0": np.ones((3, 3, 4, 5))}, "do not fit together"),
    ({"additive.weight0": np.ones((3, 3, 4, 2))}, "do not fit together"),
    ({"schema": np.array([{}], dtype=object)}, "Object arrays"),
]
"""Changed arrays of the file of a network, and what is said."""


@pytest.mark.parametrize(("change", "message"), NO_NETWORKS)
def test_arrays_that_do_not_fit(change: dict, message: str, tmp_path: Path) -> None:
    path = tmp_path / "residual.npz"
    write_residual(NETWORK, path)
    with np.load(path) as content:
        arrays = {**content, **change}
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(InputError) as caught:
        read_residual(path)
    assert message in str(caught.value)
