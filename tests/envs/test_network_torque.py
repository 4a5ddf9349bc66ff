"""The residual network in the simulated arm: sample by sample it says what it says of the whole motion."""

from __future__ import annotations

import numpy as np
import pytest
from cases import sines

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import (
    Inputs,
    Layout,
    Network,
    ResidualNetwork,
    Trust,
    draw_basis,
    part_of_each,
)
from gapscope.envs.simulated_arm import NetworkTorque

N, SUB_STEPS = 6, 4


def network() -> ResidualNetwork:
    """Additive on the even joints, an MLP with a past on the odd ones; never trained."""
    rng, layout = np.random.default_rng(0), Layout(N)
    c, near = layout.channels, len(layout.neighbourhood)
    inputs = Inputs(N, 4, 0.02, np.zeros((N, c)), np.full((N, c), 2.0))
    basis = draw_basis(-np.ones((N, c)), np.ones((N, c)), 0)
    head = 0.1 * rng.standard_normal((2, N, len(part_of_each(basis)), 2))
    sizes = [(len(inputs.seen_by_mlp), 5), (5, 2)]
    weights = tuple(rng.standard_normal((2, N, a, b)) for a, b in sizes)
    biases = tuple(rng.standard_normal((2, N, b)) for _, b in sizes)
    forms = (
        Network("additive", np.zeros(0, int), (head,), (biases[1],), basis),
        Network("mlp", inputs.seen_by_mlp, weights, biases),
    )
    trust = Trust(np.zeros((N, 1, near)), np.full(N, 1e3))
    bound = np.full(N, 50.0)
    return ResidualNetwork(
        inputs, forms, np.arange(N) % 2, trust, np.ones(N), bound, 12.0
    )


def motion(size: float) -> Motion:
    return sines(np.arange(801) / 400, size, 1.5, np.arange(N))


def test_samples_one_by_one_say_what_the_whole_motion_says() -> None:
    pytest.importorskip("pybullet_data")
    arm, residual = load_nominal_arm("xarm6"), network()
    reference, measured = motion(0.5), motion(0.52)
    running = NetworkTorque(CorrectedArm(arm, (), residual), reference, SUB_STEPS)
    load = CorrectedArm(arm).predict(RigidBody(arm), reference)

    steps = np.arange(0, len(reference.t), SUB_STEPS)
    t, ddq = reference.t[steps], reference.ddq[steps]
    coarse = Motion(t, reference.q[steps], reference.dq[steps], ddq)
    seen = Motion(t, measured.q[steps], measured.dq[steps], ddq)
    of_reference, of_seen = (residual.torque(m, load[steps]) for m in (coarse, seen))
    # before anything is seen it says what it says of the reference
    planned = np.stack([running.torque(step) for step in steps])
    found = []
    for number, (q, dq) in enumerate(zip(seen.q, seen.dq, strict=True)):
        running.see(number, q, dq)
        found.append(running.torque(steps[number]))
    change = of_seen - of_reference
    np.testing.assert_allclose(np.stack(found) - planned, change, atol=1e-9)
    assert np.abs(change).max() > 0.1
    # lines between every fifth step are close to the network itself
    assert np.abs(planned - of_reference).mean() < 0.05 * np.abs(of_reference).mean()
