"""Rotor and friction of a motor that turns two joints: by hand, through the file, and refused without a coupling."""

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
from gapscope.effects.coupled_motors import COUPLED_MOTORS

EFFECTS = (
    AppliedEffect("coupled_coulomb_friction", (2,), {"torque": [1.5]}),
    AppliedEffect("coupled_viscous_friction", (2,), {"coefficient": [0.7]}),
    AppliedEffect("coupled_armature", (2,), {"inertia": [0.2]}),
)


@pytest.fixture
def coupled(two: NominalArm) -> NominalArm:
    """Motor 2 turns half backwards with joint 1."""
    return replace(two, coupling=np.array([[1.0, 0.0], [-0.5, 1.0]]))


@pytest.fixture
def motion() -> Motion:
    rng = np.random.default_rng(4)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 50, 2))
    return Motion(np.arange(50) / 100, q, dq, ddq)


def test_torque_by_hand(coupled: NominalArm, motion: Motion) -> None:
    """w = dq2 - dq1 / 2; f = 1.5 sgn w + 0.7 w + 0.2 dw/dt acts on joint 2, and -f / 2 on joint 1."""
    body = RigidBody(coupled)
    added = CorrectedArm(coupled, EFFECTS).predict(body, motion) - CorrectedArm(
        coupled
    ).predict(body, motion)
    w = motion.dq[:, 1] - 0.5 * motion.dq[:, 0]
    a = motion.ddq[:, 1] - 0.5 * motion.ddq[:, 0]
    f = 1.5 * np.tanh(w / 0.005) + 0.7 * w + 0.2 * a
    np.testing.assert_allclose(added, np.column_stack([-0.5 * f, f]), atol=1e-9)


def test_friction_takes_power(coupled: NominalArm, motion: Motion) -> None:
    body = RigidBody(coupled)
    without = CorrectedArm(coupled).predict(body, motion)
    dry = [
        AppliedEffect(name, (2,), {"torque": [1.0], "velocity": [0.3]})
        for name in ("coupled_stribeck_friction", "coupled_saturating_friction")
    ]
    for effect in (*EFFECTS[:2], *dry):
        added = CorrectedArm(coupled, (effect,)).predict(body, motion) - without
        assert ((added * motion.dq).sum(axis=1) > 0).all()


def test_a_file_carries_them(coupled: NominalArm, motion: Motion, tmp_path) -> None:
    write_corrected("case", EFFECTS, tmp_path / "corrected.yaml")
    read = read_corrected_arm(coupled, tmp_path / "corrected.yaml")
    body = RigidBody(coupled)
    expected = CorrectedArm(coupled, EFFECTS).predict(body, motion)
    np.testing.assert_allclose(read.predict(body, motion), expected)


@pytest.mark.parametrize("name", COUPLED_MOTORS)
def test_refused_on_a_motor_that_turns_one_joint(
    two: NominalArm, coupled: NominalArm, name: str
) -> None:
    values = {p: [1.0] for p in COUPLED_MOTORS[name].names}
    for arm, motor in ((two, 2), (coupled, 1)):
        with pytest.raises(InputError, match="coupling"):
            CorrectedArm(arm, (AppliedEffect(name, (motor,), values),)).check()
