"""Corrected arms stay passive: friction takes power, bodies have kinetic energy, and what would not is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.severity import draw

FRICTION = [name for name, each in CATALOGUE.items() if each.family == "friction"]
SHEETS = {
    "coulomb_friction": ("torque", "coulomb"),
    "viscous_friction": ("coefficient", "viscous"),
    "armature": ("inertia", "armature"),
}
"""Parameters that add to values of the data sheet."""


def random_motion(n: int, rng: np.random.Generator) -> Motion:
    """Random states; nothing between one and the next."""
    t = np.arange(200) / 100.0
    q, dq, ddq = rng.standard_normal((3, 200, n)) * [[[1.0]], [[0.5]], [[3.0]]]
    return Motion(t, q, dq, ddq)


def friction_power(corrected: CorrectedArm, rng: np.random.Generator) -> np.ndarray:
    """What the friction of the corrected arm takes on each joint under any load [W], (N, n)."""
    motion = random_motion(corrected.arm.n_joints, rng)
    load = 30.0 * rng.standard_normal(motion.q.shape)
    kept = [e for e in corrected.effects if e.effect.family != "friction"]
    zero = np.zeros(corrected.arm.n_joints)
    smooth = replace(corrected.arm, coulomb=zero, viscous=zero)
    without = CorrectedArm(smooth, tuple(kept)).needed_torque(load, motion)
    return motion.dq * (corrected.needed_torque(load, motion) - without)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_leaves_the_arm_passive(name: str, two: NominalArm) -> None:
    """With values as drawn for simulated arms: friction takes power, and the mass matrix is positive definite."""
    rng, body = np.random.default_rng(3), RigidBody(two)
    scale = ArmScale.of(two)
    for _ in range(5):
        corrected = CorrectedArm(two, (draw(name, rng, scale),))
        corrected.check()
        assert (friction_power(corrected, rng) >= -1e-9).all()
        rotors = two.armature + corrected.value("armature", "inertia")
        assert (rotors >= 0).all()
        bodies = corrected.body(body)
        for q in rng.uniform(-3.0, 3.0, (10, 2)):
            assert np.linalg.eigvalsh(bodies.mass_matrix(q))[0] > 0


def test_all_friction_together_at_the_edge_takes_power(two: NominalArm) -> None:
    """Nothing is left of the data sheet's friction, which fades by 95 % as well."""
    edge: dict[str, dict[str, Any]] = {
        "coulomb_friction": {"torque": -two.coulomb},
        "viscous_friction": {"coefficient": -two.viscous},
        "load_friction": {"coefficient": [0.3, 0.8]},
        "stribeck_friction": {"torque": 5.0, "velocity": 0.02},
        "saturating_friction": {"torque": 5.0, "velocity": 0.05},
        "friction_drift": {"amplitude": -0.95, "time_constant": 5.0},
    }
    assert set(edge) == set(FRICTION)
    effects = tuple(
        AppliedEffect(name, (1, 2), values) for name, values in edge.items()
    )
    corrected = CorrectedArm(two, effects)
    corrected.check()
    power = friction_power(corrected, np.random.default_rng(4))
    assert (power >= -1e-9).all() and power.max() > 0.1


@pytest.mark.parametrize("name", SHEETS)
def test_what_is_negative_in_total_is_refused_at_once(
    name: str, two: NominalArm
) -> None:
    parameter, stated = SHEETS[name]
    nominal = getattr(two, stated)[1]
    rest = AppliedEffect(name, (2,), {parameter: -nominal})
    CorrectedArm(two, (rest,)).check()
    beyond = AppliedEffect(name, (2,), {parameter: -1.01 * nominal})
    with pytest.raises(InputError, match=f"{name}.*joint 2, which would feed energy"):
        CorrectedArm(two, (beyond,)).check()


@pytest.mark.parametrize(
    ("mass", "com", "expected"),
    [
        (3.0, (0.9, 0.9, 0.0), False),
        (-0.5, (0.5, 0.0, 0.0), False),
        (-1.5, (0.9, 0.0, 0.0), True),
        (-0.5, (0.5, 0.0, 1.0), True),
    ],
)
def test_a_load_that_takes_more_inertia_than_there_is_feeds_energy(
    mass: float, com: tuple[float, ...], expected: bool, two: NominalArm
) -> None:
    """The last link: 2 kg at 0.5 m, 0.55 kg m^2 about its axis. 1.5 kg at 0.9 m would take 1.2 kg m^2."""
    load = AppliedEffect("payload", (), {"mass": np.array(mass), "com": np.array(com)})
    assert CorrectedArm(two, (load,)).feeds_energy(RigidBody(two)) is expected
