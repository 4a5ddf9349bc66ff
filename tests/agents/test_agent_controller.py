"""A trained agent as a controller: it sees what the environment shows, and acts as there."""

import numpy as np
import pytest

from gapscope.agents.models import AgentModel, Gravity
from gapscope.agents.tracking import AgentController, SampledReference, track
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import draw_motion, workspace
from gapscope.arm.nominal import NominalArm
from gapscope.envs.actions import control
from gapscope.envs.environment import LOOK_AHEAD, ArmTracking
from gapscope.envs.simulated_arm import SimulatedArm

BANDWIDTH = 2.0


class Noting:
    """A policy of actions drawn once, which notes what it observes."""

    def __init__(self, size: int) -> None:
        self.seen = []
        self.actions = np.random.default_rng(0).uniform(-0.3, 0.3, (30, size))

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        self.seen.append(observation)
        return self.actions[len(self.seen) - 1]


@pytest.mark.parametrize(
    ("kind", "size", "reach"),
    [("residual", 2, 0.05), ("scale", 4, None), ("gains", 1, None), ("torque", 2, None)],
)  # fmt: skip
def test_it_moves_an_arm_as_the_environment_does(
    two: NominalArm, kind: str, size: int, reach: float | None
) -> None:
    """The same policy, gains and motion: observations and positions agree."""
    body, here, there = RigidBody(two), Noting(size), Noting(size)
    space = workspace(body)
    motion = draw_motion("fourier", np.random.default_rng(1), space, 1.0)
    how = {"action_reach": reach, "bandwidth": BANDWIDTH, "episode_length": 0.6}
    env = ArmTracking(two, action=kind, feedforward=Gravity(two), **how)
    observation, _ = env.reset(seed=0, options={"motion": motion})
    for _ in range(30):
        observation, *_ = env.step(there(observation))
    env.close()

    known = (two, body, space)
    own = control(*known, kind, None, BANDWIDTH, reach)
    agent = AgentModel(here, Gravity(two), own, LOOK_AHEAD, 0.02, "none")
    gains = own.gains or control(*known, "residual", None, BANDWIDTH, 0.05).gains
    controller = AgentController(gains, own.limit, agent)
    course = SampledReference.of(motion, 0.6, 1e-3, settle=0.0).planned(controller)
    with SimulatedArm(two, (), 1e-3, encoder_step=two.encoder_step or 0.0) as simulated:
        track(simulated, controller, course)
    assert len(here.seen) == 30
    np.testing.assert_allclose(here.seen, there.seen, atol=2e-4)
