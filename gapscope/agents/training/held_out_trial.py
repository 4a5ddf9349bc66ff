"""An agent evaluated on held-out motions: its reward, and how well the arm is tracked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import inf
from typing import Any

import numpy as np

from gapscope.agents.evaluation import HELD_OUT
from gapscope.agents.evaluation_plan import MOTIONS
from gapscope.agents.training.training_settings import TrainingSettings
from gapscope.arm.io.json_file import plain
from gapscope.arm.motions.named_motions import draw_motion
from gapscope.arm.motions.trajectory import ReferenceMotion
from gapscope.envs.environment import ArmTracking, VectorArmTracking

Policy = Callable[[np.ndarray], np.ndarray]
"""Action of an observation as the environment gives it."""


@dataclass(frozen=True)
class AgentScore:
    """How an agent does on some motions, means over them.

    Attributes:
        reward: per action; actions missing because an episode ended early count as 0 [1].
        joint_error: RMS over actions and joints of reference minus encoders [rad]; infinite if an episode ended early.
        torque_rate: RMS over steps and joints of the change of the torque commanded [N m/s]; likewise.
        ended: episodes that ended early: the arm diverged, or came to its stop.
        episodes: how many.
    """

    reward: float
    joint_error: float
    torque_rate: float
    ended: int
    episodes: int

    def plain(self) -> dict[str, Any]:
        """As JSON data; what is not finite is ``None``."""
        return dict(plain(asdict(self), null_if_not_finite=True))


def held_out(
    settings: TrainingSettings, env: ArmTracking, first: int = 0
) -> list[tuple[str, ReferenceMotion]]:
    """Names and motions of an evaluation: those of ``gapscope evaluate``, from seeds that no training draws.

    Args:
        settings: kinds of motions, how many of each, and how long.
        env: the arm that does them.
        first: seed of the first; motions from other seeds have chosen no agent.
    """
    found = []
    for seed in range(first, first + settings.seeds):
        for name in settings.motions:
            number = list(MOTIONS).index(name) if name in MOTIONS else 99
            rng = np.random.default_rng((HELD_OUT, number, seed))
            found.append((name, draw_motion(name, rng, env.space, settings.duration)))
    return found


def idle(env: ArmTracking) -> Policy:
    """The policy that does nothing, in one environment or in several."""
    size = env.actions
    return lambda observation: np.zeros((*np.shape(observation)[:-1], size))


def episodes(
    env: ArmTracking | VectorArmTracking,
    policy: Policy,
    motions: Sequence[tuple[str, ReferenceMotion]],
) -> list[AgentScore]:
    """A score for each motion; effects that the environment draws are the same at each call.

    Args:
        env: an environment, or one for each motion, stepped together.
        policy: gives the action of an observation, or those of several in rows.
        motions: names and motions.
    """
    if isinstance(env, VectorArmTracking):
        return _together(env, policy, [motion for _, motion in motions])
    return [
        _episode(env, policy, motion, number)
        for number, (_, motion) in enumerate(motions)
    ]


def judge(
    env: ArmTracking | VectorArmTracking,
    policy: Policy,
    motions: Sequence[tuple[str, ReferenceMotion]],
) -> AgentScore:
    """The mean score over motions."""
    scores = episodes(env, policy, motions)
    return AgentScore(
        reward=float(np.mean([score.reward for score in scores])),
        joint_error=float(np.mean([score.joint_error for score in scores])),
        torque_rate=float(np.mean([score.torque_rate for score in scores])),
        ended=sum(score.ended for score in scores),
        episodes=len(scores),
    )


def _episode(
    env: ArmTracking, policy: Policy, motion: ReferenceMotion, number: int
) -> AgentScore:
    observation, _ = env.reset(seed=HELD_OUT + number, options={"motion": motion})
    rewards, errors, rates = [], [], []
    while True:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        rewards.append(reward)
        errors.append(info["tracking_rms"])
        rates.append(info["torque_rate"])
        if terminated or truncated:
            break
    count = round(env.length / env.period)
    return _score(rewards, errors, rates, count, bool(terminated))


def _together(
    env: VectorArmTracking, policy: Policy, motions: Sequence[ReferenceMotion]
) -> list[AgentScore]:
    """The scores of one episode of each motion."""
    seeds = [HELD_OUT + number for number in range(len(motions))]
    each = [{"motion": motion} for motion in motions]
    observations, _ = env.reset(seed=seeds, options={"each": each})
    count = env.setup.timing.actions
    # an action in which all episodes begin anew has no figures
    none = np.zeros(len(motions))
    rows, fallen, over = [], [], []
    for _ in range(count):
        found = env.step(policy(observations))
        observations, reward, terminated, truncated, info = found
        measures = (info.get(name, none) for name in ("tracking_rms", "torque_rate"))
        rows.append((reward, *measures))
        fallen.append(terminated)
        over.append(terminated | truncated)
    series, lengths = np.array(rows), np.argmax(over, axis=0) + 1
    scores = []
    for number, length in enumerate(lengths.tolist()):
        rewards, errors, rates = series[:length, :, number].T
        early = bool(fallen[length - 1][number])
        scores.append(_score(rewards, errors, rates, count, early))
    return scores


def _score(
    rewards: Sequence[float] | np.ndarray,
    errors: Sequence[float] | np.ndarray,
    rates: Sequence[float] | np.ndarray,
    count: int,
    ended: bool,
) -> AgentScore:
    """The score of an episode.

    Args:
        rewards, errors, rates: of its actions [1], [rad], [N m/s].
        count: actions of a whole episode.
        ended: whether it ended early.
    """
    reward = float(sum(rewards)) / count
    if ended:
        return AgentScore(reward, inf, inf, 1, 1)
    error = float(np.sqrt(np.mean(np.square(errors))))
    rate = float(np.sqrt(np.mean(np.square(rates))))
    return AgentScore(reward, error, rate, 0, 1)
