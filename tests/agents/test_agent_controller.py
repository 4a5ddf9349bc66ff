"""A trained agent as a controller: it sees what the environment shows, and acts as there."""

import numpy as np
import pytest

from gapscope.agents.evaluation import MEASURES, EvaluationPlan, TrackingBench
from gapscope.agents.models import AgentModel, Gravity
from gapscope.agents.tracking import AgentController, SampledReference, track
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import draw_motion, workspace
from gapscope.arm.nominal import NominalArm
from gapscope.envs.actions import Control, control
from gapscope.envs.environment import LOOK_AHEAD, ArmTracking
from gapscope.envs.simulated_arm import SimulatedArm

BANDWIDTH, REACH = 2.0, 0.05


class Noting:
    """A policy of actions drawn once, which notes what it observes."""

    def __init__(self, size: int, factor: float = 1.0) -> None:
        self.seen = []
        draws = np.random.default_rng(0).uniform(-1, 1, (200, size))
        self.actions = factor * draws

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        self.seen.append(observation)
        return self.actions[len(self.seen) - 1]


def _control(arm: NominalArm, kind: str) -> Control:
    body = RigidBody(arm)
    reach = REACH if kind == "residual" else None
    return control(arm, body, workspace(body), kind, None, BANDWIDTH, reach)


def _agent(arm: NominalArm, policy: Noting, kind: str = "residual") -> AgentModel:
    return AgentModel(
        policy, Gravity(arm), _control(arm, kind), LOOK_AHEAD, 0.02, "none"
    )


@pytest.mark.parametrize("kind", ["residual", "scale", "gains", "torque"])
def test_it_moves_an_arm_as_the_environment_does(two: NominalArm, kind: str) -> None:
    """The same policy, gains and motion: observations and positions agree."""
    size = {"scale": 4, "gains": 1}.get(kind, 2)
    reach = REACH if kind == "residual" else None
    motion = draw_motion(
        "fourier", np.random.default_rng(1), workspace(RigidBody(two)), 1.0
    )
    here, there = Noting(size, 0.3), Noting(size, 0.3)
    env = ArmTracking(
        two,
        action=kind,
        feedforward=Gravity(two),
        action_reach=reach,
        bandwidth=BANDWIDTH,
        episode_length=0.6,
    )
    observation, _ = env.reset(seed=0, options={"motion": motion})
    for _ in range(30):
        observation, *_ = env.step(there(observation))
    env.close()

    agent = _agent(two, here, kind)
    gains = agent.control.gains or _control(two, "residual").gains
    controller = AgentController(gains, agent.control.limit, agent)
    course = SampledReference.of(motion, 0.6, 1e-3, settle=0.0).planned(controller)
    with SimulatedArm(two, (), 1e-3, encoder_step=two.encoder_step or 0.0) as simulated:
        track(simulated, controller, course)
    assert len(here.seen) == 30
    np.testing.assert_allclose(here.seen, there.seen, atol=2e-4)


def test_an_agent_that_does_nothing_is_its_model(two: NominalArm) -> None:
    """Torque for torque, and again after another run."""
    plan = EvaluationPlan(
        motions=("fourier",), seeds=(0,), duration=1.0, disturbances=("none",)
    )
    bench = TrackingBench(two, (), plan)
    agent = _agent(two, Noting(2, 0.0))
    ((alone,), (with_agent,)) = (
        bench.episodes("m", model, plan.engines[0], 0)
        for model in (Gravity(two), agent)
    )
    # the last bit of a sum may differ between two runs, and an episode lets it grow
    for name in (*MEASURES, "diverged"):
        np.testing.assert_allclose(
            with_agent[name], alone[name], rtol=1e-6, atol=1e-9, err_msg=name
        )
    own = agent._replace(policy=Noting(2))
    acting = bench.episodes("m", own, plan.engines[0], 0)[0]
    assert acting["joint_error"] > alone["joint_error"]
