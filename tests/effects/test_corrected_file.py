"""The file corrected.yaml: it comes back as it was written, and each fault is told with file and field."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from arms import iiwa_of_three
from cases import untrained_network
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.arm.motions.motion import Motion
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import (
    read_corrected,
    read_corrected_arm,
    read_with_faults,
    write_corrected,
)
from gapscope.effects.residual import read_residual, write_residual
from gapscope.effects.setup_faults import (
    ShiftedInertials,
    SignFlip,
    TimeStamps,
    UnitMismatch,
)


@st.composite
def applied_effects(draw: st.DrawFn) -> AppliedEffect:
    definition = draw(st.sampled_from(list(CATALOGUE.values())))
    joints = (
        draw(st.lists(st.integers(1, 7), min_size=1, unique=True))
        if definition.scope == "joint"
        else []
    )

    def value(size: int, bounds: tuple[float, float]) -> list[float]:
        return draw(st.lists(st.floats(*bounds), min_size=size, max_size=size))

    values = {}
    for p in definition.parameters:
        drawn = value(len(joints) or p.size, p.bounds)
        values[p.name] = np.array(drawn if joints or p.size > 1 else drawn[0])
    try:
        return AppliedEffect(definition.name, tuple(joints), values)
    except (
        InputError
    ):  # values that are possible one by one may not be together: a start after the end
        reject()


@settings(deadline=None, max_examples=60)
@given(
    effects=st.lists(applied_effects(), max_size=4),
    name=st.text(st.characters(codec="utf-8"), max_size=20),
)
def test_round_trip(effects: list[AppliedEffect], name: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "corrected.yaml"
        write_corrected(name, tuple(effects), path)
        found = read_corrected(path)
        assert yaml.safe_load(path.read_text(encoding="utf-8"))["schema"] == 1
        assert [entry.name for entry in Path(folder).iterdir()] == ["corrected.yaml"]
    assert [(e.name, e.joints) for e in found] == [(e.name, e.joints) for e in effects]
    for read, written in zip(found, effects, strict=True):
        for key, value in written.parameters.items():
            np.testing.assert_array_equal(read.parameters[key], value)


def entry(text: str) -> str:
    return f"schema: 1\neffects:\n  - {{effect: payload, parameters: {{mass: 1, com: [0, 0, 0]}}}}\n  - {text}\n"


def coulomb(joints: object = "[1]", torque: object = "[1]", more: str = "") -> str:
    values = f"{{torque: {torque}}}" if torque else "{}"
    inside = f"effect: coulomb_friction, joints: {joints}, parameters: {values}{more}"
    return entry(f"{{{inside}}}")


def beside(text: str) -> str:
    return f"schema: 1\neffects: []\n{text}\n"


def carried(place: str) -> str:
    return entry(
        f"{{effect: payload, parameters: {{mass: 1, com: [0, 0, 0]}}, {place}}}"
    )


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
    path = tmp_path / "truth.yaml"
    faults = (
        SignFlip((2,), "joint"),
        UnitMismatch("motor_side", (1, 2), 80.0),
        TimeStamps("jitter", 0.2),
        ShiftedInertials(-1),
    )
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
        ("{effect: sign_flip, joints: [1.5], variant: torque}", "", "joints count from 1 and occur once, got (1.5,)"),
        ("{effect: sign_flip, joints: ['1'], variant: torque}", "", "joints count from 1"),
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


def test_what_bodies_lack_comes_back_and_is_left_out_by_simulators(
    tmp_path: Path,
) -> None:
    path = tmp_path / "corrected.yaml"
    write_corrected("c", (), path, corrects="identified_case.yaml", remainder=REMAINDER)
    assert yaml.safe_load(path.read_text())["corrects"] == "identified_case.yaml"
    assert np.array_equal(
        read_corrected_arm(iiwa_of_three(), path).remainder, REMAINDER
    )
    with pytest.warns(ModelWarning, match="remainder"):
        assert read_corrected(path) == ()


# The file of a residual network, and the corrected arm that carries one: no torch is needed to use it.


def moving(n: int) -> Motion:
    t = np.arange(200) / 100.0
    phase = np.arange(n)
    return Motion(
        t, *(f(t[:, None] + phase) for f in (np.sin, np.cos, lambda x: -np.sin(x)))
    )


def test_corrected_arm_adds_it_and_a_simulator_leaves_it_out(tmp_path: Path) -> None:
    pytest.importorskip("pybullet_data")
    arm, residual = load_nominal_arm("xarm6"), untrained_network(6)
    write_residual(residual, tmp_path / "nets" / "residual.npz")
    write_corrected(
        "case", (), tmp_path / "corrected.yaml", residual="nets/residual.npz"
    )
    corrected, m, body = (
        read_corrected_arm(arm, tmp_path / "corrected.yaml"),
        moving(6),
        RigidBody(arm),
    )
    plain = CorrectedArm(arm).predict(body, m)
    np.testing.assert_allclose(
        corrected.predict(body, m), plain + residual.torque(m, plain), rtol=1e-12
    )
    assert np.abs(corrected.predict(body, m) - plain).max() > 0.1
    with pytest.warns(ModelWarning, match="residual network is left out"):
        assert read_corrected(tmp_path / "corrected.yaml") == ()


def test_faults_are_told(tmp_path: Path) -> None:
    whole, part, model = (
        tmp_path / name for name in ("residual.npz", "short.npz", "corrected.yaml")
    )
    write_residual(untrained_network(7), whole)
    part.write_bytes(whole.read_bytes()[:-200])
    pytest.importorskip("pybullet_data")
    arm = load_nominal_arm("xarm6")

    def fault(name: object, message: str) -> None:
        write_corrected("case", (), model, residual=name)  # type: ignore[arg-type]
        with pytest.raises(InputError, match=message):
            read_corrected_arm(arm, model)

    fault(
        "residual.npz",
        r"corrected.yaml, residual: .* an arm with 7 joints, this one has 6",
    )
    fault("short.npz", r"short.npz: cannot be read as NPZ")
    fault("none.npz", r"none.npz: no such file")
    fault(3, r"residual: expected the name of a file")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"forms": np.array(["rnn"])}, "forms rnn; known are"),
        ({"schema": np.array(3)}, "schema 3"),
        ({"scale": None}, "scale is missing"),
        ({"mlp.weight1": None}, "mlp.weight1 is missing"),
        ({"additive.own": None}, "additive.own is missing"),
        (
            {"bound": np.ones(5)},
            r"bound: holds float64 of shape \(5,\), expected numbers of shape \(6\)",
        ),
        (
            {"mlp.bias0": np.full((3, 6, 5), np.nan)},
            "mlp.bias0: holds values that are not finite",
        ),
        ({"mlp.weight0": np.ones((3, 6, 4, 5))}, "do not fit together"),
        ({"additive.weight0": np.ones((3, 6, 4, 2))}, "do not fit together"),
        (
            {"schema": np.array(1), "forms": None},
            "is of schema 1 and forms unknown; known are schema 2",
        ),
    ],
)
def test_arrays_that_do_not_fit_are_told(
    change: dict, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "residual.npz"
    write_residual(untrained_network(6), path)
    with np.load(path) as content:
        arrays = {**content, **change}
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(InputError, match=message):
        read_residual(path)


def test_one_array_or_a_pickle_is_no_network(tmp_path: Path) -> None:
    np.save(tmp_path / "one.npy", np.ones(3))
    with pytest.raises(InputError, match="cannot be read as NPZ"):
        read_residual(tmp_path / "one.npy")
    np.savez(tmp_path / "pickle.npz", schema=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="Object arrays"):
        read_residual(tmp_path / "pickle.npz")
