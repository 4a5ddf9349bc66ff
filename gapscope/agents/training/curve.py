"""The learning curve: a row after each round, from the untrained agent on."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from gapscope.agents.training.held_out_trial import AgentScore
from gapscope.arm.io.atomic_write import atomic_write

COLUMNS = ("reward", "joint_error", "torque_rate", "ended")


@dataclass(frozen=True)
class Point:
    """Scores after some actions of training.

    Attributes:
        steps: actions, all environments together.
        simulator: in the simulator that the agent is trained in.
        hidden: on the arm with hidden effects, or ``None``.
    """

    steps: int
    simulator: AgentScore
    hidden: AgentScore | None

    def plain(self) -> dict[str, Any]:
        """As JSON data."""
        hidden = None if self.hidden is None else self.hidden.plain()
        return {
            "steps": self.steps,
            "simulator": self.simulator.plain(),
            "hidden": hidden,
        }

    @classmethod
    def of(cls, content: dict[str, Any]) -> Point:
        """From plain data."""
        hidden = content["hidden"]
        return cls(
            content["steps"],
            _score(content["simulator"]),
            None if hidden is None else _score(hidden),
        )


def _score(content: dict[str, Any]) -> AgentScore:
    known: dict[str, Any] = {
        name: inf if value is None else value for name, value in content.items()
    }
    return AgentScore(**known)


def write_curve(curve: Sequence[Point], path: Path) -> None:
    """Write the curve as CSV; what is not finite is left empty.

    Columns: steps, then with ``simulator_`` and ``hidden_`` reward [1], joint_error [rad], torque_rate [N m/s], ended.
    """
    parts = ("simulator", "hidden")
    with (
        atomic_write(path) as aside,
        aside.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(
            ["steps", *(f"{part}_{name}" for part in parts for name in COLUMNS)]
        )
        for point in curve:
            plain = point.plain()
            writer.writerow(
                [
                    point.steps,
                    *(
                        (plain[part] or {}).get(name)
                        for part in parts
                        for name in COLUMNS
                    ),
                ]
            )
