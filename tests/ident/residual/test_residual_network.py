"""The residual network: it learns, it leaves the physics alone, and it knows where it knows nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import toy

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.effects.residual.file import write_residual
from gapscope.ident.residual.fit import fit_residual
from gapscope.ident.residual.settings import ResidualSettings

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
    said = (
        np.concatenate([residual.torque(x.motion, x.load)[x.rows] for x in xs])
        / residual.scale
    )
    columns = np.concatenate([x.columns for x in xs]) / residual.scale[None, :, None]
    moved = np.linalg.lstsq(
        columns.reshape(-1, columns.shape[2]), said.ravel(), rcond=None
    )[0]
    assert np.abs(moved).max() < 1e-6
    assert (
        report.in_target > 0.05
    )  # friction was in the gap, and was taken out of the target
    assert report.in_output[1] < 1e-12 <= report.in_output[0]
    assert report.moves[1].max() < 1e-6


def test_same_seed_same_bits_and_another_seed_another_network() -> None:
    xs = [toy.trajectory(k) for k in range(3)]
    runs = [
        fit_residual(xs, ResidualSettings("mlp", members=3, steps=80, seed=seed))[0]
        for seed in (3, 3, 4)
    ]
    first, second, other = (
        [*r.networks[0].weights, *r.networks[0].biases] for r in runs
    )
    assert all(a.tobytes() == b.tobytes() for a, b in zip(first, second, strict=True))
    assert any(a.tobytes() != b.tobytes() for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize("form", FORMS)
def test_it_says_nothing_outside_what_it_has_seen(form: str) -> None:
    residual, _ = toy.trained(form)
    m = toy.motion(7)
    far = residual.predict(
        Motion(m.t, m.q, 8.0 * m.dq + 20.0, 60.0 * m.ddq), 5.0 * np.cos(m.q)
    )
    assert not far.torque.any() and not far.trust.any()
    near = residual.predict(m, 5.0 * np.cos(m.q))
    assert near.trust.mean() > 0.8
    assert (near.std > 0).all()


def test_torque_is_bounded_by_the_training_residual() -> None:
    residual, _ = toy.trained()
    largest = np.max(
        [np.abs(toy.trajectory(k).residual).max(axis=0) for k in range(3)], axis=0
    )
    rng = np.random.default_rng(0)
    windows = 5.0 * rng.standard_normal(
        (toy.N, 4000, residual.inputs.taps, residual.inputs.channels)
    )
    loud = replace(
        residual,
        trust=replace(residual.trust, radius=1e6 * np.ones(toy.N)),
        scale=100.0 * residual.scale,
    )
    torque = np.abs(loud.of_windows(windows).torque)
    assert (torque <= 1.5 * largest).all() and torque[:, 0].max() > 0.5 * largest[0]


def test_a_single_trajectory_is_cut_into_blocks() -> None:
    residual, report = fit_residual(
        [toy.trajectory(0)], ResidualSettings("mlp", members=4, steps=80)
    )
    assert residual.networks[0].members == 4 and np.isfinite(report.closed).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"form": "rnn"}, "choose best or additive or mlp or tcn"),
        ({"apart": "none"}, "choose all or effects"),
        ({"members": 9}, "choose 3 to 5"),
    ],
)
def test_settings_that_make_no_sense_are_refused(given: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ResidualSettings(**given)
    with pytest.raises(InputError, match="no trajectory"):
        fit_residual([], ResidualSettings())


def test_a_file_in_no_folder_is_made(tmp_path) -> None:
    write_residual(toy.trained()[0], tmp_path / "new" / "residual.npz")
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["residual.npz"]
