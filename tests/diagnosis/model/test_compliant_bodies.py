"""What is simulated of compliant joints is kept as long as the bodies are the same."""

from __future__ import annotations

import numpy as np
import synthetic

from gapscope.diagnosis.model.compliant_bodies import CompliantCandidates
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.transmission import ELASTICITY
from gapscope.model.conditioning import condition, thinned
from gapscope.model.decimated_segments import DecimatedSegments

LOAD = AppliedEffect("payload", (), {"mass": np.array(1.0), "com": np.zeros(3)})
FRICTION = AppliedEffect("coulomb_friction", (1,), {"torque": np.array([2.0])})

SOFT = np.array([1 / 2e3, 5.0 / 2e3**2])
"""Compliance [rad/(N m)] and d / k^2 of a spring."""


def test_friction_leaves_the_bodies_and_a_load_does_not() -> None:
    recording = synthetic.recordings(synthetic.Truth(), duration=4.0)[0]
    data = DecimatedSegments([thinned(condition(recording, 20.0)[0], 100.0)], 10.0)
    arm, candidates = synthetic.arm(), CompliantCandidates(data, synthetic.body())
    bare = candidates.of(CorrectedArm(arm))
    once = bare.added(ELASTICITY, 1, SOFT)
    assert candidates.of(CorrectedArm(arm, (FRICTION,))) is bare
    assert bare.added(ELASTICITY, 1, SOFT) is once
    laden = candidates.of(CorrectedArm(arm, (LOAD, FRICTION)))
    assert (laden.mass > bare.mass).any()
    assert not np.allclose(laden.added(ELASTICITY, 1, SOFT), once)
