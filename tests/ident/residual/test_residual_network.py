"""The residual network: it learns, it leaves the physics alone, and it knows where it knows nothing."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
import toy

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.effects.residual import Inputs, Layout
from gapscope.ident.residual.export import onnx_model
from gapscope.ident.residual.fit import (
    ResidualSettings,
    Tensor,
    as_arrays,
    begun,
    fit_residual,
)

FORMS = ("additive", "mlp", "tcn")


@pytest.mark.parametrize("form", FORMS)
def test_it_learns_what_no_effect_explains_on_an_unseen_trajectory(form: str) -> None:
    residual, report = toy.trained(form)
    x = toy.trajectory(7)
    truth = toy.unknown(x.motion)[x.rows, 0]
    said = residual.torque(x.motion, x.load)[x.rows]
    assert np.mean((truth - said[:, 0]) ** 2) < 0.4 * np.mean(truth**2)
    assert report.closed[0] > 0.4 and report.gain[0] > 0.6
    # joint 2 is noise and friction: nothing is learnt there
    assert np.sqrt(np.mean(said[:, 1] ** 2)) < 0.05


@pytest.mark.parametrize("form", FORMS)
def test_output_is_orthogonal_to_the_physics_and_no_parameter_moves(form: str) -> None:
    residual, report = toy.trained(form)
    xs = [toy.trajectory(k) for k in range(3)]
    said = np.concatenate([residual.torque(x.motion, x.load)[x.rows] for x in xs])
    columns = np.concatenate([x.columns for x in xs]) / residual.scale[None, :, None]
    matrix = columns.reshape(-1, columns.shape[2])
    moved = np.linalg.lstsq(matrix, (said / residual.scale).ravel(), rcond=None)[0]
    assert np.abs(moved).max() < 1e-6
    # friction was in the gap, and was taken out of the target
    assert report.in_target > 0.05
    assert report.in_output[1] < 1e-12 <= report.in_output[0]
    assert report.moves[1].max() < 1e-6


def test_same_seed_same_bits_and_another_seed_another_network() -> None:
    xs, runs = [toy.trajectory(k) for k in range(3)], []
    for seed in (3, 3, 4):
        settings = ResidualSettings("mlp", members=3, steps=80, seed=seed)
        (network,) = fit_residual(xs, settings)[0].networks
        runs.append([x.tobytes() for x in (*network.weights, *network.biases)])
    assert runs[0] == runs[1] != runs[2]


@pytest.mark.parametrize("form", FORMS)
def test_it_says_nothing_outside_what_it_has_seen(form: str) -> None:
    residual, _ = toy.trained(form)
    m = toy.motion(7)
    load, wild = 5.0 * np.cos(m.q), replace(m, dq=8.0 * m.dq + 20.0, ddq=60.0 * m.ddq)
    assert not residual.torque(wild, load).any()
    windows = residual.inputs.windows(m, load)
    near = windows[:, :, -1, residual.inputs.layout.neighbourhood]
    assert residual.trust.factor(near).mean() > 0.8


def test_torque_is_bounded_by_the_training_residual() -> None:
    residual, _ = toy.trained()
    largest = np.max([np.abs(toy.trajectory(k).residual) for k in range(3)], (0, 1))
    rng, inputs = np.random.default_rng(0), residual.inputs
    windows = 5.0 * rng.standard_normal((toy.N, 4000, inputs.taps, inputs.channels))
    trusting = residual.trust._replace(radius=1e6 * np.ones(toy.N))
    loud = replace(residual, trust=trusting, scale=100.0 * residual.scale)
    torque = np.abs(loud.of_windows(windows))
    assert (torque <= 1.5 * largest).all() and torque[:, 0].max() > 0.5 * largest[0]


@pytest.mark.parametrize(("recordings", "members"), [(1, 5), (3, 3), (4, 4)])
def test_each_member_holds_out_a_recording_or_a_block_of_few(
    recordings: int, members: int
) -> None:
    xs = [toy.trajectory(k) for k in range(recordings)]
    residual, report = fit_residual(xs, ResidualSettings("mlp", steps=80))
    assert residual.networks[0].members == members
    assert np.isfinite(report.closed).all()
    # both ways to keep apart were tried
    assert set(report.closed_apart) == {"all", "effects"}
    assert report.apart in report.closed_apart


def test_without_a_trajectory_nothing_is_learnt() -> None:
    with pytest.raises(InputError, match="no trajectory"):
        fit_residual([], ResidualSettings())


@pytest.mark.parametrize("few", [{"members": 1}, {"hidden": 0}, {"steps": 0}])
def test_settings_that_train_nothing_are_refused(few: dict[str, int]) -> None:
    with pytest.raises(InputError, match="or more"):
        ResidualSettings(**few)


# The same network by numpy, by torch in training, and exported: one number.


@pytest.mark.parametrize("form", ["mlp", "tcn"])
@pytest.mark.parametrize("n", [1, 7])
def test_numpy_equals_torch(form: str, n: int) -> None:
    settings, c = ResidualSettings(form=form, members=3, hidden=8), Layout(n).channels
    inputs = Inputs(n, settings.taps, 0.02, np.zeros((n, c)), np.ones((n, c)))
    network = begun(settings, inputs, torch.Generator().manual_seed(1))
    shape = (n, 9, inputs.taps, inputs.channels)
    windows = np.random.default_rng(2).standard_normal(shape)
    by_torch = network.outputs(Tensor(torch.as_tensor(windows).float()))
    for found, wanted in zip(
        as_arrays(network).outputs(windows), by_torch, strict=True
    ):
        np.testing.assert_allclose(found, wanted.tensor.detach(), atol=1e-5)


@pytest.mark.parametrize("form", FORMS)
def test_it_is_causal_and_samples_one_by_one_say_the_same(form: str) -> None:
    residual, _ = toy.trained(form)
    m = toy.motion(9)
    load = 5.0 * np.cos(m.q)
    one = residual.of_windows(residual.inputs.windows(m, load)[:, 500:501])[0]
    np.testing.assert_allclose(one, residual.torque(m, load)[500], rtol=1e-9)
    early = Motion(*(x[:501] for x in (m.t, m.q, m.dq, m.ddq)))
    found = residual.torque(early, load[:501])[500]
    np.testing.assert_allclose(found, one, rtol=1e-6)


@pytest.mark.parametrize("form", FORMS)
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
        expected = residual.of_windows(windows)
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
