"""Torques that were not measured, and the steps in which others were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapscope.arm.recording import (
    Recording,
    held_notes,
    held_torque,
    step_notes,
    torque_step,
)

T = np.arange(3000) / 500
RNG = np.random.default_rng(0)
Q = np.column_stack([np.sin(2 * T), np.cos(3 * T)])
TAU = 20 * Q + 0.1 * RNG.standard_normal(Q.shape)
SOUND = Recording("a.csv", T, Q, tau=TAU)


def test_a_sound_torque_is_measured_throughout() -> None:
    assert not held_torque(T, Q, TAU).unknown.any()
    assert held_notes(SOUND) == ()


def test_a_limit_that_was_reached() -> None:
    tau = np.column_stack([np.clip(TAU[:, 0], -15, 15), TAU[:, 1]])
    held = held_torque(T, Q, tau)
    assert (held.clipped[:, 0] == (np.abs(TAU[:, 0]) >= 15)).all()
    assert not held.clipped[:, 1].any() and not held.stuck.any()
    (note,) = held_notes(replace(SOUND, tau=tau))
    assert "stands at a limit" in note
    assert note.endswith(f"tau1 {held.clipped[:, 0].mean():.1%}")


def test_a_stuck_sensor() -> None:
    tau = TAU.copy()
    tau[1000:1300, 1] = tau[1000, 1]
    held = held_torque(T, Q, tau)
    assert np.flatnonzero(held.stuck[:, 1]).tolist() == list(range(1001, 1300))
    assert not held.clipped.any() and not held.stuck[:, 0].any()
    (note,) = held_notes(replace(SOUND, tau=tau))
    assert note.endswith("as of a stuck sensor: tau2 10.0%")


def test_a_command_at_rest_is_no_stuck_sensor() -> None:
    moving = (T > 2) & (T < 4)
    q = Q * moving[:, None]
    assert not held_torque(T, q, 20 * q).unknown.any()


@pytest.mark.parametrize("step", [0.5, 2.0])
def test_coarse_steps_are_no_stuck_sensor(step: float) -> None:
    tau = step * np.round(TAU / step)
    assert not held_torque(T, Q, tau).unknown.any()
    np.testing.assert_allclose(torque_step(tau), step)
    assert torque_step(TAU).tolist() == [0.0, 0.0]


def test_steps_are_said_if_their_rounding_is_one_per_cent_of_the_torque() -> None:
    fine, coarse = (replace(SOUND, tau=s * np.round(TAU / s)) for s in (0.1, 1.0))
    assert step_notes(fine) == () and step_notes(SOUND) == ()
    (note,) = step_notes(coarse)
    assert note.endswith("raise the noise floor: tau1 1, tau2 1")
