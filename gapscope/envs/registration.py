"""The environment's name in Gymnasium."""

from __future__ import annotations

from importlib.util import find_spec

NAME = "gapscope/ArmTracking-v0"


def register_environment() -> None:
    """Make ``NAME`` known to Gymnasium, if that is installed; nothing of the environment is imported."""
    if find_spec("gymnasium") is None:
        return
    from gymnasium.envs.registration import register, registry

    if NAME not in registry:
        register(id=NAME, entry_point="gapscope.envs.environment:ArmTracking")
