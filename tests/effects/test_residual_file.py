"""The file of a residual network, and the corrected arm that carries one: no torch is needed to use it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from guard import HANG

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.motions.motion import Motion
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import (
    read_corrected,
    read_corrected_arm,
    write_corrected,
)
from gapscope.effects.residual.basis import draw_basis, part_of_each
from gapscope.effects.residual.file import read_residual, write_residual
from gapscope.effects.residual.inputs import Inputs, Layout
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.effects.residual.network import Network
from gapscope.effects.residual.trust import Trust


def network(n: int, seed: int = 0) -> ResidualNetwork:
    """A network that was never trained: additive on the even joints, an MLP on the odd ones."""
    rng, taps, members = np.random.default_rng(seed), 4, 3
    c, near = Layout(n).channels, len(Layout(n).neighbourhood)
    inputs = Inputs(n, taps, 0.02, np.zeros((n, c)), np.ones((n, c)))
    sizes = [(len(inputs.seen_by_mlp), 5), (5, 2)]
    weights = tuple(rng.standard_normal((members, n, a, b)) for a, b in sizes)
    biases = tuple(rng.standard_normal((members, n, b)) for _, b in sizes)
    basis = draw_basis(-np.ones((n, c)), np.ones((n, c)), seed)
    head = 0.1 * rng.standard_normal((members, n, len(part_of_each(basis)), 2))
    trust = Trust(rng.standard_normal((n, 6, near)), np.full(n, 50.0))
    return ResidualNetwork(
        inputs,
        (
            Network("additive", np.zeros(0, int), (head,), (biases[1],), basis),
            Network("mlp", inputs.seen_by_mlp, weights, biases),
        ),
        np.arange(n) % 2,
        trust,
        np.ones(n),
        np.full(n, 2.0),
        12.0,
    )


def moving(n: int) -> Motion:
    t = np.arange(200) / 100.0
    phase = np.arange(n)
    return Motion(
        t, *(f(t[:, None] + phase) for f in (np.sin, np.cos, lambda x: -np.sin(x)))
    )


def test_it_comes_back_as_it_was_written(tmp_path: Path) -> None:
    residual, m = network(6), moving(6)
    write_residual(residual, tmp_path / "residual.npz")
    found = read_residual(tmp_path / "residual.npz")
    for a, b in zip(
        vars(residual.predict(m, m.q)).values(),
        vars(found.predict(m, m.q)).values(),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


def test_corrected_arm_adds_it_and_a_simulator_leaves_it_out(tmp_path: Path) -> None:
    pytest.importorskip("pybullet_data")
    arm, residual = load_nominal_arm("xarm6"), network(6)
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
    write_residual(network(7), whole)
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
        ({"bound": np.ones(5)}, r"bound: has shape \(5,\), expected \(6,\)"),
        (
            {"mlp.bias0": np.full((3, 6, 5), np.nan)},
            "mlp.bias0: holds values that are not finite",
        ),
        ({"mlp.weight0": np.ones((3, 6, 4, 5))}, "do not fit together"),
        ({"additive.weight0": np.ones((3, 6, 4, 2))}, "do not fit together"),
        ({"schema": np.array(1), "forms": None}, "its schema is 1, known is 2"),
    ],
)
def test_arrays_that_do_not_fit_are_told(
    change: dict, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "residual.npz"
    write_residual(network(6), path)
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


def test_no_torch_is_needed(tmp_path: Path) -> None:
    write_residual(network(6), tmp_path / "residual.npz")
    code = (
        "import sys; from gapscope.effects.residual.file import read_residual as r; "
        f"r(r'{tmp_path / 'residual.npz'}'); "
    )
    done = subprocess.run(
        [sys.executable, "-c", code + "assert 'torch' not in sys.modules"],
        capture_output=True,
        text=True,
        timeout=HANG,
    )
    assert done.returncode == 0, done.stderr
