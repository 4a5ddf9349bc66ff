"""The residual network in the simulated arm: sample by sample it says what it says of the whole motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cases import sines, untrained_network

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.simulated_arm import NetworkTorque

N, SUB_STEPS = 6, 4


def motion(size: float) -> Motion:
    return sines(np.arange(801) / 400, size, 1.5, np.arange(N))


def test_samples_one_by_one_say_what_the_whole_motion_says() -> None:
    arm, residual = load_nominal_arm("xarm6"), untrained_network(N)
    far = residual.trust._replace(radius=np.full(N, 1e3))
    residual = replace(residual, trust=far, bound=np.full(N, 50.0))
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
