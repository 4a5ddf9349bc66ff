"""What many episodes leave behind."""

from __future__ import annotations

import gc
import tracemalloc

import pytest

from gapscope.envs.environment import ArmTracking

EPISODES = 15
MOTION_BYTES = 7 * 1001 * 8
"""One channel of the motion of an episode of 1 s in steps of 1 ms, seven joints."""


@pytest.mark.nightly
def test_motions_of_past_episodes_are_forgotten() -> None:
    """Of each at least its torque was once kept, in one cache per environment, up to 64 MB."""
    env = ArmTracking(engine="mujoco", episode_length=1.0, motion="fourier")
    tracemalloc.start()
    try:
        held = []
        for _ in range(2):
            for _ in range(EPISODES):
                env.reset()
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
        env.close()
    assert held[1] - held[0] < 0.2 * EPISODES * MOTION_BYTES
