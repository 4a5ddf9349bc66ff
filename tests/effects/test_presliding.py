"""Presliding: dry friction that builds up over a distance after each reversal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm, write_corrected
from gapscope.effects.friction import friction_direction

COULOMB = AppliedEffect("coulomb_friction", (1,), {"torque": [2.0]})


def direction(path: np.ndarray, distance: float) -> np.ndarray:
    q = path[:, None]
    return friction_direction(q, np.gradient(q, axis=0), np.array([distance]))[:, 0]


def test_it_builds_up_exponentially_with_the_distance_travelled() -> None:
    # a tenth of a second of rest before
    path = np.concatenate([np.zeros(10), np.linspace(0.0, 5e-4, 77)])
    np.testing.assert_allclose(direction(path, 1e-4), 1 - np.exp(-path / 1e-4))


def test_a_reversal_begins_where_the_state_was() -> None:
    # from s = 1 backwards: s = -1 + 2 exp(-x / z)
    there, back = np.linspace(0.0, 1.0, 50), np.linspace(1.0, 1.0 - 2e-4, 50)
    state = direction(np.concatenate([there, back]), 1e-4)[50:]
    np.testing.assert_allclose(state, -1 + 2 * np.exp(-(1.0 - back) / 1e-4), atol=1e-12)


def test_at_rest_it_keeps_its_value() -> None:
    path = np.concatenate([np.zeros(9), np.linspace(0, 1e-4, 20), np.full(90, 1e-4)])
    np.testing.assert_allclose(direction(path, 1e-4)[29:], 1 - np.exp(-1.0))


def test_steps_between_the_same_places_do_not_matter() -> None:
    path = 1e-3 * np.cos(np.linspace(0.0, 7.0, 4001))
    fine, coarse = direction(path, 2e-4), direction(path[::4], 2e-4)
    # reversals fall between the coarse samples
    np.testing.assert_allclose(fine[::4], coarse, atol=1e-4)


def test_without_distance_it_is_the_sign_of_the_velocity(pendulum: NominalArm) -> None:
    t = np.linspace(0.0, 4.0, 401)[:, None]
    motion = Motion(t[:, 0], np.sin(t), np.cos(t), -np.sin(t))
    body = RigidBody(pendulum)
    at_once = CorrectedArm(pendulum, (COULOMB,)).predict(body, motion)
    bent_arm = replace(pendulum, presliding=[1e-7])
    bent = CorrectedArm(bent_arm, (COULOMB,)).predict(body, motion)
    moving = np.abs(motion.dq[:, 0]) > 0.05
    np.testing.assert_allclose(bent[moving], at_once[moving], atol=1e-6)


def test_the_corrected_file_holds_it(pendulum: NominalArm, tmp_path) -> None:
    file = tmp_path / "corrected.yaml"
    write_corrected("case", (COULOMB,), file, presliding=[3e-5])
    assert read_corrected_arm(pendulum, file).arm.presliding == pytest.approx([3e-5])


@pytest.mark.parametrize("value", ["[1.0e-5, 1.0e-5]", "[-1.0e-5]", "[much]"])
def test_an_impossible_distance_is_refused(
    pendulum: NominalArm, tmp_path, value: str
) -> None:
    file = tmp_path / "corrected.yaml"
    file.write_text(f"schema: 1\ncase: x\neffects: []\npresliding: {value}\n")
    with pytest.raises(InputError, match="presliding"):
        read_corrected_arm(pendulum, file)
