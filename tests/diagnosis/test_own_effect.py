"""An effect of a user: it is predicted, simulated, drawn at random, and found by a diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.diagnose import diagnose
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import register, remove
from gapscope.effects.effect import Effect, Signals, TorqueLaw
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import Grid, Parametrisation
from gapscope.effects.severity import draw
from gapscope.envs.simulated_arm import SimulatedArm

TORQUE, WIDTH = 3.0, 0.4
"""Of the cable drag in the recordings, on joint 2 [N m, rad]."""


def applied() -> AppliedEffect:
    return AppliedEffect("cable_drag", (2,), {"torque": TORQUE, "width": WIDTH})


def drag(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """The law, written a second time [N m]."""
    return TORQUE * (1 - np.exp(-(q**2) / WIDTH**2)) * np.tanh(dq / 0.1)


def test_the_simulator_has_it(cable_drag: Effect) -> None:
    """Within one step it takes dt (M + I)^-1 of its torque off the velocity."""
    q, dq, dt = np.array([0.1, -0.4, 0.5]), np.array([0.2, 1.5, 0.3]), 1e-3
    after = []
    for effects in ((), (applied(),)):
        with SimulatedArm(synthetic.arm(), effects, dt, engine="mujoco") as simulated:
            simulated.reset(q, dq)
            simulated.step(np.zeros(3))
            after.append(simulated.dq)
    inertia = RigidBody(synthetic.arm()).mass_matrix(q) + np.diag(synthetic.ARMATURE)
    torque = [0.0, drag(q[1], dq[1]), 0.0]
    expected = dt * np.linalg.solve(inertia, torque)
    np.testing.assert_allclose(after[0] - after[1], expected, rtol=0.02)


def test_it_is_drawn_at_random(cable_drag: Effect) -> None:
    scale = ArmScale.of(synthetic.arm())
    drawn = draw("cable_drag", np.random.default_rng(0), scale, joints=(1, 3))
    assert drawn.joints == (1, 3) and (drawn.parameters["torque"] >= 1.0).all()


def found_beside(
    torque: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> dict[str, Any]:
    """The only finding on recordings of another simulator, with a torque on joint 2 that depends on q and dq."""
    truth = Truth(extra=lambda t, q, dq: np.outer(torque(q[:, 1], dq[:, 1]), [0, 1, 0]))
    document = diagnose(synthetic.case(truth, duration=6.0)).document
    assert document["verdict"] == "effects_found"
    (found,) = document["effects"]
    assert found["joints"] == [2]
    return dict(found)


def test_a_diagnosis_finds_it(cable_drag: Effect) -> None:
    found = found_beside(drag)
    assert found["effect"] == "cable_drag"
    values = {name: entry["value"] for name, entry in found["parameters"].items()}
    assert values["torque"] == pytest.approx([TORQUE], rel=0.05)
    assert values["width"] == pytest.approx([WIDTH], rel=0.05)


def test_a_law_may_have_several_linear_coordinates_beside_the_one_that_is_searched() -> (
    None
):
    """A spring that is strong near the middle, and a constant torque there: two coordinates, one width."""

    def law(s: Signals, slope: Any, level: Any, width: Any) -> np.ndarray:
        reach = np.where(width == 0, 1.0, width)
        near = np.exp(-((s.position / reach) ** 2))
        return (slope * s.position + level) * near

    effect = TorqueLaw(
        name="magnet",
        family="transmission",
        scope="joint",
        equation="(a q + b) exp(-(q / w)^2)",
        parameters=(
            Parameter("slope", "a", "N m/rad", (-500.0, 500.0), (1.0, 20.0)),
            Parameter("level", "b", "N m", (-500.0, 500.0), (1.0, 20.0)),
            Parameter("width", "w", "rad", (0.05, 3.0), (0.1, 0.5), severity=0),
        ),
        looks_like="a torque near the middle of the range",
        reference="test",
        law=law,
        parametrisation=Parametrisation(
            lambda x, s: {"slope": x[0], "level": x[1], "width": s[0]},
            linear=2,
            nonlinear=("width",),
            grid=Grid(0.1, 1.0, (0.05, 3.0)),
        ),
    )
    register(effect)
    try:
        found = found_beside(lambda q, dq: (8.0 * q + 2.0) * np.exp(-((q / 0.3) ** 2)))
    finally:
        remove("magnet")
    assert found["effect"] == "magnet"
    values = {name: entry["value"][0] for name, entry in found["parameters"].items()}
    assert values == pytest.approx({"slope": 8.0, "level": 2.0, "width": 0.3}, rel=0.1)
