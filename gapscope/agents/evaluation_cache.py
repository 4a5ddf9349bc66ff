"""Finished parts of an evaluation, kept so that an interrupted one can be resumed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from gapscope.agents.torque_model import TorqueModel

if TYPE_CHECKING:
    from gapscope.agents.evaluation import Episode


class Keeper(Protocol):
    """Keeps the cells of an evaluation: episodes of a model in an engine with one seed, and its margin in an engine."""

    def episodes(
        self,
        name: str,
        model: TorqueModel | None,
        engine: str,
        seed: int,
        work: Callable[[], list[Episode]],
    ) -> list[Episode]:
        """Episodes of a model with one seed: those kept, or those that ``work`` returns."""

    def margin(
        self,
        name: str,
        model: TorqueModel | None,
        engine: str,
        work: Callable[[], float],
    ) -> float:
        """Largest stable bandwidth of a model [Hz]: the one kept, or the one that ``work`` returns."""


class Forgetful:
    """Keeps nothing."""

    def episodes(
        self,
        name: str,
        model: TorqueModel | None,
        engine: str,
        seed: int,
        work: Callable[[], list[Episode]],
    ) -> list[Episode]:
        """What ``work`` returns."""
        return work()

    def margin(
        self,
        name: str,
        model: TorqueModel | None,
        engine: str,
        work: Callable[[], float],
    ) -> float:
        """What ``work`` returns."""
        return work()
