"""Caching what is finished of an evaluation, so that an interrupted one can be resumed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from gapscope.agents.agent_controller import Candidate
from gapscope.agents.episode import Episode


class EvaluationCache(Protocol):
    """Cells of an evaluation: episodes of a model in an engine with one seed, and its margin in an engine."""

    def episodes(
        self,
        name: str,
        model: Candidate,
        engine: str,
        seed: int,
        compute: Callable[[], list[Episode]],
    ) -> list[Episode]:
        """Episodes of a model with one seed: the cached ones, or those that ``compute`` returns."""

    def margin(
        self,
        name: str,
        model: Candidate,
        engine: str,
        compute: Callable[[], float],
    ) -> float:
        """Largest stable bandwidth of a model [Hz]: the cached one, or the one that ``compute`` returns."""
