"""The same network by numpy, by torch in training, and exported: one number."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
import toy

from gapscope.effects.residual.inputs import Inputs, Layout
from gapscope.ident.residual.export import onnx_model
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.training import Ensemble


@pytest.mark.parametrize("form", ["mlp", "tcn"])
@pytest.mark.parametrize("n", [1, 2, 7])
def test_numpy_equals_torch(form: str, n: int) -> None:
    settings = ResidualSettings(form=form, members=3, hidden=8)
    c = Layout(n).channels
    inputs = Inputs(n, settings.taps, 0.02, np.zeros((n, c)), np.ones((n, c)))
    ensemble = Ensemble(settings, inputs, torch.Generator().manual_seed(1)).double()
    windows = np.random.default_rng(2).standard_normal(
        (n, 9, inputs.taps, inputs.channels)
    )
    with torch.no_grad():
        expected = ensemble(torch.as_tensor(windows))
    for found, wanted in zip(ensemble.arrays().outputs(windows), expected, strict=True):
        np.testing.assert_allclose(found, wanted.numpy(), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("form", ["additive", "mlp", "tcn"])
def test_it_is_causal_and_samples_one_by_one_say_the_same(form: str) -> None:
    residual, _ = toy.trained(form)
    m = toy.motion(9)
    windows = residual.inputs.windows(m, 5.0 * np.cos(m.q))
    one = residual.of_windows(windows[:, 500:501]).torque[0]
    np.testing.assert_allclose(
        one, residual.torque(m, 5.0 * np.cos(m.q))[500], rtol=1e-9
    )
    early = type(m)(m.t[:501], m.q[:501], m.dq[:501], m.ddq[:501])
    np.testing.assert_allclose(
        residual.torque(early, 5.0 * np.cos(early.q))[500], one, rtol=1e-6
    )


@pytest.mark.parametrize("form", ["additive", "mlp", "tcn"])
def test_the_onnx_model_says_the_same(form: str, tmp_path) -> None:
    onnx = pytest.importorskip("onnx")
    from onnx.reference import ReferenceEvaluator

    residual, _ = toy.trained(form)
    onnx_model(residual, tmp_path / "residual.onnx")
    loaded = onnx.load(tmp_path / "residual.onnx")
    model = ReferenceEvaluator(loaded)
    # within the training data and far outside, where trust fades
    for speed in (1.0, 4.0):
        m = toy.motion(9, speed=speed)
        rows = np.arange(0, len(m.t), 20)
        windows = residual.inputs.windows(m, 5.0 * np.cos(m.q), rows)
        expected = residual.of_windows(windows).torque
        (found,) = model.run(None, {"windows": windows})
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_onnx_model_says_how_its_windows_are_made(tmp_path) -> None:
    onnx = pytest.importorskip("onnx")

    residual, _ = toy.trained("mlp")
    inputs, m = residual.inputs, toy.motion(9)
    onnx_model(residual, tmp_path / "residual.onnx")
    (entry,) = onnx.load(tmp_path / "residual.onnx").metadata_props
    said = json.loads(entry.value)
    columns, scaling = said["input_columns"], said["normalization"]["inputs"]
    assert (said["sample_dt_s"], said["taps"]) == (inputs.spacing, inputs.taps)
    windows = inputs.windows(m, 5.0 * np.cos(m.q))
    # the newest tap of the last joint, by the names of its channels
    j = inputs.n - 1
    raw = {
        "velocity": m.dq[:, j],
        "load": 5.0 * np.cos(m.q[:, j]),
        "position": m.q[:, j],
        "direction_0.1": np.tanh(m.dq[:, j] / 0.1),
        **({"sin_position_other_1": np.sin(m.q[:, 0])} if j else {}),
    }
    for name, value in raw.items():
        scaled = (value - scaling["mean"][name][j]) / scaling["std"][name][j]
        np.testing.assert_allclose(windows[j, :, -1, columns.index(name)], scaled)
